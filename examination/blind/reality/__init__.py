"""A simulator with more physics than the model, which shares no simulation code with `physics`."""

from examination.blind.reality.simulate import Outcome, happen
from examination.blind.reality.world import BY_NAME, FEATURES, Feature, World

__all__ = ["BY_NAME", "FEATURES", "Feature", "Outcome", "World", "happen"]

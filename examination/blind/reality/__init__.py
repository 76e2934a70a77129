"""A bench that is richer than the model: it shares no simulation code with `physics`."""

from examination.blind.reality.simulate import Outcome, happen
from examination.blind.reality.world import BY_NAME, FEATURES, Feature, World

__all__ = ["BY_NAME", "FEATURES", "Feature", "Outcome", "World", "happen"]

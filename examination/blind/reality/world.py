"""A world: the true parameters of a rig, and its differences from the baseline model.

`FEATURES` are all possible differences; with all of them off a `World` is the baseline."""

import math
from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind


# --- Every departure of the reality from the baseline model: features.yaml.
@dataclass(frozen=True)
class Feature:
    """One departure from the baseline; the fields are explained in features.yaml."""

    name: str
    unit: str
    off: float
    low: float
    high: float
    text: str
    stage: str = ""
    outside: bool = False
    setting: bool = False


_BY_STAGE = yaml.safe_load(Path(__file__).with_name("features.yaml").read_text())
FEATURES = tuple(Feature(name=name, stage=stage, **numbers)
                 for stage, features in _BY_STAGE.items() for name, numbers in features.items())
BY_NAME: dict[str, Feature] = {feature.name: feature for feature in FEATURES}
# Every feature's number, as compiled functions take them.
Numbers = namedtuple("Numbers", [feature.name for feature in FEATURES])


# --- A world: the true parameters of a rig, and its features.
@dataclass(frozen=True, eq=False)
class World:
    """One bench as it really is: true parameters of a composite, of wires with a load or of a
    clamped one, and values of FEATURES by name; absent ones are off. Raises InputError
    for an unknown feature, a value out of its range, or a rig that is none of these."""

    parameters: Parameters
    features: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in self.features.items():
            self.feature(name)
            feature = BY_NAME[name]
            if not (math.isfinite(value) and feature.low <= value <= feature.high):
                raise InputError(f"world: {name} is {value!r}, expected {feature.low:g} to "
                                 f"{feature.high:g} {feature.unit}")
        object.__setattr__(self, "features", {n: float(v) for n, v in self.features.items()})
        if self.load == "displacement":
            raise InputError("world: load.kind is displacement, expected a load that wires pull")

    @property
    def load(self) -> str:
        return load_kind(self.parameters)

    @property
    def sides(self) -> tuple[str, ...]:
        """Of all wires; idle ones are added behind, except for a beam or antagonists."""
        sides = tuple(self.parameters["bench.channel_sides"])
        return sides if self.load in ("beam", "antagonist") else sides + ("back",) * len(sides)

    @property
    def numbers(self) -> Numbers:
        return Numbers(*(self.feature(name) for name in BY_NAME))

    def feature(self, name: str) -> float:
        """Value of a feature; its `off` where the world does not name it."""
        if name not in BY_NAME:
            raise InputError(f"world: no feature {name}, expected one of FEATURES")
        return self.features.get(name, BY_NAME[name].off)

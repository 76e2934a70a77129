"""A world: the true numbers of a rig, and every departure from the baseline model.

All departures off is the baseline. `Features` are what may happen, a `World` is one bench."""

import math
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
    """One departure from the baseline.

    Attributes:
        name, unit: as in a world's features.
        off: value at which it does nothing (for a setting: its usual value).
        low, high: what is accepted; realistic sizes lie well within.
        text: what it does.
        stage: electrical, thermal, transformation, mechanical or sensor.
        outside: belongs to no effect of the contract.
        setting: only shapes another feature.
    """

    name: str
    unit: str
    off: float
    low: float
    high: float
    text: str
    stage: str = ""
    outside: bool = False
    setting: bool = False


def _read() -> tuple[Feature, ...]:
    by_stage = yaml.safe_load(Path(__file__).with_name("features.yaml").read_text())
    return tuple(
        Feature(name=name, stage=stage, **numbers)
        for stage, features in by_stage.items() for name, numbers in features.items()
    )


FEATURES = _read()
BY_NAME: dict[str, Feature] = {feature.name: feature for feature in FEATURES}


# --- A world: the true numbers of a rig, and what the baseline model does not know of it.

_BENDING = (
    "composite.deflection_per_strain",
    "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
)


@dataclass(frozen=True, eq=False)
class World:
    """One bench as it really is: a composite, or wires with a load.

    Attributes:
        parameters: true numbers of the baseline; of a composite both sides have equally many wires
            and the bending coefficients are given; a weight or a spring has wires on one side.
        features: values by name of FEATURES; what is absent is off.

    Raises:
        InputError: an unknown feature, a value out of its range, or a rig that is no composite.
    """

    parameters: Parameters
    features: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in self.features.items():
            self.feature(name)
            feature = BY_NAME[name]
            if not (math.isfinite(value) and feature.low <= value <= feature.high):
                raise InputError(f"world: {name} is {value!r}, expected {feature.low:g} to "
                                 f"{feature.high:g} {feature.unit}")  # fmt: skip
        checked = {name: float(value) for name, value in self.features.items()}
        object.__setattr__(self, "features", checked)
        sides = self.sides
        front, back = sides.count("front"), sides.count("back")
        if self.load == "antagonist" and not (
            self.parameters["load.stiffness"] > 0.0 == self.parameters["load.force"]
        ):
            raise InputError("world: antagonists without load.stiffness, or with load.force")
        if self.load != "beam":
            return
        if front != back:
            raise InputError(
                f"world: {front} wires in front and {back} behind, expected equally many"
            )
        for name in _BENDING:
            if not self.parameters[name] > 0.0:
                raise InputError(f"world: {name} is not given, expected a value above 0")

    @property
    def load(self) -> str:
        """`load.kind`."""
        kind = load_kind(self.parameters)
        if kind == "clamped":
            raise InputError("world: load.kind is clamped, expected one that moves")
        return kind

    @property
    def sides(self) -> tuple[str, ...]:
        """Of all wires; those of a weight or a spring have others behind them that do nothing."""
        sides = tuple(self.parameters["bench.channel_sides"])
        return sides if self.load in ("beam", "antagonist") else sides + ("back",) * len(sides)

    def feature(self, name: str) -> float:
        """Value of a feature; its `off` where the world does not name it."""
        if name not in BY_NAME:
            raise InputError(f"world: no feature {name}, expected one of FEATURES")
        return self.features.get(name, BY_NAME[name].off)

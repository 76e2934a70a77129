"""A world: the true numbers of a rig, and what the baseline model does not know of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from sma_bench.blind.reality.features import BY_NAME
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

_BENDING = (
    "composite.deflection_per_strain",
    "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
)


@dataclass(frozen=True, eq=False)
class World:
    """One composite bench as it really is.

    Attributes:
        parameters: true numbers of the baseline; both sides have equally many wires, and the
            bending coefficients are given.
        features: values by name (features.py); what is absent is off.

    Raises:
        InputError: an unknown feature, a value out of its range, or a rig that is no composite.
    """

    parameters: Parameters
    features: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "features", {name: _checked(name, v) for name, v in self.features.items()}
        )
        sides = self.parameters["bench.channel_sides"]
        front, back = sides.count("front"), sides.count("back")
        if front != back:
            raise InputError(
                f"world: {front} wires in front and {back} behind, expected equally many"
            )
        for name in _BENDING:
            if not self.parameters[name] > 0.0:
                raise InputError(f"world: {name} is not given, expected a value above 0")

    def feature(self, name: str) -> float:
        """Value of a feature; its `off` where the world does not name it."""
        if name not in BY_NAME:
            raise InputError(f"world: no feature {name}, expected one of features.py")
        return self.features.get(name, BY_NAME[name].off)

    def replace(self, **features: float) -> "World":
        """The same rig with some features changed."""
        return World(self.parameters, {**self.features, **features})

    def without(self, *names: str) -> "World":
        """The same rig with some features off."""
        return World(
            self.parameters, {n: v for n, v in self.features.items() if n not in names}
        )

    def to_label(self) -> dict[str, dict[str, Any]]:
        """Plain values that `from_label` reads, for JSON."""
        given = sorted(self.parameters.given)
        values = {name: self.parameters[name] for name in given}
        return {
            "parameters": {n: list(v) if isinstance(v, tuple) else v for n, v in values.items()},
            "features": dict(sorted(self.features.items())),
        }

    @classmethod
    def from_label(cls, label: Mapping[str, Mapping[str, Any]]) -> Self:
        """The world that wrote a label."""
        return cls(Parameters(label["parameters"]), dict(label["features"]))


def _checked(name: str, value: float) -> float:
    if name not in BY_NAME:
        raise InputError(f"world: no feature {name}, expected one of features.py")
    feature = BY_NAME[name]
    number = float(value)
    if not math.isfinite(number) or not feature.low <= number <= feature.high:
        raise InputError(
            f"world: {name} is {value!r}, "
            f"expected {feature.low:g} to {feature.high:g} {feature.unit}"
        )
    return number

"""What a fit may move: the bench's parameters under their priors, and the numbers of effects."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.identify.whole_model.prior import BENDING, MATERIAL, Prior, prior_of
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import Parameter
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

HEAT = (
    "wire.resistance",
    "wire.heat_transfer_coefficient",
    "wire.specific_heat",
    "environment.ambient_temperature",
)
# Real kinetics are a little smoother than the cosine's; that is no effect, but a nuisance.
# Standard deviation about what is believed, lowest and highest value, in the parameter's unit.
SHAPES = {
    "wire.transition_spread": (1.5, 0.0, 12.0),
    "wire.transition_tail": (0.3, 0.0, 1.0),
    "effect.partial_transformation.memory": (0.04, -0.1, 0.1),
}
# A record knows h A_c and m c_p only: what is known of A_c and m is carried by h and c_p.
_CARRIED = {
    "wire.heat_transfer_coefficient": "wire.surface_area",
    "wire.specific_heat": "wire.mass",
}
# One number where front and back are believed alike: that they are not is an effect.
FRONT, BACK = "composite.stress_per_deflection_front", "composite.stress_per_deflection_back"
_REACH = 30.0  # prior deviations


@dataclass(frozen=True)
class Unknowns:
    """k baseline parameters, then the numbers of some effects, all in prior deviations.

    Attributes:
        prior: of the baseline; numbers: of the effects, whose prior is centred on their default.
        effects: names, in the order of the numbers.
    """

    prior: Prior
    numbers: tuple[Parameter, ...]
    effects: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns."""
        return (*self.prior.names, *SHAPES, *(p.name for p in self.numbers))

    @property
    def baseline(self) -> int:
        """How many unknowns every candidate has."""
        return len(self.prior.names) + len(SHAPES)

    def parameters(self, x: Array) -> Parameters:
        """Parameters at `x` (k,)."""
        k = len(self.prior.names)
        values = {
            name: float(np.clip(self.prior.base[name] + at * std, *self._range(name)))
            for (name, (std, _, _)), at in zip(SHAPES.items(), x[k:], strict=False)
        }
        for number, at in zip(self.numbers, x[self.baseline :], strict=True):
            values[number.name] = value_of(number, at)
        moved = self.prior.parameters(x[:k])
        values |= {twin: moved[name] for twin, name in self.twins.items()}
        return moved.replace(values)

    @property
    def twins(self) -> dict[str, str]:
        """Parameters that take another one's value."""
        alike = FRONT in self.prior.names and BACK not in self.prior.names
        return {BACK: FRONT} if alike else {}

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest (k,)."""
        low, high = self.prior.bounds()
        ends = [_ends(p) for p in self.numbers]
        shapes = []
        for name, (std, _, _) in SHAPES.items():
            shapes.append([(end - self.prior.base[name]) / std for end in self._range(name)])
        lows = np.concatenate([low, [e[0] for e in (*shapes, *ends)]])
        highs = np.concatenate([high, [e[1] for e in (*shapes, *ends)]])
        return np.maximum(lows, -_REACH), np.minimum(highs, _REACH)

    def _range(self, name: str) -> tuple[float, float]:
        """Lowest and highest value of a shape; what is believed is within."""
        _, low, high = SHAPES[name]
        believed = self.prior.base[name]
        return min(low, believed), max(high, believed)

    def start(self, spread: float = 0.3) -> Array:
        """Nominal parameters, effects off; `spread` in its prior's deviations, at 0 of which its
        slope vanishes."""
        x = np.zeros(self.baseline + len(self.numbers))
        x[len(self.prior.names)] = spread
        return x

    def with_effects(self, names: Iterable[str]) -> "Unknowns":
        """The same baseline with the numbers of these effects."""
        effects = tuple(names)
        numbers = tuple(p for name in effects for p in EFFECTS[name].parameters)
        return Unknowns(self.prior, numbers, effects)

    def values(self, x: Array) -> Array:
        """(k,) in their units."""
        parameters = self.parameters(x)
        return np.array([parameters[name] for name in self.names])

    def scales(self, x: Array) -> Array:
        """(k,) units per prior deviation."""
        shapes = [std for std, _, _ in SHAPES.values()]
        numbers = [
            float(p.uncertainty or 1.0) * (value_of(p, at) / default_of(p) if p.default else 1.0)
            for p, at in zip(self.numbers, x[self.baseline :], strict=True)
        ]
        return np.concatenate(
            [self.prior.slopes(x[: len(self.prior.names)]), shapes, numbers]
        )


def baseline_unknowns(parameters: Parameters, quantities: Sequence[str]) -> Unknowns:
    """Everything of the baseline that records of these quantities can depend on."""
    names = [*HEAT]
    if "deflection" in quantities:
        names += [*MATERIAL, *BENDING]
    elif "temperature" not in quantities:
        names = ["wire.resistance"]
    prior = prior_of(_carrying(parameters), names)
    if _alike(prior):
        prior = prior_of(_carrying(parameters), [name for name in names if name != BACK])
    return Unknowns(prior, (), ())


def _alike(prior: Prior) -> bool:
    """Whether both sides are believed to be equally stiff, and equally well known."""
    known = dict(zip(prior.names, zip(prior.mean, prior.std, strict=True), strict=True))
    return FRONT in known and known[FRONT] == known.get(BACK)


def _carrying(parameters: Parameters) -> Parameters:
    widened = {}
    for name, partner in _CARRIED.items():
        relative = parameters.std(partner) / parameters[partner]
        widened[name] = float(np.hypot(parameters.std(name), relative * parameters[name]))
    return parameters.replace(uncertainty=widened)


def default_of(number: Parameter) -> float:
    """An effect's number where nobody gave another."""
    assert isinstance(number.default, float)
    return number.default


def value_of(number: Parameter, x: float) -> float:
    """An effect's number, `x` prior deviations from its default; by its logarithm where that is
    not 0."""
    default, std = default_of(number), float(number.uncertainty or 1.0)
    value = default * np.exp(std / default * x) if default else std * x
    return float(np.clip(value, number.low, number.high))


def x_of(number: Parameter, value: float) -> float:
    """Inverse of `value_of`."""
    default, std = default_of(number), float(number.uncertainty or 1.0)
    return float(np.log(value / default) * default / std if default else value / std)


def _ends(number: Parameter) -> tuple[float, float]:
    assert number.low is not None and number.high is not None
    return x_of(number, number.low), x_of(number, number.high)

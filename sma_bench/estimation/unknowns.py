"""What a fit may move: the bench's parameters under their priors, and the numbers of effects.

One list of everything that records can depend on. A record knows some factors only as a product
(h A_c, m c_p): one of them is moved and carries what is known of the other (`partner`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.transitions import TEMPERATURES, Transitions
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import EFFECT_PREFIX, EFFECT_TABLE, Parameter
from sma_bench.parameters.parameters import LOAD_NEEDS, load_kind
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import bending_coefficients
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

HEAT = (
    "wire.resistance",
    "wire.heat_transfer_coefficient",
    "wire.specific_heat",
    "environment.ambient_temperature",
)
MATERIAL = (
    *TEMPERATURES,
    "wire.martensite_modulus",
    "wire.austenite_modulus",
    "wire.maximum_recoverable_strain",
    "wire.thermal_expansion_factor",
    "wire.stress_influence_austenite",
    "wire.stress_influence_martensite",
)
# One number where front and back are believed alike: that they are not is an effect.
FRONT, BACK = "composite.stress_per_deflection_front", "composite.stress_per_deflection_back"
BENDING = ("composite.deflection_per_strain", FRONT, BACK)
# What is unknown of a load that wires pull against; a spring's preload has its weight in it.
LOADS = {
    "force": ("load.force",),
    "spring": ("load.stiffness", "load.preload"),
    "antagonist": ("load.stiffness", "load.preload", "load.force"),
}
# A load frame shows strains and stresses by the wire's length (from its mass) and section.
LOAD_FRAME = ("wire.mass", "wire.diameter")
# Real kinetics are a little smoother than the cosine's; that is no effect, but a nuisance.
# Standard deviation about what is believed, lowest and highest value, in the parameter's unit.
SHAPES = {
    "wire.transition_spread": (1.5, 0.0, 12.0),
    "wire.transition_tail": (0.3, 0.0, 1.0),
    "effect.partial_transformation.memory": (0.08, -0.2, 0.2),
}
# Beside a load motion shows the kinetics themselves: grains decide how flat an inner loop starts,
# between the contract's rule and the full loop's.
LOADED_SHAPES = {"effect.partial_transformation.memory": (0.4, -0.1, 1.0)}
# What every wire in air or under a load has and the paper's model leaves out: in a fit to motion it
# would pass for other numbers, and predict other drives wrongly. Priors are the table's.
UNMODELLED = (
    "effect.latent_heat.heat",
    "effect.temperature_dependent_convection.rise",
    "effect.phase_dependent_resistance.austenite_change",
    "effect.residual_strain.share",
)
# Products: what is known of the second factor is carried by the first, which the fit moves.
PRODUCTS = {
    "wire.heat_transfer_coefficient": "wire.surface_area",
    "wire.specific_heat": "wire.mass",
}
_TIMES = {
    f"{EFFECT_PREFIX}{effect.name}.{number}": other
    for effect in EFFECTS.values()
    for number, other in (effect.times or {}).items()
}
_STRAIGHT = {
    *TEMPERATURES,
    "environment.ambient_temperature",
    "wire.thermal_expansion_factor",
    "load.force",
    "load.preload",
}
_DERIVED_STD = 0.3  # relative, of bending coefficients that only an assumed geometry gives
_REACH = 30.0  # prior deviations
_STILL = 1e-6  # deviations a prior deviation
_ABOVE_NOTHING = 1e-3  # of what is believed: the least of a number that cannot be 0
_SMALLEST = 1e-300
_MOST_LOG = 50.0  # of a number's logarithm, beyond which it says nothing any more


@dataclass(frozen=True)
class Unknown:
    """One number and its Gaussian prior.

    Attributes:
        mean, std, low, high: in the parameter's unit.
        log: its logarithm is moved, because the model mostly knows products, which are straight
            lines there; `mean` is then that of the value, `std/mean` of the logarithm.
        tied: parameters that take the same value.
        partner: the other factor of a product that records know only as a whole; own_std is what
            is known of this factor alone, the rest of `std` the partner's.
    """

    name: str
    mean: float
    std: float
    low: float = -math.inf
    high: float = math.inf
    log: bool = False
    tied: tuple[str, ...] = ()
    partner: str = ""
    own_std: float = 0.0

    def value(self, x: float) -> float:
        """In its unit, `x` prior deviations from the mean, within its range."""
        if self.log:
            exponent = self.std / self.mean * x
            moved = self.mean * math.exp(min(max(exponent, -_MOST_LOG), _MOST_LOG))
        else:
            moved = self.mean + self.std * x
        return float(min(max(moved, self.low), self.high))

    def x_of(self, value: float) -> float:
        """Inverse of `value`."""
        if not self.log:
            return (value - self.mean) / self.std
        ratio = value / self.mean
        return math.log(ratio) * self.mean / self.std if ratio > 0.0 else -math.inf

    def slope(self, x: float) -> float:
        """Units a prior deviation."""
        return self.std / self.mean * self.value(x) if self.log else self.std

    @property
    def share(self) -> float:
        """Of a product's deviation that is this factor's own: 1 without a partner."""
        return self.own_std / self.std if self.partner else 1.0


@dataclass(frozen=True)
class Unknowns:
    """Numbers of the bench, shapes of its kinetics, then the numbers of some effects.

    They are moved as x (k,), in prior deviations.

    Attributes:
        base: all the other parameters.
        items: in this order; bench: how many are the bench's own; baseline: with the shapes, how
            many every candidate has; effects: names, in the order of the numbers.
        transitions: of the temperatures among the items, which are moved together: each has the
            deviation of its own in its item, but is no function of its own x.
    """

    base: Parameters
    items: tuple[Unknown, ...]
    bench: int
    baseline: int
    effects: tuple[str, ...] = ()
    transitions: Transitions | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all unknowns."""
        return tuple(item.name for item in self.items)

    @property
    def bench_names(self) -> tuple[str, ...]:
        """Those of the bench."""
        return self.names[: self.bench]

    @property
    def tied(self) -> dict[str, str]:
        """Parameters that take another one's value."""
        return {other: item.name for item in self.items for other in item.tied}

    @cached_property
    def _together(self) -> slice:
        """Where the temperatures that are moved together stand."""
        if self.transitions is None:
            return slice(0, 0)
        first = self.names.index(TEMPERATURES[self.transitions.moving[0]])
        return slice(first, first + len(self.transitions.moving))

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        ends = [(item.x_of(item.low), item.x_of(item.high)) for item in self.items]
        low, high = np.array(ends, dtype=np.float64).reshape(-1, 2).T
        low[self._together], high[self._together] = -_REACH, _REACH
        return np.maximum(low, -_REACH), np.minimum(high, _REACH)

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest (k,) of x."""
        return self._bounds

    def values(self, x: Array) -> Array:
        """(k,) in their units."""
        parameters = self.parameters(x)
        return np.array([parameters[name] for name in self.names])

    def slopes(self, x: Array) -> Array:
        """(k,) units a deviation of each number; `turn` says how x moves these."""
        return np.array([item.slope(at) for item, at in zip(self.items, x, strict=True)])

    def turn(self, x: Array) -> Array:
        """(k, k) d(deviations of the numbers)/dx: 1 but for temperatures, which move together."""
        turn = np.eye(len(self.items))
        if self.transitions is not None:
            own = self.transitions.slopes(x[self._together]) / self.transitions.std[:, np.newaxis]
            still = np.linalg.norm(own, axis=1) < _STILL
            # At an end of the range, where x moves it no more, one is as unknown as it was.
            own[still] = np.eye(len(own))[still]
            turn[self._together, self._together] = own
        return turn

    def deviations(self, x: Array) -> Array:
        """(k,) of the numbers from what is believed, each in its own prior deviations."""
        found = x.copy()
        if self.transitions is not None:
            moving, values = self.transitions.moving, self.transitions.values(x[self._together])
            moved = (values - self.transitions.mean)[moving]
            found[self._together] = moved / self.transitions.std
        return found

    def x_of(self, values: Iterable[float]) -> Array:
        """(k,) of values in their units."""
        given = list(values)
        x = np.array([item.x_of(v) for item, v in zip(self.items, given, strict=True)])
        if self.transitions is not None:
            four = self.transitions.mean.copy()
            four[self.transitions.moving] = given[self._together]
            x[self._together] = self.transitions.x_of(four)
        return x

    def parameters(self, x: Array) -> Parameters:
        """The bench at x."""
        values = {
            item.name: item.value(at) for item, at in zip(self.items, x.tolist(), strict=True)
        }
        if self.transitions is not None:
            found = self.transitions.values(x[self._together]).tolist()
            values |= zip(TEMPERATURES, found, strict=True)
        values |= {other: values[name] for other, name in self.tied.items()}
        return self.base.replace(values)

    def nudged(self, bench: Parameters, x: Array, i: int, step: float) -> Parameters:
        """The bench at x, one of its unknowns moved."""
        item = self.items[i]
        if item.name in TEMPERATURES:
            there = x.copy()
            there[i] += step
            return self.parameters(there)
        return bench.replace(dict.fromkeys((item.name, *item.tied), item.value(x[i] + step)))

    def widened(self, factors: Array) -> "Unknowns":
        """The same with wider priors, by factors (k,)."""
        items = tuple(
            replace(item, std=item.std * factor, own_std=item.own_std * factor)
            for item, factor in zip(self.items, factors.tolist(), strict=True)
        )
        if self.transitions is None:
            return replace(self, items=items)
        wider = self.transitions.widened(factors[self._together])
        together = tuple(
            replace(item, std=std)
            for item, std in zip(items[self._together], wider.std.tolist(), strict=True)
        )
        items = (*items[: self._together.start], *together, *items[self._together.stop :])
        return replace(self, items=items, transitions=wider)

    def start(self, spread: float = 0.3) -> Array:
        """What is believed, effects off; `spread` in its prior's deviations, at 0 of which its
        slope vanishes."""
        x = np.zeros(len(self.items))
        if "wire.transition_spread" in self.names:
            x[self.names.index("wire.transition_spread")] = spread
        return x

    def with_effects(self, names: Iterable[str]) -> "Unknowns":
        """The same baseline with the numbers of these effects."""
        effects = tuple(names)
        numbers = (number_of_effect(p) for name in effects for p in EFFECTS[name].parameters)
        return replace(self, items=(*self.items[: self.baseline], *numbers), effects=effects)


def unknowns_of_records(
    parameters: Parameters, quantities: Sequence[str], *, load_frame: bool = False,
    own_load: bool = True, sides_apart: bool = False, unmodelled: bool = False,
) -> Unknowns:
    """Everything of the baseline that records of these quantities can depend on.

    Args:
        parameters: as believed, with uncertainties.
        load_frame: records of a wire under held loads or between clamps are among them;
            own_load: so are some of wires that move what `load.kind` names.
        sides_apart: front and back are two numbers even where they are believed alike.
        unmodelled: of wires with a load, what the paper's model leaves out of every one; what of
            it is believed in is unknown in any case.
    """
    names, shapes = [*HEAT], {**SHAPES, **_of_table(parameters, stated_effects(parameters))}
    own = LOADS.get(load_kind(parameters), ()) if own_load else ()
    if "deflection" in quantities or load_frame:
        names += MATERIAL
        if own:
            found = [n for n in UNMODELLED if unmodelled or parameters[n] != 0.0]
            shapes |= (LOADED_SHAPES if unmodelled else {}) | _of_table(parameters, found)
            names += [*own, "wire.diameter"]
            names += [] if parameters["wire.length"] else ["wire.mass"]
        elif "deflection" in quantities:
            names += BENDING
        names += LOAD_FRAME if load_frame else ()
    elif "temperature" not in quantities:
        names = ["wire.resistance"]
    return unknowns_of(parameters, names, shapes=shapes, sides_apart=sides_apart)


def stated_effects(parameters: Parameters) -> list[str]:
    """Numbers of effects that somebody believes in, or of which he states what is unknown; and of
    these effects those that have a value where nobody gives one."""
    stated = {
        p.name for p in EFFECT_TABLE
        if parameters[p.name] != p.default or p.name in parameters.given_uncertainty
    }
    on = [e for e in EFFECTS.values() if stated & {p.name for p in e.parameters}]
    return [
        p.name for e in on for p in e.parameters if p.name in stated or p not in e.switches
    ]


def unknowns_of(
    parameters: Parameters, names: Sequence[str], *,
    shapes: Mapping[str, tuple[float, float, float]] = SHAPES, sides_apart: bool = False,
) -> Unknowns:
    """Unknowns from the values and the `uncertainty.` of a parameter set.

    A parameter with uncertainty 0 is exact and not among the names. Bending coefficients which are
    derived from the geometry start there, with 30 % unless their uncertainty is given. All four
    transition temperatures or none of them are among the names.
    """
    derived = dict(zip(BENDING, bending_coefficients(parameters), strict=True))
    together = Transitions.of(parameters) if TEMPERATURES[0] in names else None
    stds = together.stds if together else {}
    found = {}
    for name in names:
        mean = derived.get(name, parameters[name])
        std = stds.get(name, 0.0) if name in TEMPERATURES else parameters.std(name)
        if name in derived and name not in parameters.given_uncertainty and not parameters[name]:
            std = max(std, _DERIVED_STD * mean)
        own, partner = std, PRODUCTS.get(name, "")
        if partner and partner not in names:
            std = float(np.hypot(std, parameters.std(partner) / parameters[partner] * mean))
        else:
            partner = ""
        low, high = _range(name)
        above = name in BENDING or name in LOAD_NEEDS.get(load_kind(parameters), ())
        low = _ABOVE_NOTHING * mean if above else low
        log = name not in _STRAIGHT and low > 0.0
        # A prior that is wider than the range is as wide as that.
        widest = (mean * math.log(high / low) if log else high - low) / max(std, _SMALLEST)
        std, own = (min(1.0, widest) * one for one in (std, own))
        item = Unknown(name, mean, std, low, high, log, (), partner, own)
        if item.std > 0.0:
            found[name] = item
    if not sides_apart and _alike(found):
        found[FRONT] = replace(found[FRONT], tied=(BACK,))
        del found[BACK]
    fixed = {n: v for n, v in derived.items() if n not in found and parameters[n] != v}
    base = parameters.replace(fixed)
    extra = [_shape(name, base, row) for name, row in shapes.items()]
    items = (*found.values(), *(item for item in extra if item.std > 0.0))
    moving = together if stds else None
    return Unknowns(base, items, len(found), len(items), transitions=moving)


def _range(name: str) -> tuple[float, float]:
    low, high = BY_NAME[name].low, BY_NAME[name].high
    return -math.inf if low is None else float(low), math.inf if high is None else float(high)


def _alike(found: dict[str, Unknown]) -> bool:
    """Whether both sides are believed to be equally stiff, and equally well known."""
    front, back = found.get(FRONT), found.get(BACK)
    if front is None or back is None:
        return False
    return (front.mean, front.std) == (back.mean, back.std)


def _of_table(
    parameters: Parameters, names: Iterable[str]
) -> dict[str, tuple[float, float, float]]:
    """Standard deviation, lowest and highest value."""
    return {name: (parameters.std(name), *_range(name)) for name in names}


def _shape(name: str, believed: Parameters, row: tuple[float, float, float]) -> Unknown:
    """What is believed is within its range."""
    std, low, high = row
    mean = float(believed[name])
    low, high = min(low, mean), max(high, mean)
    std = min(believed.given_uncertainty.get(name, std), high - low)
    return Unknown(name, mean, std, low, high, log=bool(BY_NAME[name].default))


def number_of_effect(number: Parameter) -> Unknown:
    """An effect's number, centred where nobody gave another; moved by its logarithm where that is
    not 0."""
    assert number.low is not None and number.high is not None
    default, std = default_of(number), float(number.uncertainty or 1.0)
    return Unknown(number.name, default, std, number.low, number.high, log=default != 0.0)


def shares_of_factor(name: str, value: float, parameters: Parameters) -> dict[str, float]:
    """Error of an effect's number by the factor that it enters the model with (`Effect.times`), one
    standard deviation of that; by the factor's name, none for all other numbers."""
    if name not in _TIMES:
        return {}
    factor = _TIMES[name]
    return {factor: -value * parameters.std(factor) / parameters[factor]}


def default_of(number: Parameter) -> float:
    """An effect's number where nobody gave another."""
    assert isinstance(number.default, float)
    return number.default

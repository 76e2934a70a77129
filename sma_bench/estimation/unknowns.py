"""What a fit may move: the bench's parameters under their priors, and the numbers of effects.

One list of everything that records can depend on. A record knows some factors only as a product
(h A_c, m c_p): one of them is moved and carries what is known of the other (`partner`).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import (
    BY_NAME,
    EFFECT_PREFIX,
    EFFECT_TABLE,
    TRANSITIONS,
    Parameter,
)
from sma_bench.parameters.parameters import (
    BRANCH,
    LOAD_NEEDS,
    SMOOTHER,
    load_kind,
    nearest_spread,
)
from sma_bench.physics import bending_coefficients
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

TEMPERATURES = tuple(TRANSITIONS.values())  # A_s, A_f, M_s, M_f
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
    "force": ("load.force", "load.friction"),
    "spring": ("load.stiffness", "load.preload", "load.friction"),
    "antagonist": ("load.stiffness", "load.preload", "load.force", "load.friction"),
}
FRICTION = "load.friction"
# A load frame shows strains and stresses by the wire's length (from its mass) and section.
LOAD_FRAME = ("wire.mass", "wire.diameter")
SPREAD = "wire.hysteresis_spread"
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
# Typical wires, for what a file does not state: mean and one standard deviation. NiTi has 450 to
# 550 J/(kg K) (Otsuka and Ren 2005), 5 to 25 J/g of latent heat and a martensite of 0 to 30 % more
# resistance than austenite (Ikuta 1991); a correlation of free convection is good to 30 % in a
# room; hystereses are 20 to 40 K wide, about a centre of 65 degC.
FIELD = {
    "wire.specific_heat": (500.0, 75.0),
    "wire.thermal_expansion_factor": (-3.5e5, 1.5e5),
    "wire.maximum_recoverable_strain": (0.03, 0.015),
    "effect.residual_strain.share": (0.0, 0.03),
    "effect.latent_heat.heat": (15e3, 6e3),
    "effect.phase_dependent_resistance.austenite_change": (-0.13, 0.09),
}
_RISE = "effect.temperature_dependent_convection.rise"  # which free convection has already
_FREE_CONVECTION, _NOT_STILL = 0.3, 1.25  # share that is unknown; what a room adds to still air
_FIELD_TEMPERATURES = (340.5, 365.5, 335.5, 310.5)  # K: A_s, A_f, M_s, M_f
_WIDEST_SPREAD = 1.5  # of its hystereses
_LEAST_HALF_WIDTH = 0.1  # K, of the law that is made of hystereses
_FIELD_HALF_WIDTH = 0.3  # of the half width's logarithm, about theirs
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
# Of the centre c in K and of the logarithms of h, w_A and w_M where nothing is stated. The
# paper's h is 1.7 K, most wires have 5 to 20 K.
_SPREADS = np.array([25.0, 1.2, 0.5, 0.5])
_COORDINATES = np.array(
    [[0.25, 0.25, 0.25, 0.25], [0.25, 0.25, -0.25, -0.25], [-1.0, 1.0, 0.0, 0.0],
     [0.0, 0.0, 1.0, -1.0]]
)  # fmt: skip
_TEMPERATURES = np.linalg.inv(_COORDINATES)
# The two ranges of one wire are as wide as each other, but for a third of what wires differ by.
_ALIKE = np.linalg.cholesky(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.85], [0.0, 0.0, 0.85, 1.0]]
)
_LOWEST = float(BY_NAME[TEMPERATURES[0]].low or 0.0)
_HIGHEST = float(BY_NAME[TEMPERATURES[0]].high or 0.0)
_NARROWEST = 0.2  # K, of a range: the core divides by its width
_FARTHEST = 5.0  # of a logarithm
_WIDEST = (5.0, 2.0, 2.0)  # of those of the half width and of the two ranges
_TINY = 1e-4  # prior deviations, of a difference


@dataclass(frozen=True, eq=False)
class Transitions:
    """The transition temperatures that are not exact, moved so that their order holds wherever a
    fit goes, as functions of x (m,) of unit normal prior.

        A_s, A_f = c + h -+ w_A/2        M_f, M_s = c - h -+ w_M/2

    of a centre c, the half width h = (A_s + A_f - M_s - M_f)/4 of the hysteresis and the widths w_A
    and w_M of the two ranges; h, w_A and w_M are moved by their logarithms. What is stated of the
    four is the prior of these; of the others it is that of wires of the field, given what is
    stated.

    Attributes:
        mean: (4,) K, as believed; moving: (m,) which of them; turn: (m, m) K, the root of the
            prior's covariance, symmetric but for units: x[k] is mostly the k-th one's deviation.
    """

    mean: Array
    moving: NDArray[np.intp]
    turn: Array

    @classmethod
    def of(cls, parameters: Parameters) -> Self:
        """As believed; a temperature whose deviation is 0 is exact."""
        mean = np.array([parameters[name] for name in TEMPERATURES])
        stated = np.array([name in parameters.given for name in TEMPERATURES])
        coordinates = _COORDINATES @ mean
        scale = np.where(coordinates > 0.0, coordinates, 1.0) * _SPREADS
        scale[0] = _SPREADS[0]
        if tuple(mean.tolist()) == _FIELD_TEMPERATURES:
            scale[1] = _FIELD_HALF_WIDTH * coordinates[1]
        root = _TEMPERATURES * scale @ _ALIKE
        covariance = root @ root.T
        if stated.any():
            std = np.array([parameters.std(n) for n in np.array(TEMPERATURES)[stated]])
            own = np.diag(np.minimum(std, _HIGHEST - _LOWEST) ** 2)
            within = covariance[np.ix_(stated, stated)]
            follows = np.linalg.solve(within, covariance[stated]).T
            covariance += follows @ (own - within) @ follows.T
        moving = np.flatnonzero(~stated | (np.diag(covariance) > 1e-12))
        kept = covariance[np.ix_(moving, moving)]
        deviation = np.sqrt(np.diag(kept))
        values, vectors = np.linalg.eigh(kept / np.outer(deviation, deviation))
        half = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        return cls(mean, moving, deviation[:, np.newaxis] * half)

    @property
    def std(self) -> Array:
        """(m,) K, of each by itself."""
        return np.asarray(np.sqrt(np.sum(self.turn**2, axis=1)))

    @property
    def stds(self) -> dict[str, float]:
        """By name, of those that are not exact."""
        names = [TEMPERATURES[k] for k in self.moving]
        return dict(zip(names, self.std.tolist(), strict=True))

    def values(self, x: Array) -> Array:
        """(4,) K, A_s below A_f and M_f below M_s."""
        straight = self.mean.copy()
        straight[self.moving] += self.turn @ x
        centre, *widths = (_COORDINATES @ straight).tolist()
        half, austenite, martensite = (
            width if known <= 0.0  # an impossible hysteresis is left as it is
            else known * math.exp(min(max(width / known - 1.0, -_FARTHEST), most))
            for width, known, most in zip(
                widths, (_COORDINATES[1:] @ self.mean).tolist(), _WIDEST, strict=True
            )
        )
        branches = [[centre + half, 0.5 * austenite], [centre - half, 0.5 * martensite]]
        exact = [k for k in range(4) if k not in self.moving]
        for number in exact:
            # An exact one takes its range along, and the other range if none of that is exact.
            branch, sign = number // 2, (-1.0, 1.0, 1.0, -1.0)[number]
            middle, reach = branches[branch]
            off = float(self.mean[number]) - middle - sign * reach
            for other in {branch, branch if exact[0] // 2 < branch else 1 - branch}:
                branches[other][0] += off
        found = []
        for middle, reach in branches:
            lower = min(max(middle - reach, _LOWEST), _HIGHEST - _NARROWEST)
            found.append((lower, min(max(middle + reach, lower + _NARROWEST), _HIGHEST)))
        return np.array([*found[0], *found[1][::-1]])

    def slopes(self, x: Array) -> Array:
        """(m, m) d(moving ones)/dx, K."""
        steps = _TINY * np.eye(len(x))
        columns = [self.values(x + step) - self.values(x - step) for step in steps]
        return np.asarray(np.column_stack(columns)[self.moving] / (2.0 * _TINY))

    def x_of(self, values: Sequence[float] | Array) -> Array:
        """Inverse of `values`."""
        believed, found = _COORDINATES @ self.mean, _COORDINATES @ np.asarray(values)
        logs = (believed > 0.0) & (found > 0.0)
        logs[0] = False
        found[logs] = believed[logs] * (1.0 + np.log(found[logs] / believed[logs]))
        exact = len(self.moving) < 4  # which place the centre
        rows = slice(1 if exact else 0, None)
        straight = np.linalg.lstsq(
            _COORDINATES[rows, self.moving], (found - believed)[rows], rcond=None
        )[0]
        return np.asarray(np.linalg.solve(self.turn, straight))


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
        low, high = np.clip(np.array(ends, dtype=np.float64).reshape(-1, 2).T, -_REACH, _REACH)
        low[self._together], high[self._together] = -_REACH, _REACH
        return low, high

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
            four = dict(zip(TEMPERATURES, found, strict=True))
            values |= four
            if self.base["wire.law"] == "normal":  # a hysteresis, of widths as these allow
                a_s, a_f, m_s, m_f = found
                apart = abs(a_f - a_s - m_s + m_f) / (2.0 * BRANCH * _WIDEST_SPREAD)
                least = max(_LEAST_HALF_WIDTH, apart)
                lack = max(4.0 * least - (a_s + a_f - m_s - m_f), 0.0) / 2.0
                four[TEMPERATURES[3]] = lower = max(m_f - lack, _LOWEST)
                lack -= m_f - lower
                four[TEMPERATURES[2]] = max(m_s - lack, lower + _NARROWEST)
                values |= four
                values[SPREAD] = nearest_spread(four, values.get(SPREAD, self.base[SPREAD]))
        values |= {other: values[name] for other, name in self.tied.items()}
        return self.base.replace(values)

    def nudged(self, bench: Parameters, x: Array, i: int, step: float) -> Parameters:
        """The bench at x, one of its unknowns moved."""
        item = self.items[i]
        if item.name in (*TEMPERATURES, SPREAD):
            there = x.copy()
            there[i] += step
            return self.parameters(there)
        return bench.replace(dict.fromkeys((item.name, *item.tied), item.value(x[i] + step)))

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

    def of_table(names: Iterable[str]) -> dict[str, tuple[float, float, float]]:
        return {name: (parameters.std(name), *range_of(name)) for name in names}

    own = LOADS.get(load_kind(parameters), ()) if own_load else ()
    if not has_friction(parameters):
        own = tuple(name for name in own if name != FRICTION)
    load_frame |= load_kind(parameters) == "displacement"
    names, shapes = [*HEAT], SHAPES | of_table(stated_effects(parameters))
    if "deflection" in quantities or load_frame:
        names += MATERIAL
        if own:
            shapes |= LOADED_SHAPES if unmodelled else {}
            free = parameters["wire.convection"] == "free"
            shapes |= of_table(
                n for n in UNMODELLED
                if parameters[n] != 0.0 or (unmodelled and not (free and n == _RISE))
            )
            if parameters["wire.law"] == "normal":
                shapes[SPREAD] = (parameters.std(SPREAD), 0.02, 2.0)
            names += [*own, "wire.diameter"]
            names += [] if parameters["wire.length"] else ["wire.mass"]
        elif "deflection" in quantities:
            names += BENDING
        names += LOAD_FRAME if load_frame else ()
    elif "temperature" not in quantities:
        names = ["wire.resistance"]
    return unknowns_of(parameters, names, shapes=shapes, sides_apart=sides_apart)


def has_friction(parameters: Parameters) -> bool:
    """Whether a value or an uncertainty of it is stated; else it is taken as 0, as friction would
    pass for hysteresis."""
    return parameters[FRICTION] > 0.0 or parameters.given_uncertainty.get(FRICTION, 0.0) > 0.0


def as_in_the_field(parameters: Parameters) -> Parameters:
    """The same with typical values for what is not stated: `FIELD`."""
    values = {n: mean for n, (mean, _) in FIELD.items() if n not in parameters.given}
    std = {n: FIELD[n][1] for n in values}
    h = "wire.heat_transfer_coefficient"
    if parameters["wire.convection"] == "free" and h not in parameters.given:
        values[h] = _NOT_STILL * parameters[h]
        std[h] = _FREE_CONVECTION * values[h]
    if not parameters.given.intersection(TEMPERATURES):
        values |= dict(zip(TEMPERATURES, _FIELD_TEMPERATURES, strict=True))
    return parameters.assuming(values, std)


def stated_effects(parameters: Parameters) -> list[str]:
    """Numbers of effects that somebody believes in, or of which he states what is unknown; and of
    these effects those that have a value where nobody gives one."""
    stated = {
        p.name for p in EFFECT_TABLE
        if parameters[p.name] != p.default or p.name in parameters.given_uncertainty
    }
    on = [e for e in EFFECTS.values() if stated & {p.name for p in e.parameters}]
    return [p.name for e in on for p in e.parameters if p.name in stated or p not in e.switches]


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
        low, high = range_of(name)
        if name in BENDING or name in LOAD_NEEDS.get(load_kind(parameters), ()):
            low = _ABOVE_NOTHING * mean
        log = name not in _STRAIGHT and low > 0.0
        # A prior that is wider than the range is as wide as that.
        widest = (mean * math.log(high / low) if log else high - low) / max(std, _SMALLEST)
        std, own = (min(1.0, widest) * one for one in (std, own))
        if std > 0.0:
            found[name] = Unknown(name, mean, std, low, high, log, (), partner, own)
    # One stiffness, where both sides are believed to be equally stiff, and equally well known.
    front, back = found.get(FRONT), found.get(BACK)
    if not sides_apart and front and back and (front.mean, front.std) == (back.mean, back.std):
        found[FRONT] = replace(front, tied=(BACK,))
        del found[BACK]
    fixed = {n: v for n, v in derived.items() if n not in found and parameters[n] != v}
    base = parameters.replace(fixed)

    # Shapes of the kinetics; what is believed is within the range.
    extra = []
    for name, (std, low, high) in shapes.items():
        # Other laws are as smooth as they are, and one has inner loops by itself.
        without = (*SHAPES,) if base["wire.law"] == "normal" else SMOOTHER
        if base["wire.law"] != "cosine" and name in without:
            continue
        mean = float(base[name])
        low, high = min(low, mean), max(high, mean)
        std = min(base.given_uncertainty.get(name, std), high - low)
        if std > 0.0:
            extra.append(Unknown(name, mean, std, low, high, log=bool(BY_NAME[name].default)))
    items = (*found.values(), *extra)
    moving = together if stds else None
    return Unknowns(base, items, len(found), len(items), transitions=moving)


def range_of(name: str) -> tuple[float, float]:
    """Lowest and highest value of a parameter, in its unit."""
    low, high = BY_NAME[name].low, BY_NAME[name].high
    return -math.inf if low is None else float(low), math.inf if high is None else float(high)


def number_of_effect(number: Parameter) -> Unknown:
    """An effect's number, centred where nobody gave another; moved by its logarithm where that is
    not 0."""
    assert number.low is not None and number.high is not None and isinstance(number.default, float)
    std = float(number.uncertainty or 1.0)
    log = number.default != 0.0
    return Unknown(number.name, number.default, std, number.low, number.high, log)


def shares_of_factor(name: str, value: float, parameters: Parameters) -> dict[str, float]:
    """Error of an effect's number by the factor that it enters the model with (`Effect.times`), one
    standard deviation of that; by the factor's name, none for all other numbers."""
    if name not in _TIMES:
        return {}
    factor = _TIMES[name]
    return {factor: -value * parameters.std(factor) / parameters[factor]}

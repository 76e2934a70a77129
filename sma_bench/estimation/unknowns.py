"""The unknowns of a fit: the bench's parameters under their priors, and the numbers of effects.

One list of everything that records can depend on. Records determine some factors only as a product
(h A_c, m c_p): one of them is moved, with the uncertainty of both (`partner`)."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.estimation import transitions
from sma_bench.estimation.transitions import TEMPERATURES, Transitions
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME, EFFECT_PREFIX, EFFECT_TABLE, Parameter
from sma_bench.parameters.parameters import BRANCH, ORIENTING, SMOOTHER, load_kind, nearest_spread
from sma_bench.physics import bending_coefficients
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.residual_strain import FRESH_START

_PRIORS = read_yaml(Path(__file__).with_name("priors.yaml"))
HEAT, IF_STATED, UNMODELLED = (tuple(_PRIORS[k]) for k in ("heat", "if_stated", "unmodelled"))
MATERIAL = (*TEMPERATURES, *_PRIORS["material"])
# One number if front and back are stated alike: a difference is an effect.
FRONT, BACK = "composite.stress_per_deflection_front", "composite.stress_per_deflection_back"
BENDING = ("composite.deflection_per_strain", FRONT, BACK)
LOADS, PRODUCTS, FIELD = _PRIORS["loads"], _PRIORS["products"], _PRIORS["field"]
LAW_EFFECT = "transformation_law"
# Strains and stresses of a load frame depend on the wire's length (from its mass) and section.
LOAD_FRAME = ("wire.mass", "wire.diameter")
SPREAD, END = "wire.hysteresis_spread", "wire.end_length"
Shapes = Mapping[str, Sequence[float]]  # deviation, lowest and highest value by name
SHAPES: Shapes = _PRIORS["shapes"]
# Shares of grains that follow other laws than the cosine: a nuisance if they are few.
OTHER_LAWS: Shapes = {p.name: (0.3, 0.0, 1.0) for p in EFFECTS[LAW_EFFECT].parameters}
_RESIDUAL = "effect.residual_strain.share"  # laws in ORIENTING contain it
_RISE = "effect.temperature_dependent_convection.rise"  # free convection contains it
_FREE_CONVECTION, _NOT_STILL = 0.3, 1.25  # relative error; factor of a room on still air
_WIDEST_SPREAD = 1.5  # of the hystereses of grains
_LONGEST_END = 0.03  # m
_CONDUCTIVITY, _END = 13.0, 0.6  # W/(m K), between NiTi's phases; relative error of a cool end
_LEAST_HALF_WIDTH = 0.1  # K, of the hysteresis with wire.law normal
_TIMES = {f"{EFFECT_PREFIX}{effect.name}.{number}": other
          for effect in EFFECTS.values() for number, other in (effect.times or {}).items()}
_STRAIGHT = {*TEMPERATURES, *_PRIORS["straight"]}
_DERIVED_STD = 0.3  # relative, of bending coefficients that only an assumed geometry gives
_REACH = 30.0  # prior deviations, of x
_STILL = 1e-6  # deviations per prior deviation: x does not move a temperature any more
_LEAST_SHARE = 1e-3  # of its mean: lower bound of a number that cannot be 0
_SMALLEST = 1e-300
_MOST_LOG = 50.0  # change of a logarithm, against overflow
_TINY = 1e-4  # prior deviations, of a finite difference


@dataclass(frozen=True)
class Unknown:
    """One number and its Gaussian prior, in the parameter's unit."""

    name: str
    mean: float
    std: float
    low: float = -math.inf
    high: float = math.inf
    # Its logarithm is moved, because the model mostly depends on products, which are linear in
    # logarithms; `mean` is still that of the value, and `std/mean` that of the logarithm.
    log: bool = False
    tied: tuple[str, ...] = ()  # parameters that take the same value
    partner: str = ""  # the other factor of a product that records determine only as a whole
    own_std: float = 0.0  # part of `std` from this factor, the rest is its partner's

    def value(self, x: float) -> float:
        """In its unit, `x` prior deviations from the mean, within its range."""
        moved = self.mean + self.std * x
        if self.log:
            exponent = self.std / self.mean * x
            moved = self.mean * math.exp(min(max(exponent, -_MOST_LOG), _MOST_LOG))
        return float(min(max(moved, self.low), self.high))

    def x_of(self, value: float) -> float:
        """Inverse of `value`."""
        if not self.log:
            return (value - self.mean) / self.std
        ratio = value / self.mean
        return math.log(ratio) * self.mean / self.std if ratio > 0.0 else -math.inf

    def slope(self, x: float) -> float:
        """Units per prior deviation."""
        return self.std / self.mean * self.value(x) if self.log else self.std


@dataclass(frozen=True)
class Unknowns:
    """Numbers of the bench, shapes of its kinetics, then of effects, as x (k,) prior deviations."""

    base: Parameters  # values of all others
    items: tuple[Unknown, ...]  # in this order
    bench: int  # number of the bench's own
    baseline: int  # number of these and the shapes, which every candidate has
    effects: tuple[str, ...] = ()  # names, in the order of the numbers
    forms: tuple[str, ...] = ()  # of each of these, the usual one being ""
    transitions: Transitions | None = None  # of the temperatures, which are moved together

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(item.name for item in self.items)

    @property
    def bench_names(self) -> tuple[str, ...]:
        return self.names[: self.bench]

    @property
    def tied(self) -> dict[str, str]:
        """Parameters that take another one's value."""
        return {other: item.name for item in self.items for other in item.tied}

    @cached_property
    def _together(self) -> slice:
        """Indices of the temperatures that are moved together."""
        if self.transitions is None:
            return slice(0, 0)
        first = self.names.index(TEMPERATURES[self.transitions.moving[0]])
        return slice(first, first + len(self.transitions.moving))

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest (k,) of x."""
        ends = [(item.x_of(item.low), item.x_of(item.high)) for item in self.items]
        low, high = np.clip(np.array(ends, dtype=np.float64).reshape(-1, 2).T, -_REACH, _REACH)
        low[self._together], high[self._together] = -_REACH, _REACH
        return low, high

    def values(self, x: Array) -> Array:
        """(k,) in their units."""
        parameters = self.parameters(x)
        return np.array([parameters[name] for name in self.names])

    def slopes(self, x: Array) -> Array:
        """(k,) units per deviation of each number; `turn`: how x moves the deviations."""
        return np.array([item.slope(at) for item, at in zip(self.items, x, strict=True)])

    def turn(self, x: Array) -> Array:
        """(k, k) d(`deviations`)/dx: 1 except for temperatures, which move together."""
        turn = np.eye(len(self.items))
        if self.transitions is not None:
            std = self.transitions.std[:, np.newaxis]
            own = self.transitions.slopes(x[self._together]) / std
            if self._grains_apart:
                spread = self.names.index(SPREAD)
                steps = _TINY * np.eye(len(x))[[*range(len(x))[self._together], spread]]
                moved = [np.subtract(self._four(x + d), self._four(x - d)) for d in steps]
                columns = np.column_stack(moved) / (2.0 * _TINY * std)
                own, turn[self._together, spread] = columns[:, :-1], columns[:, -1]
            # At an end of its range x moves a temperature no more; its uncertainty stays.
            still = np.linalg.norm(own, axis=1) < _STILL
            own[still] = np.eye(len(own))[still]
            turn[self._together, self._together] = own
        return turn

    def deviations(self, x: Array) -> Array:
        """(k,) of the numbers from their prior means, each in its own prior deviations."""
        found = x.copy()
        if self.transitions is not None:
            moved = (np.array(self._four(x)) - self.transitions.mean)[self.transitions.moving]
            found[self._together] = moved / self.transitions.std
        return found

    def x_of(self, values: Iterable[float]) -> Array:
        """(k,) of values in their units; not for transition temperatures, which move together."""
        return np.array([item.x_of(v) for item, v in zip(self.items, values, strict=True)])

    def parameters(self, x: Array) -> Parameters:
        """The bench at x."""
        values: dict[str, float] = {}
        for item, at in zip(self.items, x.tolist(), strict=True):  # an effect adds to a nuisance
            own = item.value(at) + values.get(item.name, 0.0)
            values[item.name] = min(max(own, item.low), item.high)
        if self.transitions is not None:
            found = self._four(x)
            four = dict(zip(TEMPERATURES, found, strict=True))
            values |= four
            if self.base["wire.law"] == "normal":  # a positive hysteresis and a possible spread
                a_s, a_f, m_s, m_f = found
                apart = abs(a_f - a_s - m_s + m_f) / (2.0 * BRANCH * _WIDEST_SPREAD)
                least = max(_LEAST_HALF_WIDTH, apart)
                lack = max(4.0 * least - (a_s + a_f - m_s - m_f), 0.0) / 2.0
                four[TEMPERATURES[3]] = lower = max(m_f - lack, transitions.LOWEST)
                lack -= m_f - lower
                four[TEMPERATURES[2]] = upper = max(m_s - lack, lower + transitions.NARROWEST)
                if (lack := 4.0 * least - (a_s + a_f - upper - lower)) > _TINY:  # at the low end
                    four[TEMPERATURES[1]] = finish = min(a_f + lack / 2.0, transitions.HIGHEST)
                    lack -= finish - a_f
                    four[TEMPERATURES[0]] = min(a_s + lack, finish - transitions.NARROWEST)
                values |= four
                values[SPREAD] = nearest_spread(four, values.get(SPREAD, self.base[SPREAD]))
        values |= {other: values[name] for other, name in self.tied.items()}
        return self.base.replace(values)

    @cached_property
    def _grains_apart(self) -> bool:
        """True for a law of grains without stated temperatures: the spreads of the centres and of
        the widths of their hystereses are then independent, and ranges follow from both. If ranges
        and spread were moved, a fit would end, at no cost, at grains that differ in width only."""
        return SPREAD in self.names and not self.base.given.intersection(TEMPERATURES)

    def _four(self, x: Array) -> list[float]:
        """Transition temperatures at x [K]."""
        assert self.transitions is not None
        four = self.transitions.values(x[self._together])
        if self._grains_apart:
            number, known = self.names.index(SPREAD), self.base[SPREAD]
            four = self.transitions.of_grains(four, self.items[number].value(x[number]), known)
        return list(map(float, four))

    def nudged(self, bench: Parameters, x: Array, i: int, step: float) -> Parameters:
        """The bench at x, one of its unknowns moved."""
        item = self.items[i]
        if item.name in (*TEMPERATURES, SPREAD) or self.names.count(item.name) > 1:
            return self.parameters(x + step * (np.arange(len(x)) == i))
        return bench.replace(dict.fromkeys((item.name, *item.tied), item.value(x[i] + step)))

    def holding(self, name: str, x: Array) -> tuple["Unknowns", Array]:
        """Without one number of an effect, which keeps its value at x; and x of the others."""
        if name not in self.names:
            return self, x
        k = self.names.index(name)
        base = self.base.replace({name: self.items[k].value(float(x[k]))})
        items = self.items[:k] + self.items[k + 1 :]
        return replace(self, base=base, items=items), np.delete(x, k)

    def start(self, spread: float = 0.3) -> Array:
        """(k,) prior means, effects off; `spread`: deviations, because at 0 its derivative is 0."""
        return np.array([spread if n == "wire.transition_spread" else 0.0 for n in self.names])

    def with_effects(self, names: Iterable[str], forms: Mapping[str, str] = {}) -> "Unknowns":
        """The same baseline with the numbers of these effects, in their `forms` if any."""
        effects = {name: forms.get(name, "") for name in names}
        numbers = [p for name, form in effects.items() for p in EFFECTS[name].numbers(form)]
        items = (*self.items[: self.baseline], *map(number_of_effect, numbers))
        return replace(self, items=items, effects=(*effects,), forms=(*effects.values(),))


def unknowns_of_records(parameters: Parameters, quantities: Sequence[str], *,
                        load_frame: bool = False, own_load: bool = True, sides_apart: bool = False,
                        unmodelled: bool = False, other_laws: bool = False) -> Unknowns:
    """Everything of the baseline that records of these quantities can depend on. `load_frame`:
    some are of a wire under held loads or between clamps; `own_load`: some are of wires that move
    the load of `load.kind`; `sides_apart`: front and back are two numbers even if they are stated
    alike; `unmodelled`: wires that move a load have all effects of `UNMODELLED`, stated or not;
    `other_laws`: some grains may follow other laws than the cosine, and still air another one."""

    def of_table(names: Iterable[str]) -> dict[str, Sequence[float]]:
        return {name: (parameters.std(name), *range_of(name)) for name in names}

    own = [name for name in LOADS.get(load_kind(parameters), ()) if own_load
           if name not in IF_STATED or is_stated(parameters, name)]
    load_frame |= load_kind(parameters) == "displacement"
    free = parameters["wire.convection"] == "free"
    names, shapes = [*HEAT], {**SHAPES, **of_table(stated_effects(parameters))}
    if other_laws:
        shapes |= {**OTHER_LAWS, **(_PRIORS["still_air"] if free and _RISE not in shapes else {})}
    if "deflection" in quantities or load_frame:
        names += MATERIAL
        shapes |= of_table(ORIENTING.get(parameters["wire.law"], ()))
        shapes |= of_table(n for group in _PRIORS["optional"] if is_stated(parameters, group[0])
                           for n in group)
        if own:
            shapes |= _PRIORS["loaded_shapes"] if unmodelled else {}
            shapes |= of_table(n for n in UNMODELLED
                               if parameters[n] != 0.0 or (unmodelled and not (free and n == _RISE))
                               if not (n == _RESIDUAL and parameters["wire.law"] in ORIENTING))
            if parameters["wire.law"] == "normal":
                shapes[SPREAD] = (parameters.std(SPREAD), 0.02, 2.0)
                if unmodelled or parameters[END]:
                    shapes[END] = (parameters.std(END), 0.0, _LONGEST_END)
            names += [*own, "wire.diameter"]
            names += [] if parameters["wire.length"] else ["wire.mass"]
        elif "deflection" in quantities:
            names += BENDING
        names += LOAD_FRAME if load_frame else ()
    elif "temperature" not in quantities:
        names = ["wire.resistance"]
    return unknowns_of(parameters, names, shapes=shapes, sides_apart=sides_apart)


def is_stated(parameters: Parameters, name: str) -> bool:
    """True if a value other than 0 or an uncertainty of it is stated."""
    return parameters[name] != 0.0 or parameters.given_uncertainty.get(name, 0.0) > 0.0


def as_in_the_field(parameters: Parameters) -> Parameters:
    """The same with typical values for what is not stated: `FIELD`."""
    values = {n: mean for n, (mean, _) in FIELD.items() if n not in parameters.given}
    if parameters["wire.law"] in ORIENTING:
        values.pop(_RESIDUAL, None)
    std = {n: FIELD[n][1] for n in values}
    h = "wire.heat_transfer_coefficient"
    if parameters["wire.convection"] == "free" and h not in parameters.given:
        values[h] = _NOT_STILL * parameters[h]
        std[h] = _FREE_CONVECTION * values[h]
    if parameters["wire.law"] == "normal" and END not in parameters.given:  # as a fin
        loss = 4.0 * values.get(h, parameters[h])
        values[END] = math.sqrt(_CONDUCTIVITY * parameters["wire.diameter"] / loss)
        std[END] = _END * values[END]
    if not parameters.given.intersection(TEMPERATURES):
        values |= dict(zip(TEMPERATURES, transitions.FIELD_TEMPERATURES, strict=True))
    return parameters.assuming(values, std)


def stated_effects(parameters: Parameters) -> list[str]:
    """Numbers of effects with a stated value or uncertainty; and the others of these effects that
    are not 0 by default, except for how a record begins (FRESH_START)."""
    stated = {p.name for p in EFFECT_TABLE
              if parameters[p.name] != p.default or p.name in parameters.given_uncertainty}
    on = [e for e in EFFECTS.values() if stated & {p.name for p in e.parameters}]
    return [p.name for e in on for p in e.parameters
            if p.name in stated or (p not in e.switches and p.name != FRESH_START)]


def unknowns_of(parameters: Parameters, names: Sequence[str], *,
                shapes: Shapes = SHAPES, sides_apart: bool = False) -> Unknowns:
    """Unknowns from the values and the `uncertainty.` of a parameter set; 0 is exact: no unknown.
    Bending coefficients that are derived from the geometry start there, with 30 % unless their
    uncertainty is given. All four transition temperatures or none are among the names."""
    derived = dict(zip(BENDING, bending_coefficients(parameters), strict=True))
    together = Transitions.of(parameters) if TEMPERATURES[0] in names else None
    stds = together.stds if together else {}
    likely = dict(zip(TEMPERATURES, together.mean.tolist(), strict=True)) if together else {}
    found = {}
    for name in names:
        mean = derived.get(name, likely.get(name, parameters[name]))
        std = stds.get(name, 0.0) if name in TEMPERATURES else parameters.std(name)
        if name in derived and name not in parameters.given_uncertainty and not parameters[name]:
            std = max(std, _DERIVED_STD * mean)
        own, partner = std, PRODUCTS.get(name, "")
        partner = "" if partner in names else partner
        if partner:
            std = float(np.hypot(std, parameters.std(partner) / parameters[partner] * mean))
        low, high = range_of(name)
        if name in BENDING or (name, load_kind(parameters)) == ("load.stiffness", "spring"):
            low = _LEAST_SHARE * mean
        log = name not in _STRAIGHT and low > 0.0
        # A prior is at most as wide as the range.
        widest = (mean * math.log(high / low) if log else high - low) / max(std, _SMALLEST)
        std, own = (min(1.0, widest) * one for one in (std, own))
        if std > 0.0:
            found[name] = Unknown(name, mean, std, low, high, log, (), partner, own)
    # One stiffness, if both sides are stated as equally stiff with equal uncertainties.
    front, back = found.get(FRONT), found.get(BACK)
    if not sides_apart and front and back and (front.mean, front.std) == (back.mean, back.std):
        found[FRONT] = replace(front, tied=(BACK,))
        del found[BACK]
    fixed = {n: v for n, v in derived.items() if n not in found and parameters[n] != v}
    base = parameters.replace(fixed)
    # Shapes of the kinetics; their ranges contain the stated values.
    extra = []
    for name, (std, low, high) in shapes.items():
        # The other laws need no smoothing, and normal has inner loops of its own.
        without = (*(SHAPES if base["wire.law"] == "normal" else SMOOTHER), *OTHER_LAWS)
        if base["wire.law"] != "cosine" and name in without:
            continue
        mean = float(base[name])
        low, high = min(low, mean), max(high, mean)
        std = min(base.given_uncertainty.get(name, std), high - low)
        if std > 0.0:
            extra.append(Unknown(name, mean, std, low, high, log=bool(BY_NAME[name].default)))
    items = (*found.values(), *extra)
    return Unknowns(base, items, len(found), len(items), transitions=together if stds else None)


def range_of(name: str) -> tuple[float, float]:
    """Lowest and highest value of a parameter, in its unit."""
    low, high = BY_NAME[name].low, BY_NAME[name].high
    assert low is not None and high is not None  # as for every number
    return float(low), float(high)


def number_of_effect(number: Parameter) -> Unknown:
    """An effect's number about its default, moved by its logarithm where that is not 0."""
    assert isinstance(number.default, float)
    std, log = float(number.uncertainty or 1.0), number.default != 0.0
    return Unknown(number.name, number.default, std, *range_of(number.name), log)


def shares_of_factor(name: str, value: float, parameters: Parameters) -> dict[str, float]:
    """Error of an effect's number from one standard deviation of the parameter that it is
    multiplied with (`Effect.times`), by its name; empty for numbers without one."""
    factors = [_TIMES[name]] if name in _TIMES else []
    return {factor: -value * parameters.std(factor) / parameters[factor] for factor in factors}

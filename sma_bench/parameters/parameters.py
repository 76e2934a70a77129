"""An immutable, validated set of the contract's parameters with their uncertainties."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from typing import Any

from sma_bench.errors import InputError, did_you_mean
from sma_bench.parameters.parameter import BY_NAME, CHOICES, EFFECTS, TABLE, TRANSITIONS, Value

UNCERTAINTY_PREFIX = "uncertainty."
SIDES = ("front", "back")
# standard deviations in the range of a branch with wire.law normal, from 2.5 to 97.5 %
BRANCH = 3.92
_WITHIN = 0.05  # of the possible range: distance of an unstated spread from its ends
GRAVITY = 9.81  # m/s2
STEFAN_BOLTZMANN = 5.670e-8  # W/(m2 K4)
REFERENCE_EXCESS = 60.0  # K above ambient, for which results give the coefficient
OXIDISED = 0.4  # emissivity of a drawn wire with its oxide
_EXCESSES = (30.0, 120.0)  # K, between which the exponent of free convection is taken
_LONGEST_LIST = 800  # characters of a repr
_SPREAD = "wire.hysteresis_spread"
_DEFAULTS: dict[str, Any] = {p.name: p.default for p in TABLE}
_CHANNEL_NAME = re.compile(r"(?!ambient\Z)[A-Za-z][A-Za-z0-9_]*\Z")
# Pairs of which the first must lie below the second.
ORDERED = ((TRANSITIONS["A_s"], TRANSITIONS["A_f"]), (TRANSITIONS["M_f"], TRANSITIONS["M_s"]))
# Laws whose martensite strain depends on the load: where it begins, or its share at 0; its rise.
ORIENTING = {
    "brinson": ("wire.detwinning_start_stress", "wire.detwinning_stress_range"),
    "extended": ("wire.least_strain_share", "wire.orientation_stress"),
}
OF_NORMAL = ("wire.end_length", "wire.transition_skew")  # 0 with any other law
SMOOTHER = ("wire.transition_spread", "wire.transition_tail")  # of the cosine law


def unknown_parameter_message(name: str, known: Iterable[str]) -> str:
    """One line for a name that is in no table, with the nearest known one."""
    return f"unknown parameter {name}{did_you_mean(name, known)}"


def load_kind(parameters: Mapping[str, Any]) -> str:
    """`load.kind`, or if it is not given: clamped for one channel, else beam."""
    default = "clamped" if len(parameters["bench.channels"]) == 1 else "beam"
    return parameters["load.kind"] or default


def idle_effects(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Effects that are on under a load that cannot have them, with what was expected."""
    kind = load_kind(parameters)
    return {name: f"effect {name} with load.kind {kind}, expected {' or '.join(effect.loads)}"
            for name, effect in EFFECTS.items() if kind not in effect.loads
            and effect.is_on(parameters)}


def hysteresis(parameters: Mapping[str, Any]) -> tuple[float, float, float]:
    """Of wire.law normal: deviations [K] of heating and of cooling, mean half width [K]."""
    a_s, a_f, m_s, m_f = (parameters[name] for name in TRANSITIONS.values())
    return (a_f - a_s) / BRANCH, (m_s - m_f) / BRANCH, (a_s + a_f - m_s - m_f) / 4.0


def possible_spread(parameters: Mapping[str, Any]) -> tuple[float, float]:
    """Lowest and highest possible `wire.hysteresis_spread`: beyond these no covariance between
    widths and centres of the grains gives the two branches."""
    heating, cooling, mean = hysteresis(parameters)
    return abs(heating - cooling) / 2.0 / mean, (heating + cooling) / 2.0 / mean


def nearest_spread(parameters: Mapping[str, Any], wanted: float) -> float:
    """The possible spread of hysteresis widths nearest to the wanted one, not quite at an end."""
    low, high = possible_spread(parameters)
    keep = _WITHIN * (high - low)
    return max(min(max(wanted, low + keep), high - keep, BY_NAME[_SPREAD].high), 0.0)


class Parameters(Mapping[str, Value]):
    """Values of all contract parameters in SI units, each with a standard deviation. `given`: names
    whose value or uncertainty someone stated; others are defaults, not knowledge of this bench."""

    def __init__(self, values: Mapping[str, Any] | None = None,
                 uncertainty: Mapping[str, float] | None = None, where: str = "") -> None:
        """Defaults of the table, overridden by `values` (names with `uncertainty.` among them) and
        `uncertainty`. InputError, led by `where`: unknown name, wrong type, out of range, clash."""
        self._values: dict[str, Value] = dict(_DEFAULTS)
        self._std: dict[str, float] = {}
        self._of_size: dict[str, float] = {}  # mass and area by a stated length and diameter
        self.given: frozenset[str] = frozenset()
        self._put(values or {}, uncertainty or {}, where)

    def _put(self, values: Mapping[str, Any], uncertainty: Mapping[str, float], where: str) -> None:
        lead = f"{where}: " if where else ""
        stated = {UNCERTAINTY_PREFIX + name: std for name, std in uncertainty.items()}
        given: set[str] = set()
        for full, value in {**values, **stated}.items():
            name = full.removeprefix(UNCERTAINTY_PREFIX)
            if name not in BY_NAME:
                raise InputError(lead + unknown_parameter_message(name, BY_NAME))
            given.add(name)
            if full == name:
                self._values[name] = BY_NAME[name].validated(value, where)
                continue
            if BY_NAME[name].uncertainty is None:
                raise InputError(f"{lead}{full}: has no uncertainty")
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not 0.0 <= value < math.inf:
                expected = f"expected a standard deviation >= 0 in {BY_NAME[name].unit}"
                raise InputError(f"{lead}{full} is {value!r}, {expected}")
            self._std[name] = float(value)
        self.given |= given
        # A default that contradicts a stated value moves to its usual distance from that.
        for lower, upper in ORDERED:
            if self[lower] >= self[upper] and not {lower, upper} <= self.given:
                width = _DEFAULTS[upper] - _DEFAULTS[lower]
                if upper in self.given:
                    self._values[lower] = self[upper] - width
                else:
                    self._values[upper] = self[lower] + width
        if {"wire.length", "wire.diameter"} <= self.given and (length := self["wire.length"]):
            size = {"wire.mass": NITI_DENSITY * wire_section(self) * length,
                    "wire.surface_area": math.pi * self["wire.diameter"] * length}
            self._of_size = {name: min(max(size[name], BY_NAME[name].low), BY_NAME[name].high)
                             for name in size.keys() - self.given}
            self._values |= self._of_size
        if self["wire.law"] == "normal" and _SPREAD not in self.given and hysteresis(self)[2] > 0.0:
            self._values[_SPREAD] = nearest_spread(self, _DEFAULTS[_SPREAD])
        if "wire.heat_transfer_coefficient" not in self.given:
            h = _DEFAULTS["wire.heat_transfer_coefficient"]
            if self["wire.convection"] == "free":
                surface = (ambient := self["environment.ambient_temperature"]) + REFERENCE_EXCESS
                h = natural_convection(self["wire.diameter"], surface, ambient)
                h += radiation(OXIDISED, surface, ambient)
            self._values["wire.heat_transfer_coefficient"] = h
        if fault := next(self._faults(), ""):
            raise InputError(lead + fault)

    def _faults(self) -> Iterator[str]:
        """Contradictions between values, a line each."""
        for lower, upper in ORDERED:
            if self[lower] >= self[upper]:
                yield f"{lower} {self[lower]:g} K must lie below {upper} {self[upper]:g} K"
        channels, sides, law = self["bench.channels"], self["bench.channel_sides"], self["wire.law"]
        if not channels:
            yield "bench.channels is empty, expected one name or more"
        rule = "(a letter, then letters, digits, underscores; not ambient)"
        for channel in (name for name in channels if not _CHANNEL_NAME.match(name)):
            yield f"bench.channels: {channel!r} cannot name a channel {rule}"
        if len(set(channels)) != len(channels):
            yield f"bench.channels: {list(channels)} has a name twice"
        if len(sides) != len(channels):
            entries = f"{len(sides)} entries, expected {len(channels)} as bench.channels"
            yield f"bench.channel_sides has {entries}"
        for side in (name for name in sides if name not in SIDES):
            yield f"bench.channel_sides: {side!r}, expected front or back"
        for name, choices in CHOICES.items():
            if self[name] not in choices:
                yield f"{name} is {self[name]!r}, expected {', '.join(filter(None, choices))}"
        if law != "cosine":
            yield from self._faults_of_law(law)
        for name in OF_NORMAL if law != "normal" else ():
            if self[name] != 0.0:
                yield f"{name} is {self[name]:g} with wire.law {law}, expected 0, or law normal"
        kind, used = load_kind(self), len(set(sides))
        if kind == "spring" and (stiffness := self["load.stiffness"]) <= 0.0:
            yield f"load.stiffness is {stiffness:g} N/m, expected above 0 with load.kind spring"
        wanted = {"antagonist": 2, "beam": used}.get(kind, 1)
        if used != wanted:
            wants = f"{kind}, expected {'front and back' if wanted == 2 else 'one side'}"
            yield f"bench.channel_sides: {list(sides)} with load.kind {wants}"
        # Loads that can have friction or stiffen, both only without slack.
        for name, loads in (("load.friction", ("clamped", "force", "spring", "antagonist")),
                            ("load.stiffening", ("clamped", "spring"))):
            if self[name] != 0.0 and (kind not in loads or EFFECTS["slack"].is_on(self)):
                against = "effect slack, expected one of them at 0"
                against = against if kind in loads else f"load.kind {kind}, expected 0"
                yield f"{name} is {self[name]:g} {BY_NAME[name].unit} with {against}"
        if kind == "displacement":  # an imposed elongation has neither drift nor slack
            yield from idle_effects(self).values()

    def _faults_of_law(self, law: str) -> Iterator[str]:
        """What `wire.law` excludes."""
        for effect in EFFECTS.values():
            if law not in effect.laws and effect.is_on(self):
                yield f"effect {effect.name} with wire.law {law}, expected {', '.join(effect.laws)}"
        for smoother in SMOOTHER:
            if self[smoother] != 0.0:
                yield f"{smoother} is {self[smoother]:g}, expected 0 with wire.law {law}"
        if law == "normal":
            heating, cooling, mean = hysteresis(self)
            width = f"{2.0 * mean:.4g} K"
            if mean <= 0.0:
                yield f"wire.law normal: the mean hysteresis is {width} wide, expected above 0 K"
            low, high = possible_spread(self)
            spread, high = self[_SPREAD], min(high, BY_NAME[_SPREAD].high)
            if not low - 1e-9 <= spread <= high + 1e-9:
                ranges = f"ranges of {heating * BRANCH:.4g} and {cooling * BRANCH:.4g} K"
                wants = f"expected {low:.3g} to {high:.3g}: {ranges} about a hysteresis of {width}"
                beyond = "cannot come from grains with another spread"
                yield f"{_SPREAD} is {spread:.3g}, {wants} {beyond}"

    @classmethod
    def defaults(cls) -> "Parameters":
        """The table's defaults, none of them stated."""
        return cls()

    @classmethod
    def of_paper(cls) -> "Parameters":
        """The paper's own wire and specimen: the table's numbers, stated."""
        return cls({p.name: p.default for p in TABLE if p.spread is not None and p.default})

    def __getitem__(self, name: str) -> Any:
        try:
            return self._values[name]
        except KeyError:
            raise InputError(unknown_parameter_message(name, BY_NAME)) from None

    @property
    def plain(self) -> Mapping[str, Any]:
        """The values as a plain dictionary, in which many names are looked up fast."""
        return self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        stated = ", ".join(f"{name}={self[name]!r}" for name in sorted(self.given))
        stated = f"{stated[:_LONGEST_LIST]}..." if len(stated) > _LONGEST_LIST else stated
        return f"<Parameters: {len(self.given)} stated: {stated}>"

    def std(self, name: str) -> float:
        """Standard deviation of `name`, absolute, in its unit: the stated one, else the table's of
        a stated value, else its spread. InputError: unknown, or without one (a name, a limit)."""
        value, own = self[name], BY_NAME[name]
        unstated = 0.1 * value if name in self._of_size else own.default_std  # of a drawn wire
        std = own.stated_std(value) if name in self.given else unstated
        if std is None:
            raise InputError(f"{name} has no uncertainty")
        return self._std.get(name, std)

    @property
    def given_uncertainty(self) -> dict[str, float]:
        """Standard deviations that were set by someone."""
        return dict(self._std)

    def replace(self, values: Mapping[str, Any] | None = None,
                uncertainty: Mapping[str, float] | None = None, where: str = "") -> "Parameters":
        """A new set with some values and uncertainties replaced; raises as the constructor does."""
        # Without checking the present values again: a fit makes thousands of sets.
        other = copy(self)
        other._values, other._std = dict(self._values), dict(self._std)
        other._put(values or {}, uncertainty or {}, where)
        return other

    def assuming(self, values: Mapping[str, Any], uncertainty: Mapping[str, float]) -> "Parameters":
        """`replace`, but these do not count as stated."""
        other = self.replace(values, uncertainty)
        other.given = self.given
        return other


NITI_DENSITY = 6450.0  # kg/m3
NITI_EXPANSION = (6.6e-6, 11e-6)  # 1/K, martensite, austenite
CONVECTION_FACTOR = 1.5  # by which a correlation may be off for one wire


def wire_section(parameters: Mapping[str, Any]) -> float:
    """Cross-section [m2] of one wire."""
    return math.pi * float(parameters["wire.diameter"]) ** 2 / 4.0


def wire_length(parameters: Mapping[str, Any]) -> float:
    """Length [m] of the wires: given, or that of their mass."""
    return float(parameters["wire.length"]) or wire_length_from_mass(parameters)


def wire_length_from_mass(parameters: Mapping[str, Any]) -> float:
    """Length [m] of NiTi wire of the given mass and diameter."""
    return float(parameters["wire.mass"]) / (NITI_DENSITY * wire_section(parameters))


def as_recorded(parameters: Parameters) -> Parameters:
    """The bench as in its records, which hold the direct voltage, whatever the drive."""
    direct = parameters["bench.drive"] == "voltage"
    return parameters if direct else parameters.replace({"bench.drive": "voltage"})


# --- Heat loss of a thin wire to still air and by radiation, `wire.convection: free`: h(T) by
# Churchill and Chu (1975) for its diameter, as a power of the excess over air, and grey radiation.
# `wire.heat_transfer_coefficient` is their sum 60 K above ambient, computed unless it is stated.


def natural_convection(diameter: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of a horizontal cylinder in still air by Churchill and
    Chu (1975), at film temperature and 1 atm. `diameter` [m]; `surface` above `ambient` [K]."""
    film = 0.5 * (surface + ambient)
    conductivity, heat_capacity = 0.0241 * (film / 273.15) ** 0.81, 1007.0
    viscosity = 1.716e-5 * (film / 273.15) ** 1.5 * (273.15 + 110.4) / (film + 110.4)
    density = 101325.0 / (287.05 * film)
    prandtl = viscosity * heat_capacity / conductivity
    diffusivity = conductivity / (density * heat_capacity)
    resisted = film * (viscosity / density) * diffusivity
    rayleigh = GRAVITY * (surface - ambient) * diameter**3 / resisted
    shape = (1.0 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)
    return (0.60 + 0.387 * rayleigh ** (1 / 6) / shape) ** 2 * conductivity / diameter


def radiation(emissivity: float, surface: float, ambient: float) -> float:
    """Heat transfer coefficient [W/(m2 K)] of grey radiation to surroundings at `ambient` [K]."""
    return emissivity * STEFAN_BOLTZMANN * (surface**2 + ambient**2) * (surface + ambient)


def free_exponent(diameter: float, ambient: float) -> float:
    """n of convection's part of h, in proportion to (T - ambient)^n."""
    cool, hot = (natural_convection(diameter, ambient + e, ambient) for e in _EXCESSES)
    return math.log(hot / cool) / math.log(_EXCESSES[1] / _EXCESSES[0])

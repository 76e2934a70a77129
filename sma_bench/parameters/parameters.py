"""An immutable, validated set of the contract's parameters with their uncertainties."""

import re
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from typing import Any

from sma_bench.errors import InputError, did_you_mean
from sma_bench.parameters.parameter import LOAD_KINDS, Value
from sma_bench.parameters.table import BY_NAME, TABLE

UNCERTAINTY_PREFIX = "uncertainty."
SIDES = ("front", "back")
DRIVES = ("voltage", "duty", "current")
_LONGEST_LIST = 800  # characters of what stands for a set of parameters
_CHANNEL_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
# What must hold between numbers, beside the range of each in the table: the first below the second,
# and what a load cannot be without, above 0.
ORDERED = (
    ("wire.austenite_start_temperature", "wire.austenite_finish_temperature"),
    ("wire.martensite_finish_temperature", "wire.martensite_start_temperature"),
)
LOAD_NEEDS = {"spring": ("load.stiffness",)}


def unknown_parameter_message(name: str, known: Iterable[str]) -> str:
    """One line for a name that is in no table, with the nearest known one."""
    return f"unknown parameter {name}{did_you_mean(name, known)}"


def load_kind(parameters: Mapping[str, Any]) -> str:
    """`load.kind`, or what is meant where nothing is given: clamped for one channel, else beam."""
    default = "clamped" if len(parameters["bench.channels"]) == 1 else "beam"
    return parameters["load.kind"] or default


class Parameters(Mapping[str, Value]):
    """Values of all contract parameters in SI units, each with a standard deviation.

    `given` holds the names whose value or uncertainty someone stated: what is not in it is a
    default, which fills gaps and is no knowledge of this bench.
    """

    def __init__(
        self, values: Mapping[str, Any] | None = None,
        uncertainty: Mapping[str, float] | None = None, where: str = "",
    ) -> None:
        """Defaults of the table, overridden by `values` and `uncertainty`.

        Raises:
            InputError: unknown name, wrong type, out of range or contradicting values; `where`
                (a file, say) leads the line.
        """
        self._values: dict[str, Value] = {p.name: p.default for p in TABLE}
        self._std: dict[str, float] = {}
        self.given: frozenset[str] = frozenset()
        self._put(values or {}, uncertainty or {}, where)

    def _put(
        self, values: Mapping[str, Any], uncertainty: Mapping[str, float], where: str
    ) -> None:
        self._where = f"{where}: " if where else ""
        for name, value in values.items():
            self._require_known(name)
            self._values[name] = BY_NAME[name].validated(value, where)
        checked = {}
        for name, std in uncertainty.items():
            self._require_known(name)
            if BY_NAME[name].uncertainty is None:
                raise InputError(f"{self._where}{UNCERTAINTY_PREFIX}{name}: has no uncertainty")
            number = isinstance(std, (int, float)) and not isinstance(std, bool)
            if not number or not 0.0 <= std < float("inf"):
                unit = BY_NAME[name].unit
                raise InputError(
                    f"{self._where}{UNCERTAINTY_PREFIX}{name} is {std!r}, "
                    f"expected a standard deviation >= 0 in {unit}"
                )
            checked[name] = float(std)
        self._std |= checked
        self.given |= frozenset(values) | frozenset(uncertainty)
        for pair in ORDERED:
            self._make_way(*pair)
        for lower, upper in ORDERED:
            if self[lower] >= self[upper]:
                raise InputError(
                    f"{self._where}{lower} {self[lower]:g} K must lie below "
                    f"{upper} {self[upper]:g} K"
                )
        channels, sides = self["bench.channels"], self["bench.channel_sides"]
        if not channels:
            raise InputError(f"{self._where}bench.channels is empty, expected one name or more")
        for channel in channels:
            if not _CHANNEL_NAME.match(channel):
                raise InputError(
                    f"{self._where}bench.channels: {channel!r} is not a ROS name "
                    "(a letter, then letters, digits, underscores)"
                )
        if len(set(channels)) != len(channels):
            raise InputError(f"{self._where}bench.channels: {list(channels)} has a name twice")
        if len(sides) != len(channels):
            raise InputError(
                f"{self._where}bench.channel_sides has {len(sides)} entries, "
                f"expected {len(channels)} as bench.channels"
            )
        for side in sides:
            if side not in SIDES:
                raise InputError(
                    f"{self._where}bench.channel_sides: {side!r}, expected front or back"
                )
        self._check_choice("load.kind", ("", *LOAD_KINDS))
        self._check_choice("bench.drive", DRIVES)
        kind, used = load_kind(self), len(set(sides))
        for name in LOAD_NEEDS.get(kind, ()):
            if self[name] <= 0.0:
                raise InputError(
                    f"{self._where}{name} is {self[name]:g} {BY_NAME[name].unit}, expected above 0 "
                    f"with load.kind {kind}"
                )
        wanted = {"antagonist": 2, "beam": used}.get(kind, 1)
        if used != wanted:
            expected = "front and back" if wanted == 2 else "one side"
            raise InputError(
                f"{self._where}bench.channel_sides: {list(sides)} with load.kind {kind}, "
                f"expected {expected}"
            )

    def _make_way(self, lower: str, upper: str) -> None:
        """A default that nobody stated keeps its distance from what was stated beyond it."""
        if self[lower] < self[upper] or {lower, upper} <= self.given:
            return
        width = float(str(BY_NAME[upper].default)) - float(str(BY_NAME[lower].default))
        if upper in self.given:
            self._values[lower] = self[upper] - width
        else:
            self._values[upper] = self[lower] + width

    @classmethod
    def defaults(cls) -> "Parameters":
        """The table as it stands, nothing of it stated."""
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

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        stated = ", ".join(f"{name}={self[name]!r}" for name in sorted(self.given))
        end = "" if len(stated) <= _LONGEST_LIST else "..."
        return f"<Parameters: {len(self.given)} stated: {stated[:_LONGEST_LIST]}{end}>"

    def std(self, name: str) -> float:
        """One standard deviation of `name`, absolute, in its unit: the stated one, else the table's
        uncertainty of a stated value, else the table's spread.

        Raises:
            InputError: the parameter is unknown or has no uncertainty (a name, a limit).
        """
        self[name]
        parameter = BY_NAME[name]
        std = parameter.uncertainty if name in self.given else parameter.default_std
        if std is None:
            raise InputError(f"{name} has no uncertainty")
        return self._std.get(name, std)

    @property
    def given_uncertainty(self) -> dict[str, float]:
        """Standard deviations that were set by someone."""
        return dict(self._std)

    def replace(
        self, values: Mapping[str, Any] | None = None,
        uncertainty: Mapping[str, float] | None = None, where: str = "",
    ) -> "Parameters":
        """A new set with some values and uncertainties replaced; raises as the constructor does."""
        # What is here has been checked: a fit makes thousands of sets.
        other = copy(self)
        other._values, other._std = dict(self._values), dict(self._std)
        other._put(values or {}, uncertainty or {}, where)
        return other

    def _require_known(self, name: str) -> None:
        if name not in BY_NAME:
            raise InputError(self._where + unknown_parameter_message(name, BY_NAME))

    def _check_choice(self, name: str, choices: tuple[str, ...]) -> None:
        if self[name] not in choices:
            expected = ", ".join(choice for choice in choices if choice)
            raise InputError(f"{self._where}{name} is {self[name]!r}, expected {expected}")


def as_recorded(parameters: Parameters) -> Parameters:
    """The bench as its records show it: they hold the direct voltage of the same heat, whatever
    was switched."""
    if parameters["bench.drive"] == "voltage":
        return parameters
    return parameters.replace({"bench.drive": "voltage"})

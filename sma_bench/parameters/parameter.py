"""One parameter of the bench: what it is called, what it may be, and where the number is from."""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from sma_bench.errors import InputError

Kind = Literal["double", "integer", "bool", "string", "strings"]
Value = float | int | bool | str | tuple[str, ...]

_EXPECTED = {
    "double": "a number",
    "integer": "a whole number",
    "bool": "true or false",
    "string": "a string",
    "strings": "a list of strings",
}
_CELSIUS_RANGE = (-100.0, 200.0)
_UNIT_SLIPS = (1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)


@dataclass(frozen=True)
class Parameter:
    """Declaration of one parameter.

    Attributes:
        name: dotted name, the same in files, on nodes and on the command line.
        unit: SI unit, "" for none.
        default: value when nothing else is given.
        description: one sentence for people.
        provenance: paper table or equation, or "assumed: why".
        low, high: inclusive range of a number, in its unit.
        uncertainty: default standard deviation, absolute, in its unit (priors of fits).
        kind: type of the value.
        read_only: a running node cannot change it.
    """

    name: str
    unit: str
    default: Value
    description: str
    provenance: str
    low: float | None = None
    high: float | None = None
    uncertainty: float | None = None
    kind: Kind = "double"
    read_only: bool = False

    def validated(self, value: Any, where: str = "") -> Value:
        """The value in its own type.

        Raises:
            InputError: wrong type, not finite, or outside the range; `where` leads the line.
        """
        prefix = f"{where}: " if where else ""
        converted = self._converted(value)
        if converted is None:
            unit = f" in {self.unit}" if self.unit else ""
            expected = _EXPECTED[self.kind] + unit
            raise InputError(f"{prefix}{self.name} is {value!r}, expected {expected}")
        if isinstance(converted, (int, float)) and not isinstance(converted, bool):
            self._check_range(converted, prefix)
        return converted

    def _converted(self, value: Any) -> Value | None:
        if self.kind == "double":
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            return float(value) if number else None
        if self.kind == "integer":
            return value if isinstance(value, int) and not isinstance(value, bool) else None
        if self.kind == "bool":
            return value if isinstance(value, bool) else None
        if self.kind == "string":
            return value if isinstance(value, str) else None
        if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
            return tuple(value)
        return None

    def _check_range(self, value: float, prefix: str) -> None:
        if not math.isfinite(value):
            raise InputError(f"{prefix}{self.name} is {value}, expected a finite number")
        if self._inside(value):
            return
        low = "-inf" if self.low is None else f"{self.low:g}"
        high = "inf" if self.high is None else f"{self.high:g}"
        unit = f" {self.unit}" if self.unit else ""
        raise InputError(
            f"{prefix}{self.name} is {value:g}{unit}, expected {low} to {high}{unit}"
            + self._unit_hint(value)
        )

    def _inside(self, value: float) -> bool:
        above = self.low is None or value >= self.low
        return above and (self.high is None or value <= self.high)

    def _unit_hint(self, value: float) -> str:
        if self.unit == "K" and _CELSIUS_RANGE[0] <= value <= _CELSIUS_RANGE[1]:
            return " (is it in degrees Celsius?)" if self._inside(value + 273.15) else ""
        for factor in _UNIT_SLIPS:
            if self._inside(value * factor) and self.low != 0.0:
                return f" (times {factor:g} it would fit: wrong unit prefix?)"
        return ""


def fixed(*parameters: Parameter) -> tuple[Parameter, ...]:
    """The same parameters, as ones that a running node cannot change."""
    return tuple(replace(parameter, read_only=True) for parameter in parameters)


MANAGED = Parameter(
    "managed", "", False,
    "Wait for a lifecycle manager's configure and activate, instead of going there at once.",
    "choice", kind="bool", read_only=True,
)

"""Units as loggers write them, by pint: what they measure and how they become SI."""

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from sma_bench.errors import InputError

# As written (lower case, without blanks and brackets) -> as pint calls it. pint knows prefixes and
# some thousand units; this is what loggers write and it does not know, or takes for another one.
_SPELLINGS = {
    "c": "degC", "°c": "degC", "ºc": "degC", "℃": "degC", "degc": "degC", "deg.c": "degC",
    "gradc": "degC", "celsius": "degC", "degreesc": "degC", "°f": "degF", "degf": "degF",
    "f": "degF", "k": "kelvin", "°k": "kelvin",
    "v_rms": "volt", "vrms": "volt", "v(rms)": "volt", "v_eff": "volt", "veff": "volt",
    "volts": "volt", "v": "volt", "mvrms": "millivolt", "mv_rms": "millivolt",
    "amp": "ampere", "amps": "ampere", "a": "ampere", "a_rms": "ampere",
    "sec": "second", "secs": "second", "s": "second", "msec": "millisecond", "ms": "millisecond",
    "usec": "microsecond", "h": "hour", "hr": "hour", "min": "minute", "mins": "minute",
    "%": "percent", "pct": "percent", "percent": "percent", "prozent": "percent",
    "-": "dimensionless", "1": "dimensionless", "0..1": "dimensionless", "0-1": "dimensionless",
    "mm/mm": "dimensionless", "m/m": "dimensionless", "ratio": "dimensionless",
    "n/mm2": "megapascal", "n/mm^2": "megapascal", "n/mm²": "megapascal", "ksi": "kilopsi",
    "gf": "gram_force", "kgf": "kilogram_force", "cn": "centinewton", "n": "newton",
    "in": "inch", "mil": "thou", "mm": "millimeter", "cm": "centimeter", "m": "meter",
    "um": "micrometer",
    "microstrain": "1e-6 dimensionless",
}  # fmt: skip
_CASED = {"mN": "millinewton", "mV": "millivolt", "mA": "milliampere", "MPa": "megapascal",
          "GPa": "gigapascal", "kN": "kilonewton", "mW": "milliwatt"}  # fmt: skip
_ANGLES = {"rad": 1.0, "radian": 1.0, "radians": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295,
           "°": 0.017453292519943295, "grad": 0.017453292519943295, "rev": 6.283185307179586,
           "degree": 0.017453292519943295, "degrees": 0.017453292519943295,
           "turn": 6.283185307179586}  # fmt: skip
_SI = {
    "time": "second", "length": "meter", "voltage": "volt", "current": "ampere",
    "temperature": "kelvin", "force": "newton", "stress": "pascal", "power": "watt",
    "ratio": "dimensionless", "resistance": "ohm",
}  # fmt: skip
# pint evaluates what it is given: 9**9**9 would never end.
_HARMLESS = re.compile(r"[A-Za-zµμΩ][A-Za-zµμΩ_]{0,24}(?:[*/][A-Za-zµμΩ_]{1,12}(?:\^?[23])?)?\Z")


@dataclass(frozen=True)
class Unit:
    """What a unit measures, and value in SI = factor * value + offset."""

    quantity: str
    factor: float
    offset: float = 0.0


@cache
def _registry() -> Any:
    try:
        import pint
    except ImportError:
        raise InputError(
            "units of tables need pint: pip install pint, or apt install python3-pint"
        ) from None
    return pint.UnitRegistry()


@cache
def parse_unit(text: str) -> Unit | None:
    """The unit that a text names; None where it names none that a bench measures.

    `grad` is the German degree, `C` Celsius and `F` Fahrenheit: loggers write no coulombs.
    """
    plain = re.sub(r"[\s()\[\]{}]", "", text)
    lower = plain.lower().replace("µ", "u").replace("μ", "u")
    if not plain or len(plain) > 30:
        return None
    if lower in _ANGLES:
        return Unit("angle", _ANGLES[lower])
    name = _CASED.get(plain) or _SPELLINGS.get(lower)
    if name == "1e-6 dimensionless":
        return Unit("ratio", 1e-6)
    if name is None and not _HARMLESS.match(plain):
        return None
    for word in (name,) if name else (plain, lower):
        found = _from_pint(word)
        if found is not None:
            return found
    return None


def _from_pint(word: str) -> Unit | None:
    registry = _registry()
    try:
        unit = registry.Unit(word)
        for quantity, base in _SI.items():
            if unit.dimensionality == registry.Unit(base).dimensionality:
                zero = float(registry.Quantity(0.0, unit).to(base).magnitude)
                one = float(registry.Quantity(1.0, unit).to(base).magnitude)
                return Unit(quantity, one - zero, zero)
    except Exception:  # pint raises its parser's and Python's own errors for what is no unit
        return None
    return None

"""Result files, written and read back, and their numbers as people read them (docs/topics.md).

The types stand in the rooms that compute them: `identify/identification.py`, `diagnose/result.py`.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

LARGEST = 1 << 24  # bytes of a result file
_LARGEST_NUMBER = 1e100
T = TypeVar("T")


@dataclass(frozen=True)
class Invocation:
    """The command that has made a result, as far as advice on what to do next depends on it."""

    records: tuple[str, ...] = ()
    params: str = ""
    out: str = ""
    report: str = ""


# --- JSON.


def decoded(kind: type[T], document: Any, where: str) -> T:
    """A plain dataclass from what its JSON held; null, for what is not finite, becomes NaN.

    Raises:
        InputError: one line that begins with `where` and names the field.
    """
    import msgspec  # robots that read no results do without

    try:
        return msgspec.convert(_numbers(document), kind)
    except (msgspec.ValidationError, ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{where}: damaged result: {' '.join(str(error).split())}") from None


def _numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    if isinstance(value, (int, float)) and abs(value) > _LARGEST_NUMBER:
        raise ValueError(f"{value!r:.40} is beyond all measure")
    return math.nan if value is None else value


def write_result(path: str | Path, document: dict[str, Any]) -> None:
    """Write a result file, whole or not at all.

    Raises:
        InputError: the folder cannot be written.
    """
    write_text_atomically(path, json_text(document))


def json_text(document: Mapping[str, Any]) -> str:
    """A result as JSON; NaN becomes null so that any reader takes it."""
    return json.dumps(_finite(document), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


# --- Numbers as people read them.


class PaperUnit(NamedTuple):
    """Unit on paper and the factor from SI to it."""

    unit: str
    factor: float


_SCALES = {
    "current": PaperUnit("mA", 1e3), "temperature": PaperUnit("K", 1.0),
    "deflection": PaperUnit("mm", 1e3), "elongation": PaperUnit("mm", 1e3),
    "force": PaperUnit("N", 1.0),
}


def scale_of(signal: str) -> PaperUnit:
    """Of a quantity, or of a signal `channel.quantity`; of an unknown one as it is."""
    return _SCALES.get(signal.rpartition(".")[2], PaperUnit("", 1.0))


def in_print(value: float, signal: str) -> str:
    """An SI value of a signal with its unit on paper, to two or three digits."""
    unit, factor = scale_of(signal)
    return f"{factor * value:.3g} {unit}".rstrip()


def percent(share: float) -> str:
    """A share; what is nearly nothing or all is not rounded to it."""
    if 0.0 < share < 0.005:
        return "below 1 %"
    if 0.995 < share < 1.0:
        return "above 99 %"
    return f"{100.0 * share:.0f} %"


def signed(value: float, form: str) -> str:
    """With its sign, unless it is rounded to nothing."""
    text = f"{value:+{form}}"
    return text if float(text) else text[1:]


def in_unit(number: str, unit: str) -> str:
    """A number as text with its unit, "1" for none."""
    return number if unit in ("", "1") else f"{number} {unit}"


def with_error(value: float, std: float) -> str:
    """`value ± std`, the value to the decimals that the error leaves it."""
    if not (math.isfinite(std) and std > 0.0 and math.isfinite(value)):
        return f"{value:.4g}"
    size = max(abs(value), std)
    digits = math.floor(math.log10(size)) - math.floor(math.log10(std)) + 2
    return f"{value:.{min(max(digits, 2), 8)}g} ± {std:.2g}"

"""Result files of identify and diagnose (docs/topics.md): written, read back, checked, printed."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sma_bench.border import read_json, read_text
from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

# --- How measured quantities are printed for people.


class PaperUnit(NamedTuple):
    """Unit on paper and the factor from SI to it."""

    unit: str
    factor: float


_SCALES = {
    "current": PaperUnit("mA", 1e3), "temperature": PaperUnit("K", 1.0),
    "deflection": PaperUnit("mm", 1e3),
}


def scale_of(signal: str) -> PaperUnit:
    """Of a quantity, or of a signal `channel.quantity`."""
    return _SCALES[signal.rpartition(".")[2]]


def is_known(signal: str) -> bool:
    """Whether it is of a quantity that can be printed."""
    return signal.rpartition(".")[2] in _SCALES


def in_print(signal: str, value: float) -> str:
    """An SI value with its unit on paper, to two or three digits."""
    unit, factor = scale_of(signal)
    return f"{factor * value:.3g} {unit}"


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


# --- Result files of `sma-bench identify` and `diagnose`, read back and checked (docs/topics.md).

# How sentences of `why` begin, or what is in them, by which a card finds them.
DIFFER_MOST = "differ most in"
NEEDS_NONE, NEEDS_OFF = "It needs no parameter", "It needs parameters off"
SOMETHING_ELSE = "That something else is at work"
NOT_COMPARED = "not compared"

LARGEST = 1 << 24
_LARGEST_NUMBER = 1e100
T = TypeVar("T")


@dataclass(frozen=True)
class ShownNumber:
    """A number with one standard deviation, both in `unit`; `systematic` is the part of it that
    more of the same records would not lower, `informed` the share of its information that came from
    the records, NaN where that is not said; `warned`: how many warnings concern it; `stated`: value
    and standard deviation in the parameter file, None where it states none."""

    name: str
    value: float
    std: float
    unit: str
    method: str
    n: int
    systematic: float = 0.0
    informed: float = math.nan
    warned: int = 0
    stated: tuple[float, float] | None = None

    @property
    def statistical(self) -> float:
        """The part of the standard deviation that is not systematic."""
        return math.sqrt(max(self.std**2 - self.systematic**2, 0.0))


class ShownFit(NamedTuple):
    """How the model fits a signal: rms of the residual and noise of a sample in `unit`."""

    verdict: str
    rms: float
    noise: float
    unit: str


class Invocation(NamedTuple):
    """The command that has made a result, as far as advice on what to do next depends on it."""

    records: tuple[str, ...] = ()
    params: str = ""
    out: str = ""
    report: str = ""


@dataclass(frozen=True)
class IdentifyResult:
    """What identify has written; `experiments`: title, source and further numbers of each;
    `correlation`: names, and the correlations of their errors, row by row; `fit`: by signal."""

    path: Path
    parameters: tuple[ShownNumber, ...]
    experiments: tuple[tuple[str, str, tuple[ShownNumber, ...]], ...]
    warnings: tuple[str, ...]
    correlation: tuple[tuple[str, ...], tuple[tuple[float, ...], ...]] = ((), ())
    fit: Mapping[str, ShownFit] = field(default_factory=dict)


@dataclass(frozen=True)
class ShownCandidate:
    """A candidate: its numbers are those of its effects."""

    name: str
    stage: str
    probability: float
    gap: float
    gain: float
    numbers: tuple[ShownNumber, ...]


@dataclass(frozen=True)
class Shrunk:
    """Root mean squares of one held-out quantity in SI units; `ci90` of the fraction."""

    quantity: str
    before: float
    recalibrated: float
    after: float
    noise: float
    fraction: float
    ci90: tuple[float, float]


@dataclass(frozen=True)
class Proposed:
    """What to measure next; `minutes` and `chance` that it settles the matter, NaN if not said."""

    kind: str
    why: str
    name: str
    separates: tuple[str, ...]
    minutes: float
    chance: float


@dataclass(frozen=True)
class DiagnoseResult:
    """What diagnose has written.

    `where`: signal, phase, side, gap over noise, share, rms; `chain`: block, gap over noise, its
    90 % interval.
    """

    path: Path
    verdict: str
    cause: tuple[str, ...]
    stage: str
    candidates: tuple[ShownCandidate, ...]
    where: tuple[tuple[str, str, str, float, float, float], ...]
    chain: tuple[tuple[str, float, float, float], ...]
    shrinkage: tuple[Shrunk, ...]
    why: tuple[str, ...]
    next_experiment: Proposed | None
    warnings: tuple[str, ...]


def read_result(path: str | Path) -> IdentifyResult | DiagnoseResult:
    """Read a result file, whichever command has written it.

    Raises:
        InputError: unreadable, not JSON, or not a result; one line that names what is missing.
    """
    path = Path(path)
    document = read_json(read_text(path, LARGEST), str(path), LARGEST)
    if not isinstance(document, dict):
        raise InputError(f"{path}: not a result of identify or diagnose: expected an object")
    if "verdict" in document:
        return diagnosis_from(path, document)
    if "parameters" not in document:
        raise InputError(f"{path}: not a result of identify or diagnose: neither parameters nor "
                         "verdict in it")
    return identification_from(path, document)


def identification_from(path: Path, document: Any) -> IdentifyResult:
    """An identification from what its JSON held; `path` leads the line of an InputError."""
    return _checked(_identification, path, document)


def diagnosis_from(path: Path, document: Any) -> DiagnoseResult:
    """A diagnosis from what its JSON held; `path` leads the line of an InputError."""
    return _checked(_diagnosis, path, document)


def _checked(read: Callable[[Path, Any], T], path: Path, document: Any) -> T:
    try:
        return read(path, document)
    except (KeyError, IndexError) as error:
        raise InputError(f"{path}: damaged result: no {error.args[0]} in it") from None
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: damaged result: {reason}") from None


def _identification(path: Path, document: dict[str, Any]) -> IdentifyResult:
    experiments = []
    for found in document["experiments"]:
        title = f"{_text(found['name'])} {_text(found['title'])}"
        details = _numbers({**found["estimates"], **found["details"]})
        experiments.append((title, _text(found["source"]), details))
    return IdentifyResult(
        path, _numbers(document["parameters"]), tuple(experiments),
        _each(_text, document["warnings"]), _correlation(document.get("correlation")),
        {_text(name): _fit(found) for name, found in document.get("fit", {}).items()},
    )


def _fit(found: dict[str, Any]) -> ShownFit:
    verdict = _text(found["verdict"])
    if verdict not in ("ok", "imperfect", "misfit"):
        raise ValueError(f"fit {verdict!r:.40} is not ok, imperfect or misfit")
    return ShownFit(verdict, _number(found["rms"]), _number(found["noise"]), _text(found["unit"]))


def _correlation(
    found: dict[str, Any] | None,
) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
    """Names and rows; both empty where an older version has written the file."""
    if found is None:
        return (), ()
    names = _each(_text, found["names"])
    rows = _each(lambda row: _each(_number, row), found["matrix"])
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        raise ValueError(f"correlation of {len(names)} names is not as many rows and columns")
    return names, rows


def _diagnosis(path: Path, document: dict[str, Any]) -> DiagnoseResult:
    where = document["where"]
    following = document["next_experiment"]
    return DiagnoseResult(
        path, _text(document["verdict"]), _each(_text, document["cause"]), _text(where["stage"]),
        _each(_candidate, document["candidates"]), _each(_cell, where["table"]),
        _each(_link, where.get("chain", [])),
        tuple(_shrunk(name, s) for name, s in document["shrinkage"].items()),
        _each(_text, document.get("why", [])),
        _proposed(following) if following else None,
        _each(_text, document.get("findings", [])),
    )


def _proposed(found: dict[str, Any]) -> Proposed:
    return Proposed(
        _text(found.get("kind", "protocol")), _text(found["why"]),
        _text(found.get("protocol", {}).get("name", "")),
        _each(_text, found.get("separates", [])), _number(found.get("minutes")),
        _number(found.get("chance")),
    )


def _candidate(found: dict[str, Any]) -> ShownCandidate:
    return ShownCandidate(
        _text(found["name"]), _text(found["stage"]), _number(found["probability"]),
        _number(found.get("gap_over_noise")), _number(found.get("log_evidence")),
        _numbers(found["parameters"]),
    )


def _cell(found: dict[str, Any]) -> tuple[str, str, str, float, float, float]:
    names = ("gap", "share", "rms")
    gap, share, rms = (_number(found[name]) for name in names)
    return _signal(found["signal"]), _text(found["phase"]), _text(found["side"]), gap, share, rms


def _link(found: dict[str, Any]) -> tuple[str, float, float, float]:
    low, high = _each(_number, found["ci90"])
    return _text(found["block"]), _number(found["gap"]), low, high


def _shrunk(quantity: str, found: dict[str, Any]) -> Shrunk:
    low, high = _each(_number, found["ci90"])
    names = ("rmse_before", "rmse_after", "noise_floor", "fraction")
    before, after, noise, fraction = (_number(found[name]) for name in names)
    moved = _number(found.get("rmse_recalibrated"))
    return Shrunk(_signal(quantity), before, moved, after, noise, fraction, (low, high))


def _numbers(found: dict[str, Any]) -> tuple[ShownNumber, ...]:
    return tuple(
        ShownNumber(
            name, _number(entry["value"]), _number(entry["std"]), _text(entry["unit"]),
            _text(entry.get("method", "")), int(entry.get("n", 0)),
            _number(entry.get("systematic", 0.0)), _number(entry.get("informed")),
            len(entry.get("warnings", [])), _stated(entry.get("stated")),
        )
        for name, entry in found.items()
    )


def _stated(found: dict[str, Any] | None) -> tuple[float, float] | None:
    return None if found is None else (_number(found["value"]), _number(found["std"]))


def _each(read: Callable[[Any], T], found: list[Any]) -> tuple[T, ...]:
    if not isinstance(found, list):
        raise TypeError(f"{found!r:.40} is not a list")
    return tuple(read(entry) for entry in found)


def _text(found: Any) -> str:
    if not isinstance(found, str):
        raise TypeError(f"{found!r:.40} is not a text")
    return found


def _signal(found: Any) -> str:
    if not is_known(_text(found)):
        raise ValueError(f"{found!r:.40} is no signal that a diagnosis looks at")
    return found


def _number(found: Any) -> float:
    """A number; null, which stands for what is not finite, becomes NaN."""
    if found is None:
        return math.nan
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        raise TypeError(f"{found!r:.40} is not a number")
    if abs(found) > _LARGEST_NUMBER:
        raise ValueError(f"{found!r:.40} is beyond all measure")
    return float(found)


# --- What a result says of the gap, in lines of `~/gap`.

NO_GAP = "no_gap"
AT_NOISE = 1.05  # rms of the error over the noise of a sample: nothing to shrink


@dataclass(frozen=True)
class GapState:
    """One line of `~/gap`: whether there is a gap, in words and in numbers."""

    name: str
    is_gap: bool
    message: str
    values: dict[str, str]


def gap_states(result: Mapping[str, Any]) -> list[GapState]:
    """The gap as a whole, and one state a measured quantity.

    Args:
        result: of a diagnosis, read from its JSON.
    """
    is_gap = result["verdict"] != NO_GAP
    where = {key: str(result["where"][key]) for key in ("signal", "phase", "side", "stage")}
    probability = f"{result['candidates'][0]['probability']:.3f}"
    whole = GapState(
        "sim-to-real gap", is_gap, _message(result),
        {"verdict": result["verdict"], "probability": probability, **where},
    )
    return [whole, *(_of(q, s, is_gap) for q, s in result["shrinkage"].items())]


def _message(result: Mapping[str, Any]) -> str:
    likely = [c["name"] for c in result["candidates"] if c["probability"] > 0.1]
    return {
        "effect": f"explained by {' and '.join(result['cause'])}",
        "recalibration": "the parameters are off",
        NO_GAP: "none beyond the noise",
        "ambiguous": f"one of {', '.join(likely)}",
        "unexplained": "no effect of the library explains it",
    }[result["verdict"]]


def _of(quantity: str, shrinkage: Mapping[str, Any], is_gap: bool) -> GapState:
    # JSON has null for a number that does not exist.
    numbers = {key: math.nan if value is None else value for key, value in shrinkage.items()}
    times = numbers["rmse_before"] / numbers["noise_floor"]
    shown = is_gap and times > AT_NOISE
    message = f"{times:.1f} times the noise"
    if shown:
        message += f", {100.0 * numbers['fraction']:.0f} % of the gap gone with the improvement"
    keys = ("rmse_before", "rmse_after", "noise_floor", "fraction")
    values = {key: f"{numbers[key]:.4g}" for key in keys}
    return GapState(f"sim-to-real gap: {quantity}", shown, message, values)


# --- Written.

def write_result(path: str | Path, document: dict[str, Any]) -> None:
    """Write a result file, whole or not at all.

    Raises:
        InputError: the folder cannot be written.
    """
    write_text_atomically(path, json_text(document))


def json_text(document: dict[str, Any]) -> str:
    """A result as JSON; NaN becomes null so that any reader takes it."""
    return json.dumps(_finite(document), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

"""What a diagnosis says, read from its JSON and checked against every clause of the contract."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError

# --- The words of the contract that a case's label and an answer share.

STAGES = ("electrical", "thermal", "transformation", "mechanical", "sensor")
PHASES = ("drive", "rest", "initial")
VERDICTS = ("effect", "recalibration", "no_gap", "ambiguous", "unexplained")

NO_GAP, RECALIBRATION, UNEXPLAINED = "no_gap", "recalibration", "unexplained"
# Candidates that are no effect and so have no stage.
NO_EFFECT = (RECALIBRATION, NO_GAP, UNEXPLAINED)

# Every effect name of the contract and the stage in which it acts.
STAGE_OF = {
    "phase_dependent_resistance": "electrical",
    "supply_drop": "electrical",
    "latent_heat": "thermal",
    "temperature_dependent_convection": "thermal",
    "matrix_thermal_mass": "thermal",
    "side_heat_coupling": "thermal",
    "ambient_drift": "thermal",
    "partial_transformation": "transformation",
    "transition_drift": "transformation",
    "stress_dependent_transition": "transformation",
    "residual_strain": "mechanical",
    "viscoelastic_matrix": "mechanical",
    "opposing_wires": "mechanical",
    "side_asymmetry": "mechanical",
    "slack": "mechanical",
    "temperature_underfill": "sensor",
    "temperature_lag": "sensor",
    "deflection_drift": "sensor",
}


# --- What a diagnosis says, read from its JSON and checked against every clause of the contract.

PAIR_SIGN = "+"
SIDES = ("front", "back", "both", "")
# Probabilities are printed with four decimals and may be twenty.
SUM_TOLERANCE = 2e-3


@dataclass(frozen=True)
class Estimate:
    """One number of an effect; `std` is NaN where none was stated."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """One explanation; a joint one of two effects is called `one+other`."""

    name: str
    stage: str
    probability: float
    parameters: Mapping[str, Estimate] = field(default_factory=dict)

    @property
    def parts(self) -> frozenset[str]:
        """The effects that it is made of."""
        return frozenset(self.name.split(PAIR_SIGN))


@dataclass(frozen=True)
class Where:
    """Where the gap is; `table` is the answer's own breakdown."""

    signal: str
    phase: str
    side: str
    stage: str
    table: Sequence[Any] = ()


@dataclass(frozen=True)
class Claim:
    """How far a signal's gap is said to shrink.

    `fraction` is the share of the reducible gap that is gone, 1 - a/b with a and b the gap's
    noise-free root mean square after and before (a^2 = rmse_after^2 - noise_floor^2); it and its
    90 % interval are NaN where there was no gap to shrink.
    """

    rmse_before: float
    rmse_after: float
    fraction: float
    ci90: tuple[float, float]
    noise_floor: float


@dataclass(frozen=True)
class NextExperiment:
    """What to measure to break a tie; `protocol` as in a protocol file."""

    why: str
    separates: tuple[str, ...]
    protocol: Mapping[str, Any]


@dataclass(frozen=True)
class Answer:
    """A diagnosis result of the contract, section 5; candidates in order of probability."""

    verdict: str
    cause: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    where: Where | None = None
    shrinkage: Mapping[str, Claim] = field(default_factory=dict)
    next_experiment: NextExperiment | None = None


def read_answer(path: str | Path) -> Answer:
    """The answer in a JSON file.

    Raises:
        InputError: unreadable, not JSON, or against the contract; one line.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {str(error).splitlines()[0]}") from None
    return checked_answer(document, str(path))


def checked_answer(document: Any, where: str = "answer") -> Answer:
    """An Answer from the plain document of a diagnosis.

    Raises:
        InputError: the first clause of the contract that is broken, with its place and value.
    """
    try:
        return _checked(document, where)
    except InputError as error:  # the answer's own names may hold anything
        raise InputError(" ".join(str(error).split())) from None


def _checked(document: Any, where: str) -> Answer:
    keys = ("verdict", "cause", "candidates", "where", "shrinkage", "next_experiment")
    document = _mapping(document, where, keys)
    verdict = _choice(document["verdict"], VERDICTS, f"{where}: verdict")
    candidates = _candidates(document["candidates"], f"{where}: candidates")
    cause = _texts(document["cause"], f"{where}: cause")
    _check_cause(verdict, cause, candidates, where)
    place = _where(document["where"], f"{where}: where")
    if place is None and verdict != NO_GAP:
        raise InputError(f"{where}: where is empty, expected signal, phase, side and stage")
    return Answer(
        verdict,
        cause,
        tuple(sorted(candidates, key=lambda c: -c.probability)), place,
        _shrinkage(document["shrinkage"], f"{where}: shrinkage"),
        _next_experiment(document["next_experiment"], candidates, f"{where}: next_experiment"),
    )


def _check_cause(
    verdict: str, cause: tuple[str, ...], candidates: Sequence[Candidate], where: str
) -> None:
    if bool(cause) != (verdict == "effect"):
        expected = "one effect or more" if verdict == "effect" else "none"
        raise InputError(
            f"{where}: cause is {list(cause)} with the verdict {verdict}, expected {expected}"
        )
    known = frozenset[str]().union(*(c.parts for c in candidates)) - frozenset(NO_EFFECT)
    for name in cause:
        if name not in known:
            raise InputError(f"{where}: cause {name!r} is not among the candidates")


def _candidates(value: Any, where: str) -> list[Candidate]:
    if not isinstance(value, list) or not value:
        raise InputError(f"{where} is {_short(value)}, expected a list of one or more")
    found = [_candidate(entry, f"{where}[{k}]") for k, entry in enumerate(value)]
    names = [candidate.name for candidate in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{where}: {name} is listed twice")
    for name in NO_EFFECT:
        if name not in names:
            raise InputError(f"{where}: {name} is missing")
    total = math.fsum(candidate.probability for candidate in found)
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise InputError(f"{where}: probabilities sum to {total:.4f}, expected 1")
    return found


def _candidate(value: Any, where: str) -> Candidate:
    entry = _mapping(value, where, ("name", "probability"))
    name = _text(entry["name"], f"{where}: name")
    probability = _number(entry["probability"], f"{where}: probability of {name}", 0.0, 1.0)
    stage = entry.get("stage") or ""
    if name not in NO_EFFECT and PAIR_SIGN not in name:
        _choice(stage, STAGES, f"{where}: stage of {name}")
        if stage != STAGE_OF.get(name, stage):
            raise InputError(f"{where}: stage of {name} is {stage}, expected {STAGE_OF[name]}")
    parameters = _mapping(entry.get("parameters") or {}, f"{where}: parameters")
    estimates = {
        key: _estimate(number, f"{where}: parameters: {key}") for key, number in parameters.items()
    }
    return Candidate(name, str(stage), probability, estimates)


def _estimate(value: Any, where: str) -> Estimate:
    entry = _mapping(value, where, ("value", "std", "unit"))
    number = _number(entry["value"], f"{where}: value")
    std = _number_or_nan(entry["std"], f"{where}: std", 0.0)
    if not isinstance(entry["unit"], str):
        raise InputError(f"{where}: unit is {_short(entry['unit'])}, expected a text")
    return Estimate(number, std, entry["unit"])


def _where(value: Any, where: str) -> Where | None:
    if not value:
        return None
    entry = _mapping(value, where, ("signal", "phase", "side", "stage"))
    return Where(
        _text(entry["signal"], f"{where}: signal"),
        _choice(entry["phase"], PHASES, f"{where}: phase"),
        _choice(entry["side"] or "", SIDES, f"{where}: side"),
        _choice(entry["stage"], STAGES, f"{where}: stage"),
        entry.get("table") or (),
    )


def _shrinkage(value: Any, where: str) -> dict[str, Claim]:
    claims = {}
    for signal, entry in _mapping(value or {}, where).items():
        here = f"{where}: {signal}"
        keys = ("rmse_before", "rmse_after", "fraction", "ci90", "noise_floor")
        entry = _mapping(entry, here, keys)
        fraction = _number_or_nan(entry["fraction"], f"{here}: fraction", high=1.0)
        before, after, floor = (
            _number(entry[key], f"{here}: {key}", 0.0)
            for key in ("rmse_before", "rmse_after", "noise_floor")
        )
        interval = _interval(entry["ci90"], fraction, f"{here}: ci90")
        claims[signal] = Claim(before, after, fraction, interval, floor)
    return claims


def _interval(value: Any, fraction: float, where: str) -> tuple[float, float]:
    if math.isnan(fraction):
        return math.nan, math.nan
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{where} is {_short(value)}, expected [low, high]")
    low, high = (_number(bound, where) for bound in value)
    if not low <= fraction <= high:
        raise InputError(f"{where} is [{low:g}, {high:g}], expected to hold {fraction:g}")
    return low, high


def _next_experiment(
    value: Any, candidates: Sequence[Candidate], where: str
) -> NextExperiment | None:
    if not value:
        return None
    entry = _mapping(value, where, ("why", "separates", "protocol"))
    separates = _texts(entry["separates"], f"{where}: separates")
    known = {candidate.name for candidate in candidates}
    for name in separates:
        if name not in known:
            raise InputError(f"{where}: separates {name!r}, which is not among the candidates")
    why = entry["why"]
    if not isinstance(why, str):
        raise InputError(f"{where}: why is {_short(why)}, expected a text")
    protocol = _mapping(entry["protocol"] or {}, f"{where}: protocol")
    return NextExperiment(why, separates, protocol)


def _mapping(value: Any, where: str, keys: Sequence[str] = ()) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where}: is {_short(value)}, expected a mapping")
    for key in keys:
        if key not in value:
            raise InputError(f"{where}: {key} is missing")
    return value


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"{where} is {_short(value)}, expected a name")
    return value


def _texts(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise InputError(f"{where} is {_short(value)}, expected a list of names")
    return tuple(_text(entry, where) for entry in value)


def _choice(value: Any, choices: Sequence[str], where: str) -> str:
    if value not in choices:
        raise InputError(f"{where} is {_short(value)}, expected one of {', '.join(choices)}")
    return str(value)


def _number_or_nan(
    value: Any, where: str, low: float = -math.inf, high: float = math.inf
) -> float:
    return math.nan if value is None else _number(value, where, low, high)


def _number(value: Any, where: str, low: float = -math.inf, high: float = math.inf) -> float:
    ordinary = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not ordinary or not math.isfinite(value) or not low <= value <= high:
        span = "a finite number"
        if math.isfinite(low):
            span = f"{low:g} to {high:g}" if math.isfinite(high) else f"{low:g} or more"
        elif math.isfinite(high):
            span = f"{high:g} or less"
        raise InputError(f"{where} is {_short(value)}, expected {span}")
    return float(value)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

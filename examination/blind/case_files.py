"""Files of an examination: answers checked against the contract, cases, and sealed labels."""

import hashlib
import json
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

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
    """What to measure next: a `protocol` as in a protocol file, with `quantities` measured beside
    those of the case, or a test of `parameters` to standard deviations, of which `kind`."""

    why: str
    separates: tuple[str, ...]
    protocol: Mapping[str, Any]
    parameters: Mapping[str, float] = field(default_factory=dict)
    quantities: tuple[str, ...] = ()
    kind: str = "protocol"


@dataclass(frozen=True)
class Answer:
    """A diagnosis result of the contract, section 5; candidates in order of probability."""

    verdict: str
    cause: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    where: Where | None = None
    shrinkage: Mapping[str, Claim] = field(default_factory=dict)
    next_experiment: NextExperiment | None = None


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
    tested = _mapping(entry.get("parameters") or {}, f"{where}: parameters")
    stds = {n: _number(v, f"{where}: parameters: {n}", 0.0) for n, v in tested.items()}
    quantities = _texts(entry.get("quantities") or [], f"{where}: quantities")
    kind = _text(entry.get("kind", "protocol"), f"{where}: kind")
    return NextExperiment(why, separates, protocol, stds, quantities, kind)


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


# --- A set of cases as the examination sees it: folders and names, and labels that stay sealed.

MANIFEST, CASES, LABELS, ANSWERS = "manifest.json", "cases", "labels.sealed", "answers"
_CASE_NAME = re.compile(r"[0-9A-Za-z_]+\Z")


@dataclass(frozen=True)
class CaseSet:
    """What a manifest says.

    Attributes:
        root: folder of the set.
        names: of the cases, each a folder below `folder`.
        seed, split: that made it.
        sealed_sha256: of the labels' file.
    """

    root: Path
    names: tuple[str, ...]
    seed: int
    split: str
    sealed_sha256: str

    @property
    def folder(self) -> Path:
        """Where the cases lie."""
        return self.root / CASES

    @property
    def answers(self) -> Path:
        """Where answers lie by default."""
        return self.root / ANSWERS

    def labels(self) -> list[dict[str, Any]]:
        """The sealed labels; raises InputError unless they are the ones that the manifest names."""
        return unseal(self.root / LABELS, self.sealed_sha256)


def read_case_set(root: str | Path) -> CaseSet:
    """The set in a folder that `./bench blind make` has written; labels are not touched.

    Raises:
        InputError: no such folder, or a damaged manifest.
    """
    path = Path(root) / MANIFEST
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not JSON") from None
    try:
        names = tuple(_name(entry) for entry in document["cases"])
        found = CaseSet(
            Path(root), names, int(document["seed"]), str(document["split"]), document["sha256"]
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}") from None
    if not names:
        raise InputError(f"{path}: names no cases")
    return found


def _name(entry: Any) -> str:
    if not isinstance(entry, str) or not _CASE_NAME.match(entry):
        raise ValueError(f"case {entry!r}")
    return entry


# --- Labels under seal: one deflated file whose digest the manifest names.

_HEAD = b"sma-bench labels, sealed: only the scorer opens them, after the last answer\n"


def seal(path: Path, labels: Sequence[dict[str, Any]]) -> str:
    """Write labels to a new file; the sha256 of the file."""
    text = json.dumps(list(labels), separators=(",", ":"), allow_nan=False)
    content = _HEAD + zlib.compress(text.encode(), 9)
    path.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def unseal(path: str | Path, sha256: str | None = None) -> list[dict[str, Any]]:
    """The labels of a sealed file.

    Args:
        path: the file.
        sha256: that it must have; None takes any.

    Raises:
        InputError: unreadable, no sealed labels, or not the ones that were sealed.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(f"{path}: not the labels that the manifest names (sha256 differs)")
    try:
        if not content.startswith(_HEAD):
            raise ValueError("head")
        labels = json.loads(zlib.decompress(content[len(_HEAD) :]))
    except (ValueError, zlib.error):
        raise InputError(f"{path}: damaged, expected labels sealed by blind make") from None
    return list(labels)


# --- The folder of one examinee's answers: one folder a case, and who gave them to which set.
#
#     examination.json            program, time limit, sha256 of the set's sealed labels
#     0001/answer.json            {"case", "line", "seconds", "result"}: written last
#     0001/improved.yaml          the parameters with the cause in them
#     after_1/0001/               the same after the suggested experiment; at most three

ANSWER, IMPROVED, EXAMINATION = "answer.json", "improved.yaml", "examination.json"
FOLLOW_UPS = ("after_1", "after_2", "after_3")


@dataclass(frozen=True)
class Kept:
    """One answer as it was given; `answer` is None where `line` says why it failed."""

    case: str
    answer: Answer | None
    line: str
    seconds: float
    improved: Path | None


@dataclass(frozen=True)
class Examination:
    """Who was examined on what.

    Attributes:
        name: how tables call the examinee.
        program: command line that takes the arguments of `sma-bench diagnose`.
        time_limit: s for one case.
        sealed: sha256 of the labels of the set.
    """

    name: str
    program: tuple[str, ...]
    time_limit: float
    sealed: str


def keep(
    folder: Path, case: str, result: Any, line: str, seconds: float, improved: str | None = None
) -> None:
    """Keep an answer (result None: failed, line says why); it is there once answer.json is.

    Args:
        folder: of the examinee; case: its name.
        result: plain document of the answer; improved: text of its parameter file.

    Raises:
        InputError: the folder cannot be written.
    """
    place = folder / case
    try:
        place.mkdir(parents=True, exist_ok=True)
        (place / IMPROVED).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{place}: cannot write: {error.strerror}") from None
    if improved is not None:
        write_text_atomically(place / IMPROVED, improved)
    document = {"case": case, "line": line, "seconds": round(seconds, 3), "result": result}
    write_text_atomically(place / ANSWER, json.dumps(document, indent=1) + "\n")


def is_kept(folder: Path, case: str) -> bool:
    """Whether the case has been answered, or has failed."""
    return (folder / case / ANSWER).is_file()


def read_kept(folder: Path, case: str) -> Kept:
    """The answer to a case.

    Raises:
        InputError: there is none, or its file is damaged.
    """
    path = folder / case / ANSWER
    document = _read(path)
    result, seconds = document.get("result"), document.get("seconds", math.nan)
    answer = None if result is None else checked_answer(result, str(path))
    improved = folder / case / IMPROVED
    return Kept(
        case, answer, document.get("line", ""), seconds, improved if improved.is_file() else None
    )


def answers_of(folder: Path, case: str) -> list[Kept]:
    """The answer to a case, and those after each experiment that was performed for it."""
    places = [folder, *(folder / name for name in FOLLOW_UPS)]
    return [read_kept(place, case) for place in places if is_kept(place, case)]


def write_examination(folder: Path, examination: Examination) -> None:
    """Begin a folder of answers, or go on with it.

    Raises:
        InputError: the folder holds answers to another set or of another program.
    """
    path = folder / EXAMINATION
    if path.is_file():
        there = read_examination(folder)
        if there.sealed != examination.sealed:
            raise InputError(f"{folder}: holds answers to another set of cases")
        # The interpreter may lie elsewhere by now.
        if (there.name, there.program[1:]) != (examination.name, examination.program[1:]):
            raise InputError(f"{folder}: holds the answers of {' '.join(there.program)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    write_text_atomically(path, json.dumps(vars(examination), indent=1) + "\n")


def read_examination(folder: Path) -> Examination:
    """Who gave the answers of a folder.

    Raises:
        InputError: nobody, or the file is damaged.
    """
    document = _read(folder / EXAMINATION)
    try:
        return Examination(
            document["name"],
            tuple(document["program"]),
            float(document["time_limit"]),
            document["sealed"],
        )
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{folder / EXAMINATION}: damaged") from None


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file: run ./bench blind run first") from None
    except (OSError, ValueError, RecursionError):
        raise InputError(f"{path}: damaged") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: damaged")
    return document

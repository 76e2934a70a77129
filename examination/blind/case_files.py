"""Files of an examination: answers checked against the contract, cases, and sealed labels."""

import hashlib
import json
import math
import zlib
from collections import namedtuple
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

# --- Names of the contract that labels and answers share.
STAGES = ("electrical", "thermal", "transformation", "mechanical", "sensor")
VERDICTS = ("effect", "recalibration", "no_gap", "ambiguous", "unexplained")
NO_GAP, RECALIBRATION, UNEXPLAINED = "no_gap", "recalibration", "unexplained"
# Candidates that are no effect and so have no stage.
NO_EFFECT = (RECALIBRATION, NO_GAP, UNEXPLAINED)
# Every effect name of the contract and the stage in which it acts.
_EFFECTS_OF = {
    "electrical": "phase_dependent_resistance supply_drop",
    "thermal": "latent_heat temperature_dependent_convection matrix_thermal_mass "
    "side_heat_coupling ambient_drift",
    "transformation": "partial_transformation transformation_law transition_drift "
    "stress_dependent_transition",
    "mechanical": "residual_strain viscoelastic_matrix opposing_wires side_asymmetry slack",
    "sensor": "temperature_underfill temperature_lag deflection_drift"}
STAGE_OF = {name: stage for stage, names in _EFFECTS_OF.items() for name in names.split()}


# --- Answers of a diagnosis. Any program may be examined, so its JSON is checked first.
PAIR_SIGN = "+"
SUM_TOLERANCE = 2e-3  # up to twenty probabilities, printed with four decimals


@dataclass(frozen=True)
class Candidate:
    """One explanation; a joint one of two effects is called `one+other`."""

    name: str
    probability: float
    stage: str = ""
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def parts(self) -> frozenset[str]:
        return frozenset(self.name.split(PAIR_SIGN))


@dataclass(frozen=True)
class Where:
    signal: str
    phase: str
    side: str
    stage: str


@dataclass(frozen=True)
class Claim:
    """Claimed shrinkage of a signal's gap, with its 90 % interval; None: it had no gap."""

    fraction: float | None
    ci90: tuple[float | None, float | None] | None


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next: a `protocol` as in a protocol file, with `quantities` measured in
    addition to those of the case, or a test of `parameters` to standard deviations."""

    separates: tuple[str, ...]
    protocol: dict[str, Any]
    parameters: dict[str, float] = field(default_factory=dict)
    quantities: tuple[str, ...] = ()


@dataclass(frozen=True)
class Answer:
    """A diagnosis result of the contract, section 5; candidates in order of probability."""

    verdict: str
    cause: tuple[str, ...]
    candidates: tuple[Candidate, ...]
    where: Where | None
    shrinkage: dict[str, Claim]
    next_experiment: NextExperiment | None
    credible: tuple[str, ...] = ()


def by_effect(candidates: Sequence[Candidate]) -> dict[frozenset[str], float]:
    """Probability of each effect in any candidate, of no effect, and of an unknown one."""
    whole = {frozenset((RECALIBRATION, NO_GAP)): 0.0, frozenset((UNEXPLAINED,)): 0.0}
    for candidate in candidates:
        for part in candidate.parts:
            names = next((names for names in whole if part in names), frozenset((part,)))
            whole[names] = whole.get(names, 0.0) + candidate.probability
    return whole


def checked_answer(document: Any, where: str = "answer") -> Answer:
    """An Answer from a plain document; raises InputError where it breaks the contract."""
    import msgspec  # not needed where nothing is examined
    try:
        json.dumps(document, allow_nan=False)
        answer = msgspec.convert(document, Answer)
        ranked = sorted(answer.candidates, key=lambda c: -c.probability)
        answer = replace(answer, candidates=tuple(ranked))
        for broken, holds in _clauses(answer):
            if not holds:
                raise ValueError(broken)
        return answer
    except (msgspec.ValidationError, TypeError, ValueError) as error:
        # The answer's own names may hold anything.
        raise InputError(f"{where}: {' '.join(str(error).split())}"[:300]) from None


def _clauses(answer: Answer) -> Iterator[tuple[str, bool]]:
    """Clauses of the contract: the fault if one does not hold, and whether it holds."""
    names = [candidate.name for candidate in answer.candidates]
    total = math.fsum(candidate.probability for candidate in answer.candidates)
    effects = frozenset[str]().union(*(c.parts for c in answer.candidates)) - {*NO_EFFECT}
    cause, place = list(answer.cause), answer.where
    yield f"verdict {answer.verdict!r}", answer.verdict in VERDICTS
    yield f"candidates {names}: one is listed twice", len(set(names)) == len(names)
    yield f"candidates {names}: not all of {NO_EFFECT}", set(NO_EFFECT) <= set(names)
    yield f"probabilities sum to {total:.4f}, expected 1", abs(total - 1.0) <= SUM_TOLERANCE
    is_effect = answer.verdict == "effect"
    yield f"verdict {answer.verdict} with the cause {cause}", bool(cause) == is_effect
    yield f"cause {cause}, not among the candidates", set(cause) <= effects
    yield "where is empty", answer.verdict == NO_GAP if place is None else bool(place.signal)
    for c in answer.candidates:
        yield f"probability {c.probability:g} of {c.name}", 0.0 <= c.probability <= 1.0
        if c.name not in NO_EFFECT and PAIR_SIGN not in c.name:
            yield f"stage {c.stage!r} of {c.name}", STAGE_OF.get(c.name, c.stage) == c.stage
            yield f"stage {c.stage!r} of {c.name}, not one", c.stage in STAGES
    for signal, claim in answer.shrinkage.items():
        if claim.fraction is not None:
            low, high = claim.ci90 or (None, None)
            inside = low is not None and high is not None and low <= claim.fraction <= high
            yield f"ci90 of {signal} does not hold {claim.fraction:g}", inside
    if answer.next_experiment:
        separates = answer.next_experiment.separates
        yield f"separates {separates}, not all candidates", set(separates) <= set(names)


# --- A set of cases as the examination sees it: folders and names, and labels that stay sealed.
MANIFEST, CASES, LABELS = "manifest.json", "cases", "labels.sealed"


@dataclass(frozen=True)
class CaseSet:
    """A manifest: cases are folders below `folder`; `sealed_sha256` is that of the labels."""

    root: Path
    names: tuple[str, ...]
    seed: int
    split: str
    sealed_sha256: str

    @property
    def folder(self) -> Path:
        return self.root / CASES

    @property
    def answers(self) -> Path:
        return self.root / "answers" / "diagnosis"


def read_case_set(root: str | Path) -> CaseSet:
    """The set in a folder that `./bench blind make` has written; labels are not touched. Raises
    InputError where there is none."""
    if not (path := Path(root) / MANIFEST).is_file():
        raise InputError(f"{path}: no such file, expected one of ./bench blind make")
    held = json.loads(path.read_text())
    return CaseSet(Path(root), tuple(held["cases"]), held["seed"], held["split"], held["sha256"])


# --- Sealed labels: one compressed file whose digest is in the manifest.
_HEAD = b"sma-bench labels, sealed: only the scorer opens them, after the last answer\n"


def seal(path: Path, labels: Sequence[dict[str, Any]]) -> str:
    """Write labels to a new file; the sha256 of the file."""
    text = json.dumps(list(labels), separators=(",", ":"), allow_nan=False)
    content = _HEAD + zlib.compress(text.encode(), 9)
    path.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def unseal(path: Path, sha256: str) -> list[dict[str, Any]]:
    """The labels of a sealed file; raises InputError unless it has this sha256."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(f"{path}: not the labels that the manifest names (sha256 differs)")
    return list(json.loads(zlib.decompress(content.removeprefix(_HEAD))))


# --- The folder of answers: one folder a case.
#
#     0001/answer.json            {"case", "line", "seconds", "result"}: written last
#     0001/improved.yaml          parameters that include the cause
#     after_1/0001/               the same after the suggested experiment; at most three
ANSWER, IMPROVED = "answer.json", "improved.yaml"
FOLLOW_UPS = ("after_1", "after_2", "after_3")


# One answer as it was given; `answer` is None where `line` says why it failed.
Kept = namedtuple("Kept", "case answer line seconds improved")


def keep(folder: Path, case: str, result: Any, line: str, seconds: float,
         improved: str | None = None) -> None:
    """Keep the plain document of an answer (None: failed, `line` says why) and the text of its
    parameter file; it counts once answer.json exists."""
    place = folder / case
    place.mkdir(parents=True, exist_ok=True)
    (place / IMPROVED).unlink(missing_ok=True)
    if improved is not None:
        write_text_atomically(place / IMPROVED, improved)
    document = {"case": case, "line": line, "seconds": round(seconds, 3), "result": result}
    write_text_atomically(place / ANSWER, json.dumps(document, indent=1) + "\n")


def is_kept(folder: Path, case: str) -> bool:
    return (folder / case / ANSWER).is_file()


def read_kept(folder: Path, case: str) -> Kept:
    held, improved = json.loads((folder / case / ANSWER).read_text()), folder / case / IMPROVED
    answer = None if held["result"] is None else checked_answer(held["result"])
    right = improved if improved.is_file() else None
    return Kept(case, answer, held["line"], held["seconds"], right)


def answers_of(folder: Path, case: str) -> list[Kept]:
    places = [folder, *(folder / name for name in FOLLOW_UPS)]
    return [read_kept(place, case) for place in places if is_kept(place, case)]

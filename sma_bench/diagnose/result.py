"""The result of a diagnosis as plain fields: the contents of its file, from which every card, page
and topic is made (`templates/diagnosis.j2`)."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.results import Carded, card_rows, cells, decoded, sentences

Verdict = Literal["effect", "recalibration", "no_gap", "ambiguous", "unexplained"]
RECALIBRATION, NO_GAP, UNEXPLAINED = "recalibration", "no_gap", "unexplained"
NO_EFFECT = (RECALIBRATION, NO_GAP, UNEXPLAINED)  # candidates without an effect
JOIN = "+"  # between the names of two effects
AT_NOISE = 1.05  # rms error over the noise of a sample, below which there is nothing to shrink
WORTH = 0.05  # increase of the true cause's probability from which an experiment is proposed


@dataclass(frozen=True)
class Cell:
    """One signal in one phase on one side."""

    signal: str
    phase: str
    side: str
    gap: float  # root mean square over the noise of a sample
    share: float  # of the squared gap over noise of all samples of all records
    rms: float  # in the signal's unit


@dataclass(frozen=True)
class Shrinkage:
    """Root mean squares in the signal's unit over the samples of the held-out data."""

    rmse_before: float  # with the parameters as stated
    rmse_after: float  # with the best model, including effects if any
    fraction: float  # of the gap beyond `noise_floor` that is gone
    ci90: tuple[float, float]  # by bootstrap over blocks of time, and the spread between drives
    noise_floor: float
    rmse_recalibrated: float = math.nan  # with the best parameters without an effect

    @property
    def times_noise(self) -> float:
        """Error as stated over the noise of a sample; 0 where that is not known."""
        times = self.rmse_before / self.noise_floor if self.noise_floor > 0.0 else 0.0
        return times if math.isfinite(times) else 0.0

    @property
    def at_noise(self) -> bool:
        """True if there was nothing to shrink."""
        return self.times_noise < AT_NOISE


@dataclass(frozen=True)
class NextExperiment:
    """A proposed experiment."""

    kind: str = "protocol"  # protocol, sensor, DSC, or E1 to E9
    why: str = ""  # what it is for
    separates: tuple[str, ...] = ()  # causes that it distinguishes
    protocol: Mapping[str, Any] = field(default_factory=dict)  # its file; empty for a test
    minutes: float = math.nan  # that it takes, on the bench or at the instrument
    chance: float = math.nan  # that the verdict names the true cause after it
    worth: float = 0.0  # expected increase of the true cause's probability
    parameters: Mapping[str, float] = field(default_factory=dict)  # measured by a test, with errors
    quantities: tuple[str, ...] = ()  # to measure, if not those of the records

    @property
    def settles(self) -> bool:
        return self.worth >= WORTH


@dataclass(frozen=True)
class Explanation:
    """A candidate: an effect, two joined by +, or recalibration, no_gap, unexplained."""

    name: str
    probability: float
    stage: str = ""
    parameters: dict[str, Estimate] = field(default_factory=dict)  # of its effects
    gap_over_noise: float = math.nan  # that these explain
    log_evidence: float = math.nan  # nats, over recalibration
    # effects that would contribute less than a tenth of this one, with that share
    beside: dict[str, float] = field(default_factory=dict)
    nats: dict[str, float] = field(default_factory=dict)  # terms of its log odds

    @property
    def effects(self) -> tuple[str, ...]:
        return () if self.name in NO_EFFECT else tuple(self.name.split(JOIN))


def inclusion(candidates: Sequence[Explanation]) -> dict[str, float]:
    """Probability of every effect in any of the explanations; the most probable first."""
    found = defaultdict[str, float](float)
    for candidate in candidates:
        for effect in candidate.effects:
            found[effect] += candidate.probability
    return dict(sorted(found.items(), key=lambda item: -item[1]))


@dataclass(frozen=True)
class Where:
    """The place of the gap: its largest cell, all in `table`; stages, the most probable first."""

    signal: str
    phase: str
    side: str
    stage: str
    stages: dict[str, float] = field(default_factory=dict)
    table: tuple[Cell, ...] = ()


@dataclass(frozen=True)
class Moved:
    """A parameter that the best model needs far from its stated value: `change` in `unit`."""

    name: str
    change: float
    unit: str
    deviations: float


@dataclass(frozen=True)
class Difference:
    """Where two explanations, each at its best, differ most."""

    between: tuple[str, str]
    place: Cell


@dataclass(frozen=True)
class Drift:
    """Slow drift (rms) that a sensor must have if no effect is present, and with the best model."""

    signal: str
    needed: float
    with_best: float


@dataclass(frozen=True)
class Missed:
    """The stage at which a smooth unknown input best explains what no effect does, and when."""

    stage: str
    gain: float  # nats over recalibration
    record: str
    start: float  # s, of the shortest stretch in which most of it acts
    stop: float
    phase: str  # of the drive there


@dataclass(frozen=True)
class LeftOver:
    """Residual of the model `by`."""

    by: str
    gain: float  # nats that a smooth response would gain
    signal: str = ""
    ratio: float = 0.0  # how much more the signal scatters in motion than at rest, 0 for noise
    outlier: float = 0.0  # how far a single event stands out, in standard deviations, 0 for noise
    free_form: bool = False  # whether the gain is more than noise gives


@dataclass(frozen=True, kw_only=True, repr=False)
class DiagnosisResult(Carded):
    """The result of diagnose, or of its file."""

    template = "diagnosis.j2"

    verdict: Verdict
    cause: tuple[str, ...]  # effects, empty unless the verdict is effect
    candidates: tuple[Explanation, ...]  # the most probable first
    where: Where
    shrinkage: dict[str, Shrinkage]  # by quantity, on held-out data
    moved: tuple[Moved, ...] = ()  # far from stated in the best model
    difference: Difference | None = None  # between the two best models
    drifts: tuple[Drift, ...] = ()  # that sensors must have if no effect is present
    left: LeftOver | None = None  # residual of the best model
    missed: Missed | None = None  # if the verdict is unexplained
    not_compared: tuple[str, ...] = ()  # quantities that no record holds
    next_experiment: NextExperiment | None = None
    record: tuple[str, ...] = ()  # remarks on the readings: doubtful, excluded, repaired
    findings: tuple[Finding, ...] = ()  # remarks on records and parameters
    # least probability of credible candidates, which include the true one in 90 % of learning cases
    least_credible: float = 0.05
    path: str = "diagnosis"  # of the result file

    @property
    def worst_first(self) -> list[tuple[str, Shrinkage]]:
        """Held-out quantities, the largest error as stated (over noise) first."""
        return sorted(self.shrinkage.items(), key=lambda item: -item[1].times_noise)

    @property
    def why(self) -> tuple[str, ...]:
        """Arguments for and against the verdict, in sentences."""
        return tuple(sentences(self, "why"))

    @property
    def effects(self) -> dict[str, float]:
        """Probability of every effect, alone or with another."""
        return inclusion(self.candidates)

    @property
    def first(self) -> Explanation | None:
        """The most probable candidate that contains the whole cause."""
        return next((c for c in self.candidates if set(self.cause) <= set(c.effects)), None)

    @property
    def credible(self) -> tuple[str, ...]:
        """Names of the credible candidates, which include the true one in 90 % of cases."""
        first, *others = self.candidates
        likely = (c.name for c in others if c.probability >= self.least_credible)
        return (first.name, *likely)

    def _gap(self) -> list[dict[str, Any]]:
        """Lines of the topic `~/gap`: the gap as a whole, and one a measured quantity."""
        whole: dict[str, Any] = {
            "verdict": self.verdict, "probability": f"{self.candidates[0].probability:.3f}"}
        whole |= {name: getattr(self.where, name) for name in ("signal", "phase", "side", "stage")}
        keys = ("rmse_before", "rmse_after", "noise_floor", "fraction")
        values = [whole, *({k: f"{getattr(s, k):.4g}" for k in keys}
                           for s in self.shrinkage.values())]
        return [{"name": name, "is_gap": is_gap == "True", "message": message, "values": own}
                for (name, is_gap, message), own in zip(cells(self, "gap"), values, strict=True)]

    def to_json(self) -> dict[str, Any]:
        """The diagnosis result of contract section 5."""
        own = [f.name for f in fields(DiagnosisResult) if f.name != "path"]
        numbers = self.first.parameters if self.first else {}
        sizes = {name: {n: e for n, e in numbers.items() if n.startswith(f"effect.{name}.")}
                 for name in self.cause}
        return {**{name: _plain(getattr(self, name)) for name in own}, "size": _plain(sizes),
                "effects": {name: {"probability": p} for name, p in self.effects.items()},
                "credible": [*self.credible], "why": [*self.why], "card": card_rows(self),
                "gap": self._gap()}


def _plain(value: Any) -> Any:
    """A field for JSON: an estimate as value, error and unit, a finding as a line, a candidate
    without its fit, an experiment without its worth."""
    if isinstance(value, Finding):
        return str(value)
    if isinstance(value, Estimate):
        return {"value": value.value, "std": value.std, "unit": value.unit}
    if is_dataclass(value):
        known = fields(Explanation if isinstance(value, Explanation) else value)
        value = {f.name: getattr(value, f.name) for f in known if f.name != "worth"}
    if isinstance(value, Mapping):
        return {name: _plain(own) for name, own in value.items()}
    return [_plain(own) for own in value] if isinstance(value, (list, tuple)) else value


def diagnosis_from(document: Any, where: str) -> DiagnosisResult:
    """A diagnosis from what its JSON held. InputError: a line with `where` and the field."""
    if isinstance(document, dict):  # null: a missing field at this level, not a number below it
        document = {**{n: v for n, v in document.items() if v is not None}, "path": where}
        if isinstance(lines := document.get("findings"), list):
            document["findings"] = [vars(Finding.read(line)) if isinstance(line, str) else line
                                    for line in lines]
    return decoded(DiagnosisResult, document, where)

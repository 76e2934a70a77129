"""Judges answers: what is right for a case, whether an answer has it, and every measure of the
withheld-effect check, a number with its interval over cases."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from scipy import stats

from examination.blind import case_files as files
from examination.blind.case_files import NO_GAP, RECALIBRATION, STAGE_OF, UNEXPLAINED
from examination.blind.rigs import PER_WIRE, Drive, Pulse, Stage, quantity_of
from sma_bench.arrays import Array
from sma_bench.parameters import Parameters
from sma_bench.physics.simulate import simulate

SET_MASS = 0.9  # probability of a credible set
CONFIDENT = 0.8  # probability of a candidate
MOVED = 2.0  # stated standard deviations
WORTH_NAMING = 1.0  # gap over noise: of a smaller effect no_gap is right, too (seeds with forms)
SEEN_FROM = 3.0  # standard deviations from the best fit of the parameters alone: likewise
_BENIGN = frozenset((NO_GAP, RECALIBRATION))
_SILENCE = files.Answer("", (), (), None, {}, None)
# Right answers for cases without an effect of the library. Where nothing is wrong, the stated
# parameters still differ from the true ones by their uncertainty, so recalibration is right, too.
_RIGHT_NAMES = {"none": _BENIGN, "recalibration": frozenset((RECALIBRATION,)),
                "outside": frozenset((UNEXPLAINED,))}


def unseen(beyond_parameters: float | None) -> bool:
    """True if other parameters would explain what is hidden."""
    return beyond_parameters is not None and beyond_parameters < SEEN_FROM


@dataclass(frozen=True)
class Label:
    """The fields of a sealed label (make.py) by which answers are judged."""

    id: str
    kind: str
    effects: tuple[str, ...] = ()
    severity: float = 0.0
    where: dict[str, Any] | None = None
    distinguishable: bool = True
    noise: str = "white"
    kinetics: bool = False
    signals: str = "all"
    stages: tuple[str, ...] = ()
    severities: dict[str, float] = field(default_factory=dict)
    wrong: dict[str, float] = field(default_factory=dict)
    transformation_law: bool = False
    inner_loops: bool = False
    beyond_parameters: float | None = None
    forms: dict[str, str] = field(default_factory=dict)  # of seeds that have them, from 2700 on

    @property
    def main(self) -> frozenset[str]:
        """The hidden effect with the largest gap, or the right answers if none was hidden."""
        if not self.effects or self.kind in _RIGHT_NAMES:
            return self.names
        return frozenset([max(self.effects, key=lambda name: self.severities.get(name, 0.0))])

    @property
    def hidden(self) -> frozenset[str]:
        """The hidden effects, or the right answers if none of the library was hidden."""
        return _RIGHT_NAMES.get(self.kind, frozenset(self.effects))

    @property
    def names(self) -> frozenset[str]:
        """All right answers: also another law, or inner loops of spread grains, where they show
        beside what was hidden; also no_gap and recalibration, where the gap is small, or other
        parameters would explain it."""
        law = {"transformation_law"} if self.transformation_law else set()
        law |= {"partial_transformation"} if self.inner_loops else set()
        small = self.severity < WORTH_NAMING or unseen(self.beyond_parameters)
        return self.hidden | law | (_BENIGN if self.forms and self.effects and small else set())


@dataclass(frozen=True)
class Shrunk:
    """Noise-free gap of one signal on an unseen protocol, `before` with the lab's and
    `after` with the improved parameters (root mean square), and the sensor's noise, in its unit."""

    before: float
    after: float
    noise: float

    @property
    def fraction(self) -> float:
        """1 - after/before; NaN where the gap is smaller than the noise."""
        return 1.0 - self.after / self.before if self.before > self.noise else math.nan


@dataclass(frozen=True)
class Judged:
    """A case: its label, the answer (None: failed, `failure` says why), true shrinkage by signal,
    parameters that the improved file has `moved`, the `second` (last) answer after suggested
    experiments, whether an ambiguous answer got what it asked for (`followed`), root mean square
    errors of the parameters in stated deviations, and the seconds that the answer took. `facts` are
    what measures.yaml counts and defines; None is not counted."""

    label: Label
    answer: files.Answer | None
    shrunk: Mapping[str, Shrunk] = field(default_factory=dict)
    moved: frozenset[str] = frozenset()
    second: files.Answer | None = None
    followed: bool = False
    error_before: float = math.nan
    error_after: float = math.nan
    seconds: float = math.nan
    failure: str = ""

    @property
    def first_choice(self) -> files.Candidate | None:
        return next(iter(self.answer.candidates), None) if self.answer else None

    @cached_property
    def facts(self) -> dict[str, Any]:
        answer, label, right = self.answer or _SILENCE, self.label, self.label.names
        verdict, first = answer.verdict, self.first_choice
        chosen = first.parts if first else frozenset[str]()
        belief = first.probability if first else 0.0
        sure = [c.parts for c in answer.candidates if c.probability >= CONFIDENT]
        if label.forms and first:  # sum over all candidates with an effect
            whole = files.by_effect(answer.candidates)
            chosen, belief = max(whole.items(), key=lambda item: item[1])
            sure = [names for names, p in whole.items() if p >= CONFIDENT]
        # The answer's own credible set; without one, the fewest candidates that make 90 %, the most
        # probable first.
        total, credible = 0.0, []
        for candidate in answer.candidates:
            fills_up = not answer.credible and total < SET_MASS - 1e-9
            if candidate.name in answer.credible or fills_up:
                credible.append(candidate.parts)
            total += candidate.probability
        in_set = frozenset[str]().union(*credible)
        right_ones = [parts for parts in credible if parts <= right]
        holds_truth, size = bool(right_ones), len(credible)
        if label.forms:  # so does a candidate with the main effect and others
            holds_truth = any(parts & label.main for parts in credible)
            size = len(in_set)
        elif label.kind == "pair":
            holds_truth = label.hidden <= frozenset[str]().union(*right_ones)
        # First choice and verdict against the label.
        first_right = first is not None and bool(chosen <= right or chosen & right & _BENIGN)
        stages = {STAGE_OF[name] for name in right if name in STAGE_OF}
        gap, alarms = verdict not in ("", NO_GAP), verdict in ("", "effect", UNEXPLAINED)
        if verdict == "effect" and label.kind == "none":  # causes that its kinetics show are right
            alarms = not right.issuperset(answer.cause)
        if verdict == "ambiguous":
            gap, alarms = NO_GAP not in in_set, in_set.isdisjoint(_BENIGN)
        abstains = verdict in ("ambiguous", UNEXPLAINED)
        sure += [frozenset(answer.cause)] if answer.cause else []
        named, settled = frozenset(answer.cause) or (first.parts if first else chosen), None
        if self.followed:
            last = Judged(label, self.second).facts["first_choice_right"]
            settled = last and (self.second or _SILENCE).verdict != "ambiguous"
        facts = {
            "answered": self.answer is not None, "says_gap": gap, "alarms": alarms,
            "alarms_with_reason": self.answer is not None and alarms, "abstains": abstains,
            "abstains_or_flags": abstains or UNEXPLAINED in in_set,
            "set_size": float(size) if self.answer else None,
            "set_holds_truth": holds_truth,
            "truth_probability": sum(c.probability for c in answer.candidates if c.parts <= right),
            "first_choice_right": first_right,
            "named_and_right": verdict == "effect" and first_right,
            "family_right": first_right or any(STAGE_OF.get(part) in stages for part in chosen),
            "parameter_found": verdict == RECALIBRATION and not self.moved.isdisjoint(label.wrong),
            "confident_and_wrong": any(not parts & right for parts in sure),
            "names one": bool(named & right), "names both": label.hidden <= named,
            "settled": settled,
            "stated": (belief, first_right) if first else None,
            "error_before": self.error_before, "error_after": self.error_after,
            "seconds": self.seconds}
        # Place of the gap, if the label has one. Signals agree if their quantities do, such as
        # front_1.temperature and temperature. The stage is that of the effect with the largest gap,
        # or of any wrong parameter.
        most = max(label.severities.values(), default=0.0)
        pairs = zip(label.effects, label.stages, strict=False)
        own = {stage for name, stage in pairs if label.severities.get(name) == most}
        if label.kind == "recalibration" or not own:
            own = set(label.stages)
        for key in ("signal", "phase", "side", "stage"):
            facts[f"place_right {key}"] = None
            if label.where:
                place = getattr(answer.where, key, None)
                wanted = own if key == "stage" and own else {quantity_of(label.where[key])}
                facts[f"place_right {key}"] = place is not None and quantity_of(place) in wanted
        # Claimed and true shrinkage of one signal: the deflection where it has a gap
        # above the noise, else the signal with the largest.
        usable = {name: claim.fraction for name, claim in answer.shrinkage.items()
                  if claim.fraction is not None and name in self.shrunk
                  and math.isfinite(self.shrunk[name].fraction)}
        if usable:
            largest = max(usable, key=lambda n: self.shrunk[n].before / self.shrunk[n].noise)
            name = "deflection" if "deflection" in usable else largest
            claimed, true = usable[name], self.shrunk[name].fraction
            low, high = answer.shrinkage[name].ci90
            facts |= {"claim error": abs(claimed - true), "claim excess": claimed - true,
                      "claim true": true, "claim covers": low <= true <= high}
        return facts


# --- True shrinkage of a gap: in the case's own world, without noise, on an unseen drive.
UNSEEN, _DURATION, _CORNERS = "unseen", 110.0, 17
# Starts and lengths in s of smooth hills, back and front by turns, and their heights as a share of
# the highest voltage of the case's records: two that transform fully and two that may not.
_HILLS = ((5.0, 20.0, 1.0), (31.0, 18.0, 0.98), (56.0, 16.0, 0.9), (79.0, 22.0, 0.94))


def unseen_drive(drives: Mapping[str, Drive], sides: tuple[str, ...] = ("back", "front")) -> Drive:
    """Raised cosines up to the highest voltage of a case's records, which have other shapes."""
    highest = max(max(pulse.volts) for drive in drives.values() for pulse in drive.pulses)
    phase = np.linspace(0.0, 1.0, _CORNERS)
    shape = np.sqrt((1.0 - np.cos(2.0 * np.pi * phase)) / 2.0)
    pulses = [Pulse(sides[k % len(sides)], tuple(np.round(start + length * phase, 2).tolist()),
                    tuple((height * highest * shape).tolist()))
              for k, (start, length, height) in enumerate(_HILLS)]
    return Drive(UNSEEN, _DURATION, tuple(pulses))


class UnseenRecord:
    """The world of a sealed label on the unseen drive, read by perfect instruments."""

    def __init__(self, label: Mapping[str, Any]) -> None:
        seen = Stage.from_label(label)
        drive = unseen_drive(seen.drives, tuple(sorted(set(seen.sides))))
        self.stage = replace(seen, drives={UNSEEN: drive})
        outcome = self.stage.play(label["features"], UNSEEN)
        self.time, self.voltage = outcome.time, outcome.voltage
        self.readings = self.stage.read(label["features"], UNSEEN)

    def gaps(self, parameters: Parameters) -> dict[str, float]:
        """Root mean square of measured minus simulated, for every signal and every quantity."""
        found = simulate(parameters, self.time, self.voltage)
        simulated = self.stage.named({"current": found.current,
                                      "temperature": found.temperature_reading,
                                      "deflection": found.deflection_reading})
        square = {name: float(np.mean((read - simulated[name]) ** 2))
                  for name, read in self.readings.items()}
        for quantity in PER_WIRE:
            of_wires = [square[f"{channel}.{quantity}"] for channel in self.stage.channels]
            square[quantity] = float(np.mean(of_wires))
        return {name: float(np.sqrt(value)) for name, value in square.items()}

    def shrunk(self, nominal: Parameters, improved: Parameters) -> dict[str, Shrunk]:
        """The true shrinkage by signal (`front_1.temperature`) and quantity (`temperature`)."""
        before, after = self.gaps(nominal), self.gaps(improved)
        return {name: Shrunk(before[name], after[name], self.stage.sensors.std(quantity_of(name)))
                for name in before}


def parameter_error(truth: Mapping[str, float], nominal: Parameters, lab: Parameters) -> float:
    """Root mean square error of `lab` in the standard deviations that `nominal` states."""
    stated = {name: std for name, std in nominal.given_uncertainty.items() if name in truth}
    errors = [(lab[name] - truth[name]) / std for name, std in stated.items() if std > 0.0]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def moved_parameters(nominal: Parameters, improved: Parameters) -> frozenset[str]:
    """Those that were moved by MOVED of their stated standard deviations or more."""
    return frozenset(n for n, std in nominal.given_uncertainty.items()
                     if std > 0.0 and abs(improved[n] - nominal[n]) >= MOVED * std)


# --- Measures over judged cases, with their intervals.
CONFIDENCE = 0.95
_BOOTSTRAP = {"n_resamples": 2000, "method": "percentile", "confidence_level": CONFIDENCE}
_SEED, _BINS = 20240229, 10  # of stated probabilities


@dataclass(frozen=True)
class Measured:
    """A value with its 95 % interval over `n` cases; `hits` of a proportion."""

    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    hits: int | None = None


def proportion(outcomes: Sequence[bool]) -> Measured:
    """Share of True with its exact interval (Clopper and Pearson)."""
    if not outcomes:
        return Measured()
    hits, n = sum(map(bool, outcomes)), len(outcomes)
    low, high = stats.binomtest(hits, n).proportion_ci(CONFIDENCE, method="exact")
    return Measured(hits / n, float(low), float(high), n, hits)


def mean(values: Sequence[float]) -> Measured:
    """Mean with a percentile bootstrap interval; the same values give the same interval."""
    return _bootstrapped(lambda x, axis=-1: np.mean(x, axis=axis), values)


def quantile(values: Sequence[float], level: float) -> Measured:
    """Quantile with its distribution-free interval between two order statistics; infinite where the
    values are too few for a bound."""
    if not values:
        return Measured()
    value = float(np.quantile(values, level))
    found = stats.quantile_test(values, q=value, p=level).confidence_interval(CONFIDENCE)
    low = -math.inf if math.isnan(found.low) else float(found.low)
    high = math.inf if math.isnan(found.high) else float(found.high)
    return Measured(value, low, high, len(values))


def calibration_error(stated: Sequence[float], right: Sequence[bool]) -> Measured:
    """Expected calibration error: mean distance of stated probability and frequency over bins.
    sum_b n_b/n |mean stated in b - share right in b| (Naeini et al., AAAI 2015), with a bootstrap
    interval over cases."""

    def error(probability: Array, hit: Array) -> float:
        bins = np.minimum((probability * _BINS).astype(np.intp), _BINS - 1)
        return float(np.abs(np.bincount(bins, weights=probability - hit)).sum() / len(hit))

    return _bootstrapped(error, stated, [float(r) for r in right])


def _bootstrapped(statistic: Callable[..., float], *data: Sequence[float]) -> Measured:
    n = len(data[0])
    if not n:
        return Measured()
    columns = tuple(np.asarray(column, dtype=float) for column in data)
    value = float(statistic(*columns))
    if n == 1 or all(np.ptp(column) == 0.0 for column in columns):  # nothing to resample
        return Measured(value, value, value, n)
    found = stats.bootstrap(columns, statistic, paired=True, **_BOOTSTRAP,
                            random_state=np.random.default_rng(_SEED)).confidence_interval
    return Measured(value, float(found.low), float(found.high), n)


# --- One row of the result.
Bound = float | tuple[float, float] | None
_STATISTICS: dict[str, Callable[[list], Measured]] = {
    "share": proportion, "mean": mean, "median": lambda values: quantile(values, 0.5),
    "90th percentile": lambda values: quantile(values, 0.9),
    "calibration": lambda pairs: calibration_error([p for p, _ in pairs], [r for _, r in pairs])}


@dataclass(frozen=True)
class Measure:
    """An entry of measures.yaml; for one better inside a band, floor and aim are (low, high)."""

    name: str
    what: tuple[str, ...]
    among: Mapping[str, Any] = field(default_factory=dict, hash=False)
    definition: str = ""
    better: Literal["higher", "lower", "inside"] = "higher"
    style: Literal["share", "number", "points", "seconds"] = "share"
    floor: Bound = None
    aim: Bound = None

    @property
    def title(self) -> str:
        return self.name + (" (points)" if self.style == "points" else "")

    def of(self, cases: Sequence[Judged]) -> Measured:
        (statistic, *fact), among = self.what, self.among
        wanted, kinds = among.get("label", {}).items(), among.get("kinds")
        own = [c for c in cases if (kinds is None or c.label.kind in kinds)
               and c.label.severity > among.get("above", -math.inf)
               and all(getattr(c.label, name) == value for name, value in wanted)]
        values = [case.facts.get(" ".join(fact)) for case in own]
        return _STATISTICS[statistic]([v for v in values if v is not None and v == v])

    def met(self, measured: Measured) -> str:
        """`aim`, `floor` or `missed` by the value itself; "" without cases or floor."""
        if self.floor is None or not measured.n:
            return ""
        for how, bound in (("aim", self.aim), ("floor", self.floor)):
            low, high = bound if isinstance(bound, tuple) else (-math.inf, math.inf)
            if isinstance(bound, float | int):
                low, high = (bound, high) if self.better == "higher" else (low, bound)
            if bound is not None and low <= measured.value <= high:
                return how
        return "missed"


# Measures with a floor and an aim, further ones, and those of each group of cases.
_DOCUMENT = yaml.safe_load(Path(__file__).with_name("measures.yaml").read_text("utf-8"))
TARGETS, OTHERS, OF_GROUPS = (
    tuple(Measure(name, **{k: tuple(v) if isinstance(v, list) else v for k, v in row.items()})
          for name, row in rows.items())
    for rows in _DOCUMENT.values())

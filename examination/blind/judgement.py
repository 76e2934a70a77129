"""One case judged: what its label holds to be true, and whether an answer said so."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from examination.blind.case_files import (
    NO_GAP,
    RECALIBRATION,
    STAGE_OF,
    UNEXPLAINED,
    Answer,
    Candidate,
)
from examination.blind.rigs import PER_WIRE, Drive, Pulse, Stage, quantity_of
from sma_bench.parameters import Parameters
from sma_bench.physics.simulate import simulate

Array = npt.NDArray[np.float64]

SET_MASS = 0.9
CONFIDENT = 0.8
MOVED = 2.0
_BENIGN = frozenset((NO_GAP, RECALIBRATION))
_SILENCE = Answer("", (), (), None, {}, None)
# What is right to say of a case without an effect of the library. Where nothing is wrong, the
# parameters still differ from the truth by their uncertainty, and saying that is no error.
_RIGHT_NAMES = {
    "none": _BENIGN,
    "recalibration": frozenset((RECALIBRATION,)),
    "outside": frozenset((UNEXPLAINED,)),
}


@dataclass(frozen=True)
class Label:
    """What answers are judged by of a sealed label (make.py)."""

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

    @property
    def names(self) -> frozenset[str]:
        """The answers that are right."""
        return _RIGHT_NAMES.get(self.kind, frozenset(self.effects))

    @property
    def own_stages(self) -> frozenset[str]:
        """One of them has to be named: that of the effect that does most, or of any wrong
        parameter."""
        most = max(self.severities.values(), default=0.0)
        of_effects = zip(self.effects, self.stages, strict=False)
        largest = {stage for name, stage in of_effects if self.severities.get(name) == most}
        return frozenset(self.stages if self.kind == "recalibration" else largest or self.stages)


@dataclass(frozen=True)
class Shrunk:
    """Noise-free gap of one signal on a protocol that nobody saw, `before` with the lab's and
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
    errors of the parameters in stated deviations, and the seconds that the answer took.

    The properties and methods are what measures.yaml counts; None is not counted.
    """

    label: Label
    answer: Answer | None
    shrunk: Mapping[str, Shrunk] = field(default_factory=dict)
    moved: frozenset[str] = frozenset()
    second: Answer | None = None
    followed: bool = False
    error_before: float = math.nan
    error_after: float = math.nan
    seconds: float = math.nan
    failure: str = ""

    @property
    def answered(self) -> bool:
        return self.answer is not None

    @property
    def said(self) -> Answer:
        """The answer, an empty one where there is none."""
        return self.answer or _SILENCE

    @property
    def first_choice(self) -> Candidate | None:
        """The most probable candidate."""
        return next(iter(self.said.candidates), None)

    @property
    def credible_set(self) -> tuple[Candidate, ...]:
        """The fewest candidates whose probabilities make 90 %, most probable first."""
        total, chosen = 0.0, []
        for candidate in self.said.candidates:
            if total < SET_MASS - 1e-9:
                chosen.append(candidate)
            total += candidate.probability
        return tuple(chosen)

    @property
    def set_size(self) -> float | None:
        return float(len(self.credible_set)) if self.answer else None

    @property
    def first_choice_right(self) -> bool:
        """The most probable candidate is made of nothing but what is true."""
        first = self.first_choice
        return first is not None and first.parts <= self.label.names

    @property
    def named_and_right(self) -> bool:
        return self.said.verdict == "effect" and self.first_choice_right

    @property
    def stated(self) -> tuple[float, bool] | None:
        """Probability of the most probable candidate, and whether it is right."""
        return (self.first_choice.probability, self.first_choice_right) if self.answer else None

    @property
    def parameter_found(self) -> bool:
        """Verdict recalibration, and one of the wrong parameters is moved."""
        return self.said.verdict == RECALIBRATION and not self.moved.isdisjoint(self.label.wrong)

    @property
    def family_right(self) -> bool:
        """The most probable candidate acts in a true stage (or is right where no stage is)."""
        first = self.first_choice
        if first is None or self.first_choice_right:
            return self.first_choice_right
        stages = {STAGE_OF[name] for name in self.label.names if name in STAGE_OF}
        return any(STAGE_OF.get(part) in stages for part in first.parts)

    @property
    def set_holds_truth(self) -> bool:
        """The 90 % set has the truth in it; of a pair, both effects, together or apart."""
        right = [c.parts for c in self.credible_set if c.parts <= self.label.names]
        if self.label.kind == "pair":
            return frozenset[str]().union(*right) == self.label.names
        return bool(right)

    @property
    def truth_probability(self) -> float:
        """Probability of the candidates that are made of nothing but what is true."""
        return sum(c.probability for c in self.said.candidates if c.parts <= self.label.names)

    @property
    def says_gap(self) -> bool:
        """Any verdict but no_gap, unless an ambiguous one leaves no_gap in its 90 % set."""
        if self.said.verdict == "ambiguous":
            return not self._set_has(frozenset((NO_GAP,)))
        return self.said.verdict not in ("", NO_GAP)

    @property
    def alarms(self) -> bool:
        """Says that the model misses something: an effect, something unexplained, or ambiguous
        with neither no_gap nor recalibration in the 90 % set. No answer counts as an alarm."""
        if self.said.verdict == "ambiguous":
            return not self._set_has(_BENIGN)
        return self.said.verdict in ("", "effect", UNEXPLAINED)

    @property
    def alarms_with_reason(self) -> bool:
        return self.answered and self.alarms

    @property
    def abstains(self) -> bool:
        return self.said.verdict in ("ambiguous", UNEXPLAINED)

    @property
    def abstains_or_flags(self) -> bool:
        """Abstains, or keeps `unexplained` in the 90 % set."""
        return self.abstains or self._set_has(frozenset((UNEXPLAINED,)))

    @property
    def confident_and_wrong(self) -> bool:
        """Verdict `effect` with a cause that shares nothing with the truth, or one candidate that
        shares nothing with it at a probability of 0.8 or more."""
        sure = [c.parts for c in self.said.candidates if c.probability >= CONFIDENT]
        if self.said.cause:
            sure.append(frozenset(self.said.cause))
        return any(not parts & self.label.names for parts in sure)

    def names(self, how_many: str) -> bool:
        """The cause, or without one the most probable candidate, has `one` or `both` in it."""
        first = self.first_choice.parts if self.first_choice else frozenset()
        named = frozenset(self.said.cause) or first
        return self.label.names <= named if how_many == "both" else bool(named & self.label.names)

    def place_right(self, key: str) -> bool | None:
        """`signal`, `phase`, `side` or `stage` of the gap is the label's, which has one.

        Signals are the same when their quantity is: front_1.temperature and temperature.
        """
        if not self.label.where:
            return None
        place = self.said.where
        if place is None:
            return False
        if key == "stage" and self.label.own_stages:
            return place.stage in self.label.own_stages
        return quantity_of(getattr(place, key)) == quantity_of(self.label.where[key])

    @property
    def settled(self) -> bool | None:
        """The last answer is no longer ambiguous and its most probable candidate is right."""
        if not self.followed:
            return None
        last = Judged(self.label, self.second)
        return last.said.verdict != "ambiguous" and last.first_choice_right

    def claim(self, what: str) -> float | bool | None:
        """Of the claimed and the true fraction of one signal: the deflection where it has a gap
        above the noise, else the signal with the largest; None where none has, or nothing is
        claimed."""
        said = self.said.shrinkage
        usable = {
            name: claim.fraction for name, claim in said.items()
            if claim.fraction is not None and name in self.shrunk
            and math.isfinite(self.shrunk[name].fraction)
        }
        if not usable:
            return None
        largest = max(usable, key=lambda n: self.shrunk[n].before / self.shrunk[n].noise)
        name = "deflection" if "deflection" in usable else largest
        claimed, true = usable[name], self.shrunk[name].fraction
        low, high = said[name].ci90
        return {"error": abs(claimed - true), "excess": claimed - true, "true": true,
                "covers": low <= true <= high}[what]  # fmt: skip

    def _set_has(self, names: frozenset[str]) -> bool:
        return any(c.parts & names for c in self.credible_set)


# --- How far a gap truly shrinks: the case's own world, without noise, on a drive nobody saw.

UNSEEN = "unseen"
_DURATION = 110.0
# Starts and lengths in s of smooth hills, back and front by turns, and their heights as a share of
# the highest voltage of the case's records: two that transform fully and two that may not.
_HILLS = ((5.0, 20.0, 1.0), (31.0, 18.0, 0.98), (56.0, 16.0, 0.9), (79.0, 22.0, 0.94))
_CORNERS = 17


def unseen_drive(drives: Mapping[str, Drive], sides: tuple[str, ...] = ("back", "front")) -> Drive:
    """Raised cosines that reach as high as a case's own records; no family of theirs."""
    highest = max(max(pulse.volts) for drive in drives.values() for pulse in drive.pulses)
    phase = np.linspace(0.0, 1.0, _CORNERS)
    shape = np.sqrt((1.0 - np.cos(2.0 * np.pi * phase)) / 2.0)
    pulses = [
        Pulse(sides[k % len(sides)], tuple(np.round(start + length * phase, 2).tolist()),
              tuple((height * highest * shape).tolist()))
        for k, (start, length, height) in enumerate(_HILLS)
    ]  # fmt: skip
    return Drive(UNSEEN, _DURATION, tuple(pulses))


class UnseenRecord:
    """What the world of a sealed label does on the unseen drive, as perfect instruments would read
    it."""

    def __init__(self, label: Mapping[str, Any]) -> None:
        seen = Stage.from_label(label)
        sides = tuple(sorted(set(seen.sides)))
        self.stage = replace(seen, drives={UNSEEN: unseen_drive(seen.drives, sides)})
        outcome = self.stage.play(label["features"], UNSEEN)
        self.time, self.voltage = outcome.time, outcome.voltage
        self.readings = self.stage.read(label["features"], UNSEEN)

    def gaps(self, parameters: Parameters) -> dict[str, float]:
        """Root mean square of measured less simulated, of every signal and every quantity."""
        found = simulate(parameters, self.time, self.voltage)
        simulated = self.stage.named({
            "current": found.current, "temperature": found.temperature_reading,
            "deflection": found.deflection_reading,
        })  # fmt: skip
        square = {
            name: float(np.mean((read - simulated[name]) ** 2))
            for name, read in self.readings.items()
        }
        for quantity in PER_WIRE:
            of_wires = [square[f"{channel}.{quantity}"] for channel in self.stage.channels]
            square[quantity] = float(np.mean(of_wires))
        return {name: float(np.sqrt(value)) for name, value in square.items()}

    def shrunk(self, nominal: Parameters, improved: Parameters) -> dict[str, Shrunk]:
        """The true shrinkage by signal (`front_1.temperature`) and quantity (`temperature`)."""
        before, after = self.gaps(nominal), self.gaps(improved)
        return {
            name: Shrunk(before[name], after[name], self.stage.sensors.std(quantity_of(name)))
            for name in before
        }


def parameter_error(truth: Mapping[str, float], nominal: Parameters, lab: Parameters) -> float:
    """Root mean square error of `lab` in the standard deviations that `nominal` states."""
    stated = {name: std for name, std in nominal.given_uncertainty.items() if name in truth}
    errors = [(lab[name] - truth[name]) / std for name, std in stated.items() if std > 0.0]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def moved_parameters(nominal: Parameters, improved: Parameters) -> frozenset[str]:
    """Those that were moved by MOVED of their stated standard deviations or more."""
    stated = nominal.given_uncertainty.items()
    return frozenset(
        name for name, std in stated
        if std > 0.0 and abs(improved[name] - nominal[name]) >= MOVED * std
    )

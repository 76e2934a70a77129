"""What to measure next: the drive, sensor or test of the paper that best separates the causes.

Each possible cause, with its fitted numbers, is assumed to be true in turn; every rival may refit
its own numbers to the predicted readings, within what the records leave free. The expected evidence
is half the square of the distance that remains, in noise, plus the penalty of the freedom that the
rival has (Box and Hill, Technometrics 9, 1967). It is not symmetric: a model without an effect
cannot imitate one that is there; a model with an effect that is not there can set it to zero. A
test of the paper is treated alike, with its parameters as readings. An experiment's worth is the
expected probability of the true cause after it, by the decision's rule, minus the present one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.special import ndtri

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.compiled import in_threads
from sma_bench.diagnose import decision
from sma_bench.diagnose.decision import Candidate, Utilities, learnt
from sma_bench.diagnose.result import NO_GAP, RECALIBRATION, WORTH, NextExperiment
from sma_bench.diagnose.search import Search
from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import first_guess
from sma_bench.estimation.nuisances import of_planned
from sma_bench.estimation.observation import SENSORS, BinnedSignal, Observation
from sma_bench.estimation.residual import DRIFT_EFFECT, Problem
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.parameters.paper_tests import TESTS, measured
from sma_bench.physics.material import commanded_voltage, heating_voltage
from sma_bench.protocols import parse_protocol

_AS_GOOD = 0.8  # of the best worth: of such experiments the one with most per minute is proposed
_MOST_CAUSES = 6  # that are simulated
_LEAST = 0.02  # probability from which a cause is simulated, if only as a rival
_COOLER = 10.0  # K, margin of the simulated temperature below the bench's limit
_PERIOD = 0.2  # s of the simulation
_STEP = 0.05  # of a free direction, for finite differences
_A_MINUTE = 0.002  # probability per minute: the shorter of equal drives wins
# Nats per record that an absent effect still gains: mean of 11 rivals in development cases.
_TAKEN_UP = 3.5
# Sensors that could be added: noise and duration [s] of a bin, minutes to mount it.
_MOUNTED = {"temperature": (0.15, 0.2, 20.0), "current": (2e-3, 0.2, 10.0)}
_SETUP = 5.0  # minutes until the bench is cold and recorded again
VISIBLE = 2.0  # standard deviations from which a difference would be noticed
_QUANTILES = ndtri((np.arange(7) + 0.5) / 7.0)  # of noise, in standard deviations
_SHARES = {"full": (1.0,), "growing": (0.7, 0.8, 0.9, 1.0), "partial": (0.85, 0.8)}
_FIRST_REST = 5.0  # s
LONGER = (8.0, 15.0)  # minutes for which the best drive is tried as well


@dataclass(frozen=True)
class Drive:
    """Equal pulses for `minutes`; `seconds`: rise time of a triangle, or duration of a step."""

    order: str
    shape: str
    heights: str
    seconds: float
    rest: float
    minutes: float

    def document(self, level: float, sides: Sequence[str]) -> dict[str, Any]:
        """The drive as a protocol file, pulses up to `level` [V]."""
        one, other = sides[0], sides[-1]
        orders = {"one side": (one,), "the other side": (other,), "both sides": ("all",)}
        targets = orders.get(self.order, (one, other) if one != other else (one,))
        warmed, triangle = "warmed" in self.order, self.shape == "triangle"
        pulse = self.seconds * (2.0 if triangle else 1.0) + self.rest
        pulse += 2.0 * self.seconds if warmed else 0.0
        steps: list[dict[str, Any]] = [{"kind": "rest", "duration": _FIRST_REST}]
        left, k, shares = 60.0 * self.minutes - _FIRST_REST, 0, _SHARES[self.heights]
        while k == 0 or left >= pulse:
            target = targets[k % len(targets)]
            volts = round(shares[(k // len(targets)) % len(shares)] * level, 3)
            if warmed:
                passive = next((s for s in sides if s != target), target)
                steps.append({"kind": "step", "drive": passive, "level": round(0.5 * volts, 3),
                              "duration": 2.0 * self.seconds})
            stroke: dict[str, Any] = {"kind": "step", "level": volts, "duration": self.seconds}
            if triangle:
                stroke = {"kind": "triangle", "peak": volts, "rise": self.seconds,
                          "fall": self.seconds}
            steps += [{**stroke, "drive": target}, {"kind": "rest", "duration": self.rest}]
            left, k = left - pulse, k + 1
        kind = [f"{self.heights} {'triangles' if triangle else 'steps'}"]
        order = [self.order] if one != other else ["warmed before"] if warmed else []
        rests = f"with rests of {self.rest:g} s"
        return {"name": "_".join([*kind, *order]).replace(" ", "_"),
                "description": ", ".join([f"{kind[0]} of {self.seconds:g} s", *order, rests]),
                "steps": steps}


_TABLE = read_yaml(Path(__file__).with_name("drives.yaml"), aliases=True)
KNOWN = tuple(Drive(*numbers) for numbers in _TABLE["drives"])
FIRST = Drive(*_TABLE["first"])  # of a bench without a record


class Separation(NamedTuple):
    """A true cause against a rival in an experiment: the expected `evidence` [nats], and the
    `distance` of their readings in standard deviations, by which noise scatters the evidence."""

    evidence: float
    distance: float


Separations = dict[tuple[str, str], Separation]  # by (true cause, rival)
# As large as those of any drive; larger ones settle less, because the equations are not exact.
_LARGE = (Separation(10.0, 4.5), Separation(30.0, 7.7), Separation(100.0, 14.0))


class OpenQuestion:
    """The causes that are still possible, with their fits, and what the bench can do."""

    def __init__(self, candidates: Sequence[Candidate], search: Search, utilities: Utilities,
                 observations: Sequence[Observation], parameters: Parameters) -> None:
        self.probability = {c.name: c.probability for c in candidates}
        self.utilities, self.search, self.parameters = utilities, search, parameters
        possible = [(c.name, c.fit) for c in candidates if c.fit is not None and c.name != NO_GAP
                    if c.probability > _LEAST or c.name == RECALIBRATION]
        self.fits = dict(possible[:_MOST_CAUSES])
        self.fits.setdefault(RECALIBRATION, search.recalibrated)
        pairs = list(permutations(self.fits, 2))
        unmoved = Utilities(replace(utilities.found, surprise=0.0))

        self.before, *most = (
            prospect(who, self.probability, dict.fromkeys(pairs, one)).given
            for who, one in ((utilities, Separation(0.0, 0.0)), *((unmoved, p) for p in _LARGE)))
        self.most = max(most) - self.before
        self.observation = max(observations, key=lambda o: len(o.quantities))
        self.sides = tuple(dict.fromkeys(parameters["bench.channel_sides"]))
        # The largest voltage in the records, as commanded.
        seen = commanded_voltage(max(obs.voltage.max() for obs in observations), parameters)
        self.level = min(float(seen), float(parameters["bench.maximum_voltage"]))
        self.minutes, self.records = sum(map(_minutes, observations)), len(observations)

    def experiment(self, kind: str, why: str, minutes: float, separations: Separations,
                   **more: Any) -> NextExperiment:
        """An experiment with its worth, from the separations of the causes."""
        found = self.utilities.found
        if known := more.get("parameters"):  # no record; measured parameters surprise no more
            fitted = self.search.recalibrated
            moved = zip(fitted.unknowns.bench_names, fitted.x.tolist(), strict=False)
            found = replace(found, surprise=sum(x**2 for n, x in moved if n not in known))
        else:
            found = replace(found, records=found.records + 1)
        after = prospect(Utilities(found), self.probability, separations)
        causes = tuple(dict.fromkeys(name for pair in separations for name in pair))
        return NextExperiment(kind, why, causes, minutes=minutes, chance=after.named,
                              worth=after.given - self.before, **more)


def next_experiment(candidates: Sequence[Candidate], search: Search, utilities: Utilities,
                    observations: Sequence[Observation],
                    parameters: Parameters) -> NextExperiment | None:
    """The experiment with most worth per minute among the best ones. `candidates`: sorted, the most
    probable first. None if only one candidate is credible or no experiment could be worth it; if
    none that the bench can do is worth it, the result does not `settle`. Raises InputError: the
    bench's limits refuse every drive."""
    question = OpenQuestion(candidates, search, utilities, observations, parameters)
    open_still = [c for c in candidates[1:] if c.probability >= learnt().least]
    if not open_still or question.most < WORTH:
        return None
    options = [found for name in TESTS if (found := _test(name, question)) is not None]
    if len(question.fits) > 1:
        # The best drive, and the same with each sensor that the bench does not have.
        best = _best_drive(question)
        options.append(best)
        options += [_driven(best.protocol, question, mounted=(q,), minutes=_MOUNTED[q][2])
                    for q in _MOUNTED if q not in question.observation.quantities]
    if not options:
        return None
    most = max(option.worth for option in options)
    good = [o for o in options if o.worth >= most - (1.0 - _AS_GOOD) * abs(most)]
    first, *others = sorted(good, key=lambda o: o.worth / (o.minutes + _SETUP), reverse=True)
    what = f"named with a probability of {100.0 * first.chance:.0f} %"
    if first.chance < WORTH:
        what = f"{100 * first.worth:.0f} percentage points more probable, and named after more runs"
    also = [f"{o.why} ({o.minutes:.0f} min) with {100.0 * o.chance:.0f} %" for o in others[:2]]
    why = [f"{first.why}: the true cause would be {what}", *([", ".join(also)] if also else [])]
    return replace(first, why="; ".join(why))


def _minutes(obs: Observation) -> float:
    return float(obs.grid[-1] - obs.grid[0]) / 60.0


def _best_drive(question: OpenQuestion) -> NextExperiment:
    """The known drive with most worth, also tried for longer. InputError: all are refused."""

    def tried(drive: Drive) -> tuple[float, Drive, NextExperiment | InputError]:
        try:
            found = _driven(drive.document(question.level, question.sides), question)
        except InputError as error:
            return -np.inf, drive, error
        return found.worth - _A_MINUTE * found.minutes, drive, found

    first = max(in_threads(tried, [(drive,) for drive in KNOWN]), key=lambda one: one[0])
    longer = in_threads(tried, [(replace(first[1], minutes=minutes),) for minutes in LONGER])
    _, _, best = max([first, *longer], key=lambda one: one[0])
    if isinstance(best, InputError):
        raise best
    return best


def _driven(document: Mapping[str, Any], question: OpenQuestion, mounted: Sequence[str] = (),
            minutes: float = 0.0) -> NextExperiment:
    """A drive as an experiment with its worth."""
    fits = question.fits
    (first, fitted), *others = fits.items()
    planned, known = _planned(document, fitted, question, mounted)
    readings = {first: known, **{name: planned.predict(f.parameters) for name, f in others}}
    # The bench's own parameters have nearly the same derivatives under every cause.
    own_numbers = range(fitted.unknowns.baseline)
    shared = planned.derivatives(fitted.unknowns, fitted.x, known, own_numbers)

    def space(name: str) -> Array:
        """(n, k) whitened change of the readings, by a deviation of each free direction."""
        one, free = fits[name].unknowns, fits[name].x
        own = planned.derivatives(one, free, readings[name], range(one.baseline, len(free)))
        columns = np.hstack([shared, own]) @ fits[name].directions
        return np.hstack([planned.whiten(columns), planned.white_nuisances])

    spaces = dict(zip(fits, in_threads(space, [(name,) for name in fits]), strict=True))
    separations = _separations({name: planned.whiten(p) for name, p in readings.items()}, spaces)
    driven = _minutes(planned.observations[0])
    for pair, separation in separations.items():
        if pair[0] == RECALIBRATION:  # absent effects absorb errors of the model
            less = max(separation.evidence - _TAKEN_UP, min(separation.evidence, 0.0))
            separations[pair] = separation._replace(evidence=less)
        # No model predicts the drift of a zero: assume evidence as in the average record so far.
        steady, wanders = sorted(pair, key=lambda name: len(fits[name].unknowns.effects))
        one, other = (set(fits[name].unknowns.effects) for name in (steady, wanders))
        if other - one == {DRIFT_EFFECT} and one < other:
            gains = {n: f.gain for n, f in question.utilities.found.candidates.items()}
            share = min(driven / question.minutes, 1.0 / question.records)
            evidence = max(gains[wanders] - gains.get(steady, 0.0), 0.0) * share
            seen = float(np.sqrt(2.0 * evidence))  # visible in several records, if hardly in one
            separations[pair] = Separation(evidence, max(seen, VISIBLE) if evidence > 0.0 else 0.0)
    why = document["description"]
    if mounted:
        why += f", with the {' and the '.join(mounted)} of the wires measured too"
    quantities = (*question.observation.quantities, *mounted) if mounted else ()
    return question.experiment("sensor" if mounted else "protocol", why, minutes + driven,
                               separations, protocol=document, quantities=quantities)


def _test(name: str, question: OpenQuestion) -> NextExperiment | None:
    """A test of the paper as an experiment on the parameters that it measures better than they are
    known. A cause that affects the test's own readings is not separated by it."""
    test, parameters = TESTS[name], question.parameters
    stds = test.stds(parameters)
    items = question.search.recalibrated.unknowns.items
    done = measured(parameters)  # repeating a test would not improve them
    known = {item.name: (k, item.std) for k, item in enumerate(items) if item.name not in done}
    places = {n: known[n][0] for n, std in stds.items() if n in known and std < known[n][1]}
    fits = {c: f for c, f in question.fits.items() if test.readings_hold not in f.unknowns.effects}
    if not places or len(fits) < 2:
        return None
    errors = np.array([stds[n] / items[k].std for n, k in places.items()])

    def reading(fitted: Fit, x: Array) -> Array:
        there = fitted.unknowns.parameters(np.clip(x, *fitted.unknowns.bounds()))
        return np.array([items[k].x_of(there[n]) for n, k in places.items()]) / errors

    predicted, spaces = {}, {}
    for cause, f in fits.items():
        predicted[cause] = reading(f, f.x)
        moved = [reading(f, f.x + _STEP * column) for column in f.directions.T]
        spaces[cause] = (np.column_stack(moved) - predicted[cause][:, None]) / _STEP
    leaves = {n: stds[n] for n in places}
    return question.experiment(name, f"{test.title} ({', '.join(leaves)})", test.minutes,
                               _separations(predicted, spaces), parameters=leaves)


def _planned(document: Mapping[str, Any], fitted: Fit, question: OpenQuestion,
             mounted: Sequence[str]) -> tuple[Problem, Array]:
    """The bench on a protocol that it has not run, with the same sensors and rates and the newly
    `mounted` ones; their predicted readings (n,). Raises InputError: the wires get too hot."""
    protocol = parse_protocol(dict(document), question.parameters, "next experiment")
    time, commanded = protocol.sample(_PERIOD)
    voltage = heating_voltage(commanded, question.parameters)
    like, nothing = question.observation, np.zeros(0)
    more = [BinnedSignal(f"{channel}.{q}", q, wire, nothing, nothing, np.ones(1), _MOUNTED[q][1],
                         _MOUNTED[q][0], _MOUNTED[q][0], csr_array((0, 1)), SENSORS[q])
            for q in mounted for wire, channel in enumerate(like.channels)]
    signals = []
    for signal in (*like.signals, *more):
        stride = max(1, round(signal.period / _PERIOD))
        rows = np.arange(len(time) // stride)
        columns = np.arange(len(rows) * stride)
        entries = np.repeat(1.0 / stride, len(columns))
        if signal.quantity == "current":
            entries = entries * voltage[: len(columns), signal.wire]
        begins = np.arange(0, len(columns) + 1, stride)
        average = csr_array((entries, columns, begins), shape=(len(rows), len(time)))
        signals.append(replace(signal, time=time[0] + (rows + 0.5) * stride * _PERIOD,
                               value=np.zeros(len(rows)), average=average,
                               count=np.full(len(rows), signal.usual_count)))
    noise = {s.name: first_guess(s.noise, s.period, s.usual_drift) for s in more}
    obs = replace(
        like, grid=time, voltage=voltage, signals=tuple(signals), path=document["name"], delays={},
        imposed=None if like.imposed is None else np.full(len(time), like.imposed[0]), before=None)
    # A level held for longer than in the records makes the wires hotter than there.
    simulation = obs.simulate(fitted.parameters)
    hottest = float(simulation.temperature.max())
    limit = float(fitted.parameters["bench.maximum_temperature"]) - _COOLER
    if hottest > limit:
        raise InputError(f"next experiment: the wires would reach {hottest:.0f} K, expected "
                         f"at most {limit:.0f}")
    read = obs.readings(simulation)
    unknown = of_planned(obs, fitted.parameters, read)
    return Problem((obs,), noise | fitted.problem.noise, (unknown,)), read


def _separations(predicted: Mapping[str, Array], spaces: Mapping[str, Array]) -> Separations:
    """From whitened readings (n,) and changes in free directions (n, k) of each cause."""
    normals = {name: space.T @ space + np.eye(space.shape[1]) for name, space in spaces.items()}
    # Twice the log of the factor by which an experiment shrinks the volume that is free.
    freedom = {name: float(np.linalg.slogdet(normal)[1]) for name, normal in normals.items()}
    separations = {}
    for truth, rival in permutations(predicted, 2):
        # The distance that remains after the rival has refitted its numbers, under their priors.
        difference = predicted[truth] - predicted[rival]
        seen = spaces[rival].T @ difference
        taken = float(seen @ np.linalg.solve(normals[rival], seen))
        distance = float(np.sqrt(max(float(difference @ difference) - taken, 0.0)))
        evidence = 0.5 * (distance**2 + freedom[rival] - freedom[truth])
        separations[truth, rival] = Separation(evidence, distance)
    return separations


class Prospect(NamedTuple):
    """Probability that a verdict names the true cause, and the mean probability of this one."""

    named: float
    given: float


def prospect(utilities: Utilities, probability: Mapping[str, float],
             separations: Separations) -> Prospect:
    """The expected verdict after an experiment, averaged over true causes and noise.
    `probability`: of every candidate now; `separations`: by (true cause, rival) of the simulated
    causes; the others keep their odds against the true one."""
    simulated = list(dict.fromkeys(name for pair in separations for name in pair))
    now = dict(zip(utilities.effects, utilities.gains.tolist(), strict=True))
    named = given = 0.0

    def against(truth: str, rival: str) -> Array:
        """(l,) nats; none in favour of the truth if the difference would not be noticed."""
        separation = separations[truth, rival]
        nats = separation.evidence + _QUANTILES * separation.distance
        visible = max(separation.distance, separations[rival, truth].distance) >= VISIBLE
        return np.asarray(nats if visible else np.minimum(nats, 0.0))

    for truth in simulated:
        right = decision.BENIGN if truth == RECALIBRATION else (truth,)
        own = sum(probability.get(name, 0.0) for name in right)
        lost = {r: against(truth, r) for r in simulated if r != truth}
        over = lost.get(RECALIBRATION, np.zeros(len(_QUANTILES)))
        begun = now.get(truth, 0.0)
        # Causes that were not simulated keep their odds against the true one.
        longer = np.maximum(begun + over, 0.0) / begun if begun > 0.0 else np.ones(len(_QUANTILES))
        gains = [gain + over - lost.get(name, 0.0) if name in simulated else gain * longer
                 for name, gain in now.items()]
        after = utilities.probabilities(np.column_stack(gains)) if gains else np.zeros((1, 3))
        share = sum(after[:, utilities.names.index(name)] for name in right)
        given += own * float(np.mean(share))
        named += own * float(np.mean(share >= decision.NAMED))
    return Prospect(named, given)

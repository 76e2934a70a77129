"""What to measure next when several causes fit: the protocol on which they differ most.

Each tied cause, with the numbers that its fit gave it, is taken for the truth in turn and simulated
on a menu of protocols; each rival may refit its own numbers to that (to first order, under what the
records have already told of them). The evidence to be expected against the rival is half the square
of the distance that remains, in the noise of the bench's own sensors, and what the freedom that it
had to use costs it beside the truth's (Box and Hill, Technometrics 9, 1967). Direction counts: an
effect that is there cannot be refitted away by a model without it, one that is not there can.

Evidence alone breaks no tie: noise may go against the true cause, the decision trusts evidence up
to the misfit that any model keeps, and what nothing explains stays as probable as it was beside the
best cause. So the protocol is the one after which, by the decision's own rule, the true cause would
most probably be named; a long one that has some of all where no shorter one would do.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from sma_bench.diagnose.decision import NAMED, NO_GAP, UNEXPLAINED, Candidate, scale_of
from sma_bench.estimation.nuisances import offsets
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit
from sma_bench.estimation.threads import in_threads
from sma_bench.parameters import Parameters
from sma_bench.physics.heat import heating_voltage
from sma_bench.protocols import parse_protocol

Array = NDArray[np.float64]

WORTH = 0.5  # probability that the matter is settled: more probably than not
_MOST_CAUSES = 6
_LEAST = 0.02  # probability of a cause worth an experiment, if only as a rival
_PERIOD = 0.1  # s of the simulation
_STEP = 0.05
_UNLUCKY = 1.28  # standard deviations of noise that one draw in ten goes beyond
_VISIBLE = 3.0  # standard deviations
_CERTAIN = 500.0  # nats: beyond is the same, and no float


class Telling(NamedTuple):
    """What an experiment would say against a rival of the truth: the `evidence` to be expected
    [nats], and the `distance` of the two in standard deviations, by which noise scatters it."""

    evidence: float
    distance: float


@dataclass(frozen=True)
class NextExperiment:
    """A protocol that separates tied causes.

    Attributes:
        why: what it is for; separates: the causes; protocol: as a protocol file holds it;
            minutes: that it takes.
        distance: by which any two of them differ at least, the one that can less refitted to the
            other [standard deviations].
        chance: that one of them is true and named after it.
    """

    why: str
    separates: tuple[str, ...]
    protocol: dict[str, Any]
    distance: float
    chance: float
    minutes: float

    @property
    def settles(self) -> bool:
        """Whether it is worth the bench's time."""
        return self.chance >= WORTH

    def to_json(self) -> dict[str, Any]:
        """As in the contract."""
        return {
            "kind": "protocol", "why": self.why, "separates": list(self.separates),
            "chance": self.chance, "minutes": self.minutes, "distance": self.distance,
            "protocol": self.protocol,
        }


def next_experiment(
    candidates: Sequence[Candidate], observations: Sequence[Observation], parameters: Parameters
) -> NextExperiment | None:
    """The most telling protocol of the menu.

    Args:
        candidates: the most probable first; observations: the records, for what is measured and how
            hard the bench was driven.

    Returns:
        None when fewer than two causes can be simulated; one that does not `settle` the matter
        when no protocol does.
    """
    tied = [
        c for c in candidates
        if c.fit is not None and c.name not in (NO_GAP, UNEXPLAINED) and c.probability > _LEAST
    ][:_MOST_CAUSES]
    if len(tied) < 2:
        return None
    fits = {c.name: c.fit for c in tied if c.fit is not None}
    menu, long = _menu(_highest(observations, parameters), parameters)
    planned = [_weighed(each, fits, candidates, observations[0], parameters) for each in menu]
    if not any(experiment.settles for experiment in planned):
        planned.append(_weighed(long, fits, candidates, observations[0], parameters))
    best = max(planned, key=lambda experiment: (experiment.chance, experiment.distance))
    words = (
        f"{best.why}: tells them apart by {best.distance:.1f} standard deviations; one of them "
        f"would be named with a probability of {100.0 * best.chance:.0f} %"
    )
    return replace(best, why=words)


def _weighed(
    document: dict[str, Any], fits: Mapping[str, Fit], candidates: Sequence[Candidate],
    like: Observation, parameters: Parameters,
) -> NextExperiment:
    """A protocol of the menu with what it would tell."""
    known = next(iter(fits.values())).problem
    planned = _planned(document, known, like, parameters)
    tellings = _tellings(fits, planned)
    grid = planned.observations[0].grid
    distance = min(max(tellings[a, b].distance, tellings[b, a].distance) for a, b in tellings)
    chance = chance_to_settle(candidates, tellings)
    minutes = float(grid[-1] - grid[0]) / 60.0
    return NextExperiment(
        document["description"], tuple(fits), document, distance, chance, minutes
    )


def _highest(observations: Sequence[Observation], parameters: Parameters) -> float:
    """The voltage that the bench has stood so far, as it is commanded."""
    seen = max(float(obs.voltage.max()) for obs in observations)
    if parameters["bench.drive"] == "duty":  # a record holds the direct voltage of the same heat
        seen = seen**2 / parameters["bench.supply_voltage"]
    return min(seen, float(parameters["bench.maximum_voltage"]))


def _menu(
    volts: float, parameters: Parameters
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Protocols within the voltage that the bench has stood, and one of a quarter of an hour."""
    sides = list(dict.fromkeys(parameters["bench.channel_sides"]))
    one = sides[0]
    other = sides[-1]
    level = round(volts, 3)

    def rest(seconds: float) -> dict[str, Any]:
        return {"kind": "rest", "duration": seconds}

    def step(side: str, share: float, seconds: float) -> dict[str, Any]:
        return {"kind": "step", "drive": side, "level": round(share * level, 3),
                "duration": seconds}

    def triangle(side: str, share: float, seconds: float) -> dict[str, Any]:
        return {"kind": "triangle", "drive": side, "peak": round(share * level, 3),
                "rise": seconds, "fall": seconds}

    def protocol(name: str, why: str, *steps: Sequence[dict[str, Any]]) -> dict[str, Any]:
        joined = [rest(5.0), *(part for group in steps for part in group)]
        return {"name": name, "description": why, "steps": joined}

    each = (one, other) if one != other else (one,)
    long_rests = [s for side in each for s in (step(side, 1.0, 15.0), rest(60.0))]
    slow = [s for side in each for s in (triangle(side, 1.0, 45.0), rest(30.0))]
    prewarmed = [
        step(other, 0.5, 60.0), triangle(one, 1.0, 12.0), rest(20.0),
        step(one, 0.5, 60.0), triangle(other, 1.0, 12.0), rest(40.0),
    ]
    growing = [s for side in each for share in (0.7, 0.8, 0.9, 1.0)
               for s in (triangle(side, share, 10.0), rest(10.0))]
    cycles = [s for _ in range(8) for side in each for s in (triangle(side, 1.0, 8.0), rest(8.0))]
    stairs = [step(side, share, 15.0) for side in each
              for share in (0.5, 0.7, 0.85, 1.0, 0.85, 0.7, 0.5)]
    again = [s for _ in range(5) for s in (triangle(one, 1.0, 12.0), rest(20.0))]
    return [
        protocol("long_rests", "full strokes with rests of a minute, for what is slow or stays",
                 long_rests, [rest(5.0)], long_rests),
        protocol("slow_triangles",
                 "slow full strokes, for what depends on temperature and not on time", slow),
        protocol("prewarmed",
                 "the passive side is warmed first, for what one side does to the other",
                 prewarmed),
        protocol("partial_loops",
                 "strokes of growing height, for what depends on how far one goes", growing),
        protocol("many_cycles", "many equal strokes, for what changes from cycle to cycle",
                 cycles),
        protocol("staircase", "steps up and down, each held, for what is slow under load",
                 stairs, [rest(40.0)]),
        protocol("one_side",
                 "one side only, again and again, for what the other side has to do with it",
                 again),
    ], protocol(
        "some_of_all", "slow and fast strokes, held and partial ones, for what no short record "
        "tells", slow, prewarmed, stairs, [rest(40.0)], long_rests,
    )


def _planned(
    document: dict[str, Any], known: Problem, like: Observation, parameters: Parameters
) -> Problem:
    """The bench on a protocol that it has not run: the same sensors at the same rates."""
    protocol = parse_protocol(document, parameters, "next experiment")
    time, commanded = protocol.sample(_PERIOD)
    voltage = heating_voltage(commanded, parameters)
    signals = tuple(_planned_signal(signal, time, voltage) for signal in like.signals)
    obs = replace(like, grid=time, voltage=voltage, signals=signals, path=document["name"])
    return Problem((obs,), known.noise, (offsets(signals),))


def _planned_signal(signal: BinnedSignal, time: Array, voltage: Array) -> BinnedSignal:
    stride = max(1, round(signal.period / _PERIOD))
    rows = np.arange(len(time) // stride)
    entries = np.repeat(1.0 / stride, len(rows) * stride)
    columns = np.arange(len(rows) * stride)
    if signal.quantity == "current":
        entries = entries * voltage[: len(columns), signal.wire]
    average = csr_array(
        (entries, (np.repeat(rows, stride), columns)), shape=(len(rows), len(time))
    )
    centre = time[0] + (rows + 0.5) * stride * _PERIOD
    return replace(
        signal, time=centre, value=np.zeros(len(rows)), average=average,
        count=np.full(len(rows), float(np.median(signal.count))),
    )


def _tellings(fits: Mapping[str, Fit], problem: Problem) -> dict[tuple[str, str], Telling]:
    """Of every (truth, rival)."""
    predicted = {name: problem.predict(f.parameters) for name, f in fits.items()}
    whitened = {name: problem.whiten(p) for name, p in predicted.items()}
    spaces = {name: _refit_space(f, problem, predicted[name]) for name, f in fits.items()}
    freedom = {name: _freedom(space) for name, space in spaces.items()}
    tellings = {}
    for truth, rival in permutations(fits, 2):
        distance = _left(whitened[truth] - whitened[rival], spaces[rival])
        evidence = 0.5 * (distance**2 + freedom[rival] - freedom[truth])
        tellings[truth, rival] = Telling(evidence, distance)
    return tellings


def chance_to_settle(
    candidates: Sequence[Candidate], tellings: Mapping[tuple[str, str], Telling]
) -> float:
    """Probability that one of the tied causes is true and would be named after an experiment.

    Args:
        candidates: as decided now.
        tellings: by (truth, rival) of all tied causes; others would stay as probable as they are.
    """
    tied = {truth for truth, _ in tellings}
    simulated = [c for c in candidates if c.name != UNEXPLAINED]
    most = max(c.probability for c in simulated)
    unexplained = 1.0 - sum(c.probability for c in simulated)
    gain = max(0.0, *(c.gain for c in simulated))
    settled = 0.0
    for truth in simulated:
        if truth.name not in tied:
            continue
        against = truth.probability * unexplained / most
        for rival in simulated:
            if rival is not truth:
                nats = _expected(tellings, truth.name, rival.name)
                odds = min(-nats / scale_of(gain + max(nats, 0.0)), _CERTAIN)
                against += rival.probability * float(np.exp(odds))
        if truth.probability / (truth.probability + against) >= NAMED:
            settled += truth.probability
    return settled


def _expected(tellings: Mapping[tuple[str, str], Telling], truth: str, rival: str) -> float:
    """Nats to be expected against a rival of the truth, unlucky noise taken off.

    An effect that is not there is told by not being seen, which takes an experiment that would show
    it; without that its freedom alone speaks against it, and that settles nothing.
    """
    if (truth, rival) not in tellings:
        return 0.0
    told = tellings[truth, rival]
    nats = told.evidence - _UNLUCKY * told.distance
    visible = max(told.distance, tellings[rival, truth].distance) >= _VISIBLE
    return nats if visible else min(nats, 0.0)


def _refit_space(fitted: Fit, problem: Problem, predicted: Array) -> Array:
    """Whitened directions (n, k) in which the records leave a cause free, one deviation long."""
    spread, turn = np.linalg.eigh(fitted.covariance)
    directions = turn * np.sqrt(np.maximum(spread, 0.0))

    def moved(column: Array) -> Array:
        there = fitted.unknowns.parameters(_within(fitted, fitted.x + _STEP * column))
        return problem.whiten((problem.predict(there) - predicted) / _STEP)

    columns = in_threads(moved, [(column,) for column in directions.T])
    return np.column_stack([*columns, problem.white_nuisances])


def _within(fitted: Fit, x: Array) -> Array:
    low, high = fitted.unknowns.bounds()
    return np.clip(x, low, high)


def _left(difference: Array, space: Array) -> float:
    """Norm of what refitting, each direction at its price, does not take away."""
    normal = space.T @ space + np.eye(space.shape[1])
    seen = space.T @ difference
    left = float(difference @ difference) - float(seen @ np.linalg.solve(normal, seen))
    return float(np.sqrt(max(left, 0.0)))


def _freedom(space: Array) -> float:
    """Log of how much of what was possible before an experiment is so no more after it."""
    return float(np.linalg.slogdet(space.T @ space + np.eye(space.shape[1]))[1])

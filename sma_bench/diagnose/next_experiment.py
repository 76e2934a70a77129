"""What to measure next when several causes fit: the protocol on which they differ most.

Each tied cause, with the numbers that its fit gave it, is simulated on a menu of protocols; each
rival may refit its own parameters to what the other predicts (to first order, under what the
records have already told of them). What is left, in the noise of the bench's own sensors, is the
distance by which that protocol would tell the two apart (T-optimal design, Atkinson and Fedorov
1975; Hunter and Reiner 1965).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from sma_bench.diagnose.decision import NO_GAP, UNEXPLAINED, Candidate
from sma_bench.diagnose.fit import Fit
from sma_bench.diagnose.problem import Problem, in_threads
from sma_bench.diagnose.view import Binned, View
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol

Array = NDArray[np.float64]

ENOUGH = 5.0  # standard deviations between two causes
_MOST_CAUSES = 4
_LEAST = 0.05  # probability of a cause worth an experiment
_PERIOD = 0.1  # s of the simulation
_STEP = 0.05


@dataclass(frozen=True)
class NextExperiment:
    """A protocol that separates tied causes, by `distance` standard deviations at least."""

    why: str
    separates: tuple[str, ...]
    protocol: dict[str, Any]
    distance: float

    def to_json(self) -> dict[str, Any]:
        """As in the contract."""
        return {
            "why": self.why, "separates": list(self.separates), "protocol": self.protocol,
            "distance": self.distance,
        }


def next_experiment(
    candidates: Sequence[Candidate], views: Sequence[View], parameters: Parameters
) -> NextExperiment | None:
    """The most telling protocol of the menu.

    Args:
        candidates: the most probable first; views: the records, for what is measured and how hard
            the bench was driven.

    Returns:
        None when fewer than two causes can be simulated; a `distance` below ENOUGH when no
        protocol separates them.
    """
    tied = [
        c for c in candidates
        if c.fit is not None and c.name not in (NO_GAP, UNEXPLAINED) and c.probability > _LEAST
    ][:_MOST_CAUSES]
    if len(tied) < 2:
        return None
    best: NextExperiment | None = None
    for name, why, steps in _menu(_highest(views, parameters), parameters):
        document = {"name": name, "description": why, "steps": steps}
        problem = _planned(document, tied[0].fit.problem, views[0], parameters)  # type: ignore[union-attr]
        distance = _smallest_distance([c.fit for c in tied if c.fit is not None], problem)
        if best is None or distance > best.distance:
            best = NextExperiment(why, tuple(c.name for c in tied), document, distance)
    if best is None:
        return None
    words = f"{best.why}: tells them apart by {best.distance:.1f} standard deviations"
    return replace(best, why=words)


def _highest(views: Sequence[View], parameters: Parameters) -> float:
    """The voltage that the bench has stood so far."""
    seen = max(float(view.voltage.max()) for view in views)
    return min(seen, float(parameters["bench.maximum_voltage"]))


def _menu(volts: float, parameters: Parameters) -> list[tuple[str, str, list[dict[str, Any]]]]:
    """Name, reason and steps of protocols, each within the voltage that the bench has stood."""
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

    each = (one, other) if one != other else (one,)
    return [
        ("long_rests", "full strokes with rests of a minute, for what is slow or stays",
         [rest(5.0), *(s for side in each for s in (step(side, 1.0, 15.0), rest(60.0)))] * 2),
        ("slow_triangles", "slow full strokes, for what depends on temperature and not on time",
         [rest(5.0), *(s for side in each for s in (triangle(side, 1.0, 45.0), rest(30.0)))]),
        ("prewarmed", "the passive side is warmed first, for what one side does to the other",
         [rest(5.0), step(other, 0.5, 60.0), triangle(one, 1.0, 12.0), rest(20.0),
          step(one, 0.5, 60.0), triangle(other, 1.0, 12.0), rest(40.0)]),
        ("partial_loops", "strokes of growing height, for what depends on how far one goes",
         [rest(5.0), *(s for side in each for share in (0.7, 0.8, 0.9, 1.0)
                       for s in (triangle(side, share, 10.0), rest(10.0)))]),
        ("many_cycles", "many equal strokes, for what changes from cycle to cycle",
         [rest(5.0), *(s for _ in range(8) for side in each
                       for s in (triangle(side, 1.0, 8.0), rest(8.0)))]),
        ("staircase", "steps up and down, each held, for what is slow under load",
         [rest(5.0), *(s for side in each for share in (0.5, 0.7, 0.85, 1.0, 0.85, 0.7, 0.5)
                       for s in (step(side, share, 15.0),)), rest(40.0)]),
        ("one_side", "one side only, again and again, for what the other side has to do with it",
         [rest(5.0), *(s for _ in range(5) for s in (triangle(one, 1.0, 12.0), rest(20.0)))]),
    ]


def _planned(
    document: dict[str, Any], known: Problem, like: View, parameters: Parameters
) -> Problem:
    """The bench on a protocol that it has not run: the same sensors at the same rates."""
    protocol = parse_protocol(document, parameters, "next experiment")
    time, voltage = protocol.sample(_PERIOD)
    signals = tuple(_expected(signal, time, voltage) for signal in like.signals)
    view = replace(like, grid=time, voltage=voltage, signals=signals, path=document["name"])
    none = tuple(np.full((len(s.time), 1), s.zero_std) for s in signals)
    return Problem((view,), known.noise, (none,))


def _expected(signal: Binned, time: Array, voltage: Array) -> Binned:
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


def _smallest_distance(fits: Sequence[Fit], problem: Problem) -> float:
    """Smallest distance of any two causes, the better of the two refitted to the other."""
    predicted = [problem.predict(f.parameters) for f in fits]
    whitened = [problem.stack(p) for p in predicted]
    spaces = [_refit_space(f, problem, p) for f, p in zip(fits, predicted, strict=True)]
    distances: list[float] = [
        _left(whitened[a] - whitened[b], spaces[k])
        for a, b in combinations(range(len(fits)), 2) for k in (a, b)
    ]
    return min(distances)


def _refit_space(fitted: Fit, problem: Problem, predicted: list[list[Array]]) -> Array:
    """Whitened directions (n, k) in which the records leave a cause free, one deviation long."""
    spread, turn = np.linalg.eigh(fitted.covariance)
    directions = turn * np.sqrt(np.maximum(spread, 0.0))

    def moved(column: Array) -> Array:
        there = fitted.unknowns.parameters(_within(fitted, fitted.x + _STEP * column))
        change = problem.predict(there)
        return problem.stack(
            [[(m - b) / _STEP for m, b in zip(ms, bs, strict=True)]
             for ms, bs in zip(change, predicted, strict=True)]
        )

    columns = in_threads(moved, [(column,) for column in directions.T])
    return np.column_stack([*columns, problem.nuisance_rows])


def _within(fitted: Fit, x: Array) -> Array:
    low, high = fitted.unknowns.bounds()
    return np.clip(x, low, high)


def _left(difference: Array, space: Array) -> float:
    """Norm of what refitting, each direction at its price, does not take away."""
    normal = space.T @ space + np.eye(space.shape[1])
    seen = space.T @ difference
    left = float(difference @ difference) - float(seen @ np.linalg.solve(normal, seen))
    return float(np.sqrt(max(left, 0.0)))

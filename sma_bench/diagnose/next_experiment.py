"""What to measure next: the drive, the sensor or the test of the paper that settles most.

Each cause that is still possible, with the numbers that its fit gave it, is taken for the truth in
turn; every rival may refit its own numbers to what that would show, at the price that the records
have set. The evidence to be expected is half the square of the distance that remains, in noise, and
what the freedom that it had to use costs a rival (Box and Hill, Technometrics 9, 1967). Direction
counts: an effect that is there cannot be refitted away by a model without it, one that is not there
can. A test of one parameter is the same with one reading: the parameter.

What an experiment is worth is the probability that the truth is expected to be given after it
(`prospect.py`), less that of now: where no single one settles the matter, the first of several is
still found.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from sma_bench.diagnose.decision import (
    JOIN,
    LARGEST_SIGN,
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    Decision,
    Weights,
    sign_of_surprise,
    surprise_of,
)
from sma_bench.diagnose.drives import KNOWN, TESTS, Drive, changed, drawn, measured
from sma_bench.diagnose.prospect import VISIBLE, Telling, Tellings, prospect
from sma_bench.diagnose.result import WORTH, NextExperiment
from sma_bench.diagnose.search import Search
from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import first_guess
from sma_bench.estimation.nuisances import offsets
from sma_bench.estimation.observation import SENSORS, BinnedSignal, Observation
from sma_bench.estimation.residual import DRIFT_EFFECT, Problem
from sma_bench.estimation.side_by_side import in_threads
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.physics.heat import heating_voltage
from sma_bench.protocols import parse_protocol

Array = NDArray[np.float64]

_AS_GOOD = 0.8  # of the best one's worth: of these the quickest is proposed
_MOST_CAUSES, _SEARCHED = 6, 3
_LEAST = 0.02  # probability of a cause worth an experiment, if only as a rival
_COOLER = 10.0  # K below the bench's limit, as simulated
_PERIOD = 0.1  # s of the simulation
_STEP = 0.05
_DRAWS, _PARENTS, _CHILDREN = 14, 3, 4
_SEED = 1
_DIRECTIONS = 8  # of the least known, while drives are searched
_HOPE = 0.01  # of merit: where none of the first drives promises that, none is searched for
_ADDED = 6e-3  # to a drive's merit by refitting, at most: 4e-3 near the best of five cases
# Nats of a record that an effect which is not there keeps by taking up what the model misses: the
# mean of 11 rivals after further records of four cases of the development split.
_TAKEN_UP = 3.5
# A sensor that is not there yet: noise and time of a bin, and minutes until it is mounted.
_MOUNTED = {"temperature": (0.15, 0.2, 20.0), "current": (2e-3, 0.2, 10.0)}
_SETUP = 5.0  # minutes until the bench is cold and recorded again
# Of the most that any drive tells. One that tells much more settles less: of a large gain equations
# are off by their share.
_PLAIN = (Telling(10.0, 4.5), Telling(30.0, 7.7), Telling(100.0, 14.0))


# --- What is proposed.


class Matter:
    """What is still open: the causes, what their fits leave free, and what the bench can do."""

    def __init__(
        self, decision: Decision, search: Search, weights: Weights,
        observations: Sequence[Observation], parameters: Parameters,
    ) -> None:
        self.probability = {c.name: c.probability for c in decision.candidates}
        self.weights, self.search, self.parameters = weights, search, parameters
        possible = [
            c for c in decision.candidates
            if c.fit is not None and c.name != NO_GAP
            and (c.probability > _LEAST or c.name == RECALIBRATION)
        ]
        self.fits = {c.name: c.fit for c in possible[:_MOST_CAUSES] if c.fit is not None}
        self.fits.setdefault(RECALIBRATION, search.recalibrated)
        pairs = list(permutations(self.fits, 2))
        believed = replace(weights, surprise=-LARGEST_SIGN)

        def given(weights: Weights, telling: Telling) -> float:
            return prospect(weights, self.probability, dict.fromkeys(pairs, telling)).given

        self.before = given(weights, Telling(0.0, 0.0))
        self.most = max(given(believed, plain) for plain in _PLAIN) - self.before
        self.observation = max(observations, key=lambda o: len(o.quantities))
        self.sides = tuple(dict.fromkeys(parameters["bench.channel_sides"]))
        # The voltage that the bench has stood so far, as it is commanded.
        seen = max(float(obs.voltage.max()) for obs in observations)
        if parameters["bench.drive"] == "duty":  # records hold the direct voltage of that heat
            seen = seen**2 / parameters["bench.supply_voltage"]
        self.level = min(seen, float(parameters["bench.maximum_voltage"]))
        self.minutes, self.records = sum(map(_minutes, observations)), len(observations)

    def leading(self) -> dict[str, Fit]:
        """The few causes that drives are searched for."""
        return dict(list(self.fits.items())[:_SEARCHED])

    def wandering(self, tellings: Tellings, minutes: float) -> dict[tuple[str, str], Telling]:
        """Whether a zero wanders, no model predicts: another record tells as much as one of the
        records has, and a longer one no more, for it may only wander more slowly."""
        found = {}
        for pair in tellings:
            one, other = sorted(map(_parts, pair), key=len)
            if other - one == {DRIFT_EFFECT} and one < other:
                steady, wanders = sorted(pair, key=lambda name: len(_parts(name)))
                gains = self.weights.gains
                share = min(minutes / self.minutes, 1.0 / self.records)
                evidence = max(gains[wanders] - gains.get(steady, 0.0), 0.0) * share
                seen = float(np.sqrt(2.0 * evidence))  # several records tell what one hardly does
                found[pair] = Telling(evidence, max(seen, VISIBLE) if evidence > 0.0 else 0.0)
        return found

    def experiment(self, kind: str, why: str, minutes: float, tellings: Tellings,
                   **more: Any) -> NextExperiment:
        """What it would be worth, the rivals given."""
        measured = more.get("parameters") or ()
        after = prospect(self._believing(measured), self.probability, tellings)
        causes = dict.fromkeys(name for pair in tellings for name in pair)
        protocol = more.pop("protocol", {})
        return NextExperiment(
            kind, why, tuple(causes), protocol, minutes, after.named,
            after.given - self.before, **more
        )

    def _believing(self, measured: Sequence[str]) -> Weights:
        """A parameter that was measured surprises no more; a drive is one record more."""
        if not measured:
            return replace(self.weights, records=self.weights.records + 1)
        moved = surprise_of(self.search, measured)
        surprise = min(self.weights.surprise, sign_of_surprise(moved))
        return replace(self.weights, surprise=surprise)


def next_experiment(
    decision: Decision, search: Search, weights: Weights,
    observations: Sequence[Observation], parameters: Parameters,
) -> NextExperiment | None:
    """The quickest of what would settle the matter nearly as often as anything.

    Args:
        observations: the records, for what is measured and how hard the bench was driven.

    Returns:
        For `unexplained` a drive that shows more of it than all records do. Else None where one
        candidate makes up the credible set or no experiment could be worth it, and one that does
        not `settle` where none of those that the bench can do is.

    Raises:
        InputError: the bench's limits refuse every drive.
    """
    matter = Matter(decision, search, weights, observations, parameters)
    if decision.verdict == UNEXPLAINED:
        # The known drive that shows most a minute of what no effect explains, as far as a smooth
        # response of free form tells it; None where the records have shown as much.
        missing, recalibrated = matter.search.flexible, matter.search.recalibrated
        if not missing.gain > 0.0:
            return None
        so_far = float(np.linalg.norm(recalibrated.problem.whiten(missing.response)))
        shown = []
        for drive in KNOWN:
            document = drive.document(matter.level, matter.sides)
            planned = _planned(document, recalibrated.problem, matter, ())
            (obs,) = planned.observations
            _require_cool(obs, recalibrated.parameters)
            term = missing.on(obs, obs.simulate(recalibrated.parameters))
            size = float(np.linalg.norm(planned.whiten(term)))
            minutes = _minutes(obs)
            shown.append((size / np.sqrt(minutes + _SETUP), size, minutes, document))
        _, size, minutes, document = max(shown, key=lambda one: one[0])
        if size < so_far:
            return None
        why = (
            f"{document['description']}: would show what no effect explains by {size:.0f} standard "
            "deviations, as far as a smooth response of free form tells it"
        )
        return NextExperiment("protocol", why, (), document, minutes, 0.0, WORTH)
    if len(decision.credible) == 1 or matter.most < WORTH:
        return None
    tests = [_test(name, matter) for name in TESTS]
    options = [found for found in tests if found is not None]
    drives = _drives(matter) if len(matter.fits) > 1 else []
    if drives:
        options += [_driven(drives[0], matter, matter.fits)]
        # The same drive with each sensor that the bench does not have.
        options += [
            _driven(drives[0], matter, matter.fits, mounted=(q,), minutes=_MOUNTED[q][2])
            for q in _MOUNTED if q not in matter.observation.quantities
        ]
    if not options:
        return None
    most = max(option.worth for option in options)
    good = [o for o in options if o.worth >= most - (1.0 - _AS_GOOD) * abs(most)]
    ranked = sorted(good, key=lambda o: o.worth / (o.minutes + _SETUP), reverse=True)
    first, *others = ranked
    why = f"{first.why}: the true cause would be named with {100.0 * first.chance:.0f} %"
    if first.chance < WORTH:
        why = (
            f"{first.why}: the true cause would become more probable, by {100.0 * first.worth:.0f} "
            "% of all, and be named after more of it"
        )
    if others:
        why += "; " + ", ".join(
            f"{o.why} ({o.minutes:.0f} min) with {100.0 * o.chance:.0f} %"
            for o in others[:2]
        )
    return replace(first, why=why)


def _parts(name: str) -> frozenset[str]:
    """Effects in a candidate's name."""
    return frozenset(() if name == RECALIBRATION else name.split(JOIN))


def _minutes(obs: Observation) -> float:
    return float(obs.grid[-1] - obs.grid[0]) / 60.0


def _drives(matter: Matter) -> list[dict[str, Any]]:
    """Documents of the drives that are worth most, the best one first: some known ones and some
    drawn, then changes of the best.

    Refitting adds hardly anything to a merit: what is far behind without it is none of the best,
    and where even the best of the first ones is worth next to nothing, the search ends with them.
    """
    random = np.random.default_rng(_SEED)
    leading = matter.leading()
    promised: dict[Drive, float | str] = {}
    weighed: dict[Drive, float] = {}

    def document(drive: Drive) -> dict[str, Any]:
        return drive.document(matter.level, matter.sides)

    def merit(drive: Drive, directions: int) -> float | str:
        try:
            found = _driven(document(drive), matter, leading, directions)
            return found.worth - 0.002 * found.minutes
        except InputError as error:
            return str(error)

    def ranked() -> list[Drive]:
        found = [drive for drive in promised if drive in weighed]
        return sorted(found, key=lambda drive: weighed[drive], reverse=True)

    def promise(drives: Sequence[Drive]) -> list[tuple[float, Drive]]:
        """Those that are new and not refused, the most promising first."""
        new = [drive for drive in dict.fromkeys(drives) if drive not in promised]
        promised.update(zip(new, in_threads(merit, [(d, 0) for d in new]), strict=True))
        found = [(p, k) for k, d in enumerate(new) if isinstance(p := promised[d], float)]
        return [(p, new[k]) for p, k in sorted(found, reverse=True)]

    def weigh(left: list[tuple[float, Drive]]) -> None:
        while left:
            best = ranked()[:_PARENTS]
            if len(best) == _PARENTS and left[0][0] + _ADDED < weighed[best[-1]]:
                break
            pair, left = [drive for _, drive in left[:2]], left[2:]
            found = in_threads(merit, [(drive, _DIRECTIONS) for drive in pair])
            weighed.update((d, m) for d, m in zip(pair, found, strict=True) if isinstance(m, float))

    first = promise([*KNOWN, *(drawn(random) for _ in range(_DRAWS))])
    if first and first[0][0] < _HOPE:
        return [document(drive) for _, drive in first]
    weigh(first)
    for _ in range(2):
        near = [changed(drive, random) for drive in ranked()[:_PARENTS] for _ in range(_CHILDREN)]
        weigh(promise(near))
    refused = [said for said in promised.values() if isinstance(said, str)]
    if not weighed and refused:
        raise InputError(refused[-1])
    return [document(drive) for drive in ranked()]


def _driven(
    document: Mapping[str, Any], matter: Matter, fits: Mapping[str, Fit],
    most: int | None = None, mounted: Sequence[str] = (), minutes: float = 0.0,
) -> NextExperiment:
    """A drive with what it would tell; `most` directions of each cause, all by default."""
    first = next(iter(fits.values()))
    planned = _planned(document, first.problem, matter, mounted)
    _require_cool(planned.observations[0], first.parameters)
    tellings = taken_up(_tellings(*_on(planned, fits, most)))
    driven = _minutes(planned.observations[0])
    tellings |= matter.wandering(tellings, driven)
    minutes += driven
    why = document["description"]
    if mounted:
        why += f", with the {' and the '.join(mounted)} of the wires measured too"
    quantities = (*matter.observation.quantities, *mounted) if mounted else ()
    return matter.experiment(
        "sensor" if mounted else "protocol", why, minutes, tellings, protocol=document,
        quantities=quantities,
    )


def _require_cool(planned: Observation, parameters: Parameters) -> None:
    """Where a level is held for longer than ever, the wires get hotter than they were."""
    hottest = float(planned.simulate(parameters).temperature.max())
    limit = float(parameters["bench.maximum_temperature"]) - _COOLER
    if hottest > limit:
        raise InputError(
            f"next experiment: the wires would reach {hottest:.0f} K, expected at most {limit:.0f}"
        )


def _test(name: str, matter: Matter) -> NextExperiment | None:
    """A test of the paper, of the parameters that it would know better than they are known; a
    cause that is in its readings is as open after it as before."""
    test, parameters = TESTS[name], matter.parameters
    stds = test.stds(parameters)
    items = matter.search.recalibrated.unknowns.items
    known = {item.name: (k, item.std) for k, item in enumerate(items)}
    for name in measured(parameters):  # once more it would be no better
        known.pop(name, None)
    places = {n: known[n][0] for n, std in stds.items() if n in known and std < known[n][1]}
    fits = {c: f for c, f in matter.fits.items() if test.readings_hold not in _parts(c)}
    if not places or len(fits) < 2:
        return None
    errors = np.array([stds[n] / items[k].std for n, k in places.items()])

    def reading(fitted: Fit, x: Array) -> Array:
        there = fitted.unknowns.parameters(np.clip(x, *fitted.unknowns.bounds()))
        values = [items[k].x_of(there[n]) for n, k in places.items()]
        return np.array(values) / errors

    predicted, spaces = {}, {}
    for cause, f in fits.items():
        predicted[cause] = reading(f, f.x)
        moved = [reading(f, f.x + _STEP * column) for column in _directions(f).T]
        spaces[cause] = (np.column_stack(moved) - predicted[cause][:, None]) / _STEP
    leaves = {n: stds[n] for n in places}
    return matter.experiment(
        name, f"{test.title} ({', '.join(leaves)})", test.minutes,
        _tellings(predicted, spaces), parameters=leaves,
    )


# --- What an experiment would show of each cause.


def _planned(
    document: Mapping[str, Any], known: Problem, matter: Matter, mounted: Sequence[str]
) -> Problem:
    """The bench on a protocol that it has not run: the same sensors at the same rates."""
    protocol = parse_protocol(dict(document), matter.parameters, "next experiment")
    time, commanded = protocol.sample(_PERIOD)
    voltage = heating_voltage(commanded, matter.parameters)
    like = matter.observation
    more = [_new_signal(q, wire, like) for q in mounted for wire in range(len(like.channels))]
    signals = tuple(_planned_signal(signal, time, voltage) for signal in (*like.signals, *more))
    noise = {s.name: first_guess(s.noise, s.period, s.usual_drift) for s in more} | known.noise
    obs = replace(
        like, grid=time, voltage=voltage, signals=signals, path=document["name"], delays={}
    )
    return Problem((obs,), noise, (offsets(signals),))


def _new_signal(quantity: str, wire: int, like: Observation) -> BinnedSignal:
    noise, period, _ = _MOUNTED[quantity]
    nothing = np.zeros(0)
    return BinnedSignal(
        f"{like.channels[wire]}.{quantity}", quantity, wire, nothing, nothing, np.ones(1), period,
        noise, csr_array((0, 1)), SENSORS[quantity],
    )


def _planned_signal(signal: BinnedSignal, time: Array, voltage: Array) -> BinnedSignal:
    stride = max(1, round(signal.period / _PERIOD))
    rows = np.arange(len(time) // stride)
    entries = np.repeat(1.0 / stride, len(rows) * stride)
    columns = np.arange(len(rows) * stride)
    if signal.quantity == "current":
        entries = entries * voltage[: len(columns), signal.wire]
    average = csr_array((entries, (np.repeat(rows, stride), columns)), shape=(len(rows), len(time)))
    centre = time[0] + (rows + 0.5) * stride * _PERIOD
    return replace(
        signal, time=centre, value=np.zeros(len(rows)), average=average,
        count=np.full(len(rows), float(np.median(signal.count))),
    )


Columns = dict[str, Array]


def _on(
    problem: Problem, fits: Mapping[str, Fit], most: int | None
) -> tuple[Columns, Columns]:
    """By cause: whitened readings (n,), and whitened directions (n, k) in which the records leave
    it free, one deviation long."""
    predicted = {name: problem.predict(f.parameters) for name, f in fits.items()}

    def space(name: str) -> Array:
        fitted, here = fits[name], predicted[name]
        along = _directions(fitted).T
        along = along if most is None else along[max(len(along) - most, 0) :]
        if not len(along):
            return problem.white_nuisances
        moved = [np.clip(fitted.x + _STEP * one, *fitted.unknowns.bounds()) for one in along]
        there = problem.predict_many([fitted.unknowns.parameters(x) for x in moved])
        columns = (there - here[:, None]) / _STEP
        return np.hstack([problem.whiten(columns), problem.white_nuisances])

    spaces = dict(zip(fits, in_threads(space, [(name,) for name in fits]), strict=True))
    return {name: problem.whiten(p) for name, p in predicted.items()}, spaces


def _directions(fitted: Fit) -> Array:
    """(k, k) columns in x, one deviation long, the least known last."""
    spread, turn = np.linalg.eigh(fitted.covariance)
    return np.asarray(turn * np.sqrt(np.maximum(spread, 0.0)))


def _tellings(predicted: Columns, spaces: Columns) -> dict[tuple[str, str], Telling]:
    """Of every (truth, rival)."""
    freedom = {name: _freedom(space) for name, space in spaces.items()}
    tellings = {}
    for truth, rival in permutations(predicted, 2):
        distance = _left(predicted[truth] - predicted[rival], spaces[rival])
        evidence = 0.5 * (distance**2 + freedom[rival] - freedom[truth])
        tellings[truth, rival] = Telling(evidence, distance)
    return tellings


def taken_up(tellings: Tellings) -> dict[tuple[str, str], Telling]:
    """As a bench tells it that is not quite the model: against effects, of recalibration."""
    return {
        (truth, rival): telling._replace(
            evidence=max(telling.evidence - _TAKEN_UP, min(telling.evidence, 0.0))
        ) if truth == RECALIBRATION else telling
        for (truth, rival), telling in tellings.items()
    }


def _left(difference: Array, space: Array) -> float:
    """Norm of what refitting, each direction at its price, does not take away."""
    normal = space.T @ space + np.eye(space.shape[1])
    seen = space.T @ difference
    left = float(difference @ difference) - float(seen @ np.linalg.solve(normal, seen))
    return float(np.sqrt(max(left, 0.0)))


def _freedom(space: Array) -> float:
    """Log of how much of what was possible before an experiment is so no more after it."""
    return float(np.linalg.slogdet(space.T @ space + np.eye(space.shape[1]))[1])

"""The most probable unknowns of a model, and its evidence.

    maximise  log p(records | x, z, noise) + log p(x) + log p(z)

by Gauss-Newton steps within bounds, damped where necessary, with the nuisances z eliminated. The
noise of every sensor is estimated again from the residual. The evidence is Laplace's approximation.

scipy.optimize.least_squares took two to eight times as many simulations to the same optimum: it
cannot reuse derivatives of unknowns that hardly move, or stop at a fraction of a nat."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.linalg import cho_solve

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.estimation.nuisances import STATE, STATES, TICK
from sma_bench.estimation.residual import DRIFT_EFFECT, USUAL_MISFIT, USUAL_WEIGHT, Problem
from sma_bench.estimation.unknowns import Unknowns, shares_of_factor
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, silent

_MOST_STEPS, _FAR_STEPS = 10, 30  # of one round; of the approach from afar
# prior deviations: starts for the moment between two samples at which a slow logger's voltage jumps
_TICKS = -1.3, 0.0, 1.3
_MOVES = 8  # of nuisances that are not linear, at most
_WEIGHT_ROUNDS, _MOST_ROUNDS = 5, 15  # of new weights: at least; at most, while they change
_SAME_WEIGHT = 0.5  # change of a level's logarithm
_USUAL_STATES, _LEAST_STATE = 0.5, 0.05  # weight of a usual size, in states; smallest size
_RADIUS = 8.0  # prior deviations, the longest step
_GAIN, _SETTLED = 0.3, 1.0  # nats: a step that gains less is the last one; from afar
_SHORTEST = 1e-2  # prior deviations: a step that is shorter and promises little is not taken
_NEAR = 0.1  # prior deviations: derivatives of the baseline are reused up to this distance
_DAMPINGS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)
_STRETCHES = 6  # per record, for the jackknife: about a pulse and its rest each
_TINY = 1e-12
_HALVINGS, _ALLOWED = 5, 16.0  # of a draw, at most; times its expected cost
by_evidence = attrgetter("evidence")


@dataclass(frozen=True, eq=False)
class Fit:
    """One model, fitted."""

    problem: Problem  # with the noise that this model leaves
    unknowns: Unknowns
    x: Array  # (k,) where these ended
    z: Array  # (q,) nuisances
    joint: Array  # (k + q, k + q) covariance of x and z
    evidence: float  # log of p(records | model), up to a constant common to all models
    predicted: Array  # (n,) readings
    derivatives: Array  # (n, k) of these
    residual: Array  # (n,) measured minus predicted, without the nuisances' part

    @property
    def covariance(self) -> Array:
        """(k, k) of x."""
        return self.joint[: len(self.x), : len(self.x)]

    @property
    def directions(self) -> Array:
        """(k, k) columns in x, one standard deviation long, the least known last."""
        spread, turn = np.linalg.eigh(self.covariance)
        return np.asarray(turn * np.sqrt(np.maximum(spread, 0.0)))

    @cached_property
    def parameters(self) -> Parameters:
        """The bench at x."""
        return self.unknowns.parameters(self.x)

    @property
    def std(self) -> Array:
        """(k,) standard errors in the parameters' units, as if the residual were noise only."""
        turn = self.unknowns.turn(self.x)
        return self.unknowns.slopes(self.x) * np.sqrt(np.diag(turn @ self.covariance @ turn.T))

    @property
    def errors(self) -> Array:
        """(k,) standard errors for reports: `jackknifed`, and for an effect's number the error of
        the factor with which it is multiplied in the model."""
        values = self.unknowns.values(self.x).tolist()
        factors = [sum(shares_of_factor(name, value, self.parameters).values())
                   for name, value in zip(self.unknowns.names, values, strict=True)]
        return np.hypot(self.jackknifed, factors)

    def with_repeated_misfit(self) -> "Fit":
        """The same fit with errors for a misfit that repeats in every stroke."""
        problem = self.problem.with_weights(self.residual, repeated=True)
        rows = np.hstack([problem.whiten(self.derivatives), problem.white_nuisances])
        joint = np.linalg.inv(rows.T @ rows + np.eye(rows.shape[1]))
        return replace(self, joint=np.asarray(joint, dtype=np.float64))

    def within_reach(self, steps: Array) -> Array:
        """Steps (p, k) from x, drawn by its covariance, each halved until the cost grows by no more
        than sixteen times what the covariance predicts."""
        problem = self.problem.with_weights(self.residual, repeated=True)
        low, high = self.unknowns.bounds()

        def costs(steps: Array) -> Array:
            places = np.clip(self.x + steps, low, high)
            readings = problem.predict_many([self.unknowns.parameters(x) for x in places])
            white = problem.whiten(problem.measured[:, np.newaxis] - readings)
            seen = problem.white_nuisances.T @ white
            taken = np.sum(seen * cho_solve(problem.nuisance_factor, seen), axis=0)
            return np.asarray(np.sum(white**2, axis=0) - taken + np.sum(places**2, axis=1))

        allowed = _ALLOWED * np.einsum("ij,jk,ik->i", steps, np.linalg.inv(self.covariance), steps)
        allowed += costs(np.zeros((1, len(self.x))))
        steps, far = steps.copy(), np.arange(len(steps))
        for _ in range(_HALVINGS):
            far = far[costs(steps[far]) > allowed[far]]
            if not len(far):
                break
            steps[far] *= 0.5
        return steps

    @cached_property
    def jackknifed(self) -> Array:
        """(k,) standard errors, enlarged for the misfit of the model, the prior's at most.

        All bins of a pulse share its misfit. So records are cut into stretches, and the unknowns
        are estimated without each in turn (the jackknife over groups; Shao and Tu, The Jackknife
        and Bootstrap, 1995), linearised at the optimum. If the squares of these moves are larger
        than noise would make them, the variance of an unknown grows by that ratio. The pull of the
        priors, which no stretch contains, is subtracted first."""
        rows = np.hstack([self.problem.whiten(self.derivatives), self.problem.white_nuisances])
        information, k = rows.T @ rows + np.eye(rows.shape[1]), len(self.x)
        turn = self.unknowns.turn(self.x)
        known = np.diag(turn @ self.covariance @ turn.T)
        pulled = rows @ (self.joint @ np.concatenate([self.x, self.z]))
        white = self.problem.whiten(self.residual) - pulled
        moved, expected = np.zeros(len(known)), np.zeros(len(known))
        for index in self.problem.stretches(_STRETCHES):
            own = rows.take(index, axis=0)
            try:
                without = np.linalg.solve(
                    information - own.T @ own,
                    np.column_stack([np.eye(len(information), k), own.T @ white[index]]))[:k]
            except np.linalg.LinAlgError:  # absurd readings: only this stretch has them
                return self.unknowns.slopes(self.x)
            moved += (turn @ without[:, k]) ** 2
            expected += np.diag(turn @ without[:, :k] @ turn.T) - known
        excess = moved / np.maximum(expected, _TINY)
        variance = np.minimum(known * np.maximum(excess, 1.0), 1.0)
        return self.unknowns.slopes(self.x) * np.sqrt(variance)


def fit(problem: Problem, unknowns: Unknowns, x: Array, *, rounds: int = 3,
        frozen: Array | None = None, keep_noise: bool = False, far: bool = False,
        predicted: Array | None = None) -> Fit:
    """Fit one model to records from x (k,), beginning with the noise of the problem.

    Args:
        rounds: of fitting and estimating the noise; one after an approach from afar.
        frozen: (n, baseline) derivatives of the baseline's unknowns to use: quick and slightly off;
            else they are computed in every round. Those of effects are computed at every step.
        keep_noise: do not estimate the noise.
        far: x is far from the optimum; begin with `_State.approach`.
        predicted: (n,) readings at x, where they are known."""
    state = _State(problem, unknowns, x, frozen, predicted)
    if far:
        state.approach()
    state.linearise()
    for number in range(1 if far else rounds):
        if number:
            state.linearise()
        state.climb(_MOST_STEPS)
        if not keep_noise:
            state.problem = state.problem.with_noise(state.residual())
        if number == rounds - 1:
            state.climb(2)
    return state.finished()


def _from_starts(problem: Problem, unknowns: Unknowns, starts: Sequence[Array], report: Report,
                 **how: Any) -> tuple[Fit, list[Fit]]:
    """The best of the fits from all starts (k,), and all; their progress leaves one step."""

    def from_start(number: int, x: Array) -> Fit:
        report(number / (len(starts) + 1), f"start {number + 1} of {len(starts)}")
        return fit(problem, unknowns, x, **how)

    tried = in_threads(from_start, list(enumerate(starts)))
    report(len(starts) / (len(starts) + 1), "from the best start to the end")
    return max(tried, key=by_evidence), tried


def recalibrate(problem: Problem, parameters: Parameters, unknowns: Unknowns,
                starts: Sequence[Array], report: Report = silent,
                keep_noise: bool = False) -> tuple[Fit, list[Fit]]:
    """The final fit, from the best of several starts (k,), and the fits of all starts.
    `keep_noise`: begin the final fit with the noise of the best start. With the first guess it may
    end some nats before its optimum; the thresholds of the diagnosis were found with that."""
    first = problem.with_nuisances(parameters)
    best, tried = _from_starts(first, unknowns, starts, report, far=True)
    if first.of_kind(TICK).any():
        # Linearised at a late jump, a fit does not find an early one: try several.
        there = np.where(first.of_kind(TICK), np.array(_TICKS)[:, np.newaxis], 0.0)
        begun = [(first.moved(best.parameters, z), unknowns, best.x) for z in there]
        best = max(in_threads(partial(fit, rounds=1), begun), key=by_evidence)
    if first.of_kind(TICK).any() or (first.later and len(first.observations) > 1):
        for _ in range(_MOVES):
            before = best.evidence
            best = fit(best.problem.about(best.parameters, best.z), unknowns, best.x, rounds=1)
            if abs(best.evidence - before) < _SETTLED:
                break
        first = best.problem
    last = (best.problem if keep_noise else first).with_nuisances(best.parameters)
    return fit(last, unknowns, best.x, rounds=2, predicted=best.predicted), tried


def fit_imperfect(problem: Problem, parameters: Parameters, unknowns: Unknowns,
                  starts: Sequence[Array], report: Report = silent) -> tuple[list[Fit], list[Fit]]:
    """`recalibrate` for a model that is never quite right: records are weighted by its misfit
    (`Problem.with_weights`), again as the fit improves. Several runs have two fits: in equal
    states, and each in a state of its own (`STATES`), of a size that is estimated."""
    several = float(len(problem.observations) > 1)
    first = problem.with_nuisances(parameters, several).with_weights()
    best, tried = _from_starts(first, unknowns, starts, report, rounds=2, keep_noise=True)
    sensors = {block.signal.quantity for block in first.blocks}
    found = []
    for states in (0.0, 1.0) if several else (0.0,):
        ended = [_weighed(first, best, states)]
        if len(sensors) > 1:
            # A sensor that misfits weighs little, and may misfit because it weighs little: compare
            # with a fit in which all weigh as much as their noise allows.
            last = ended[0]
            sharp = fit(replace(last.problem, weights=()), unknowns, last.x, rounds=1,
                        keep_noise=True)
            ended.append(_weighed(first, sharp, last.problem.states))
        readings = max(map(independent_readings, ended))
        found.append(max(ended, key=lambda one: log_evidence(one, readings)))
    return found, tried


def _weighed(first: Problem, fitted: Fit, states: float) -> Fit:
    """Fit on, with new weights by the misfit until they change no more."""
    for number in range(_MOST_ROUNDS):
        x = _with_common_states(fitted)
        there = first.with_nuisances(fitted.unknowns.parameters(x), states)
        weighed = there.with_weights(fitted.residual)
        levels = [[n.white for n in one.noises] for one in (weighed, fitted.problem)]
        changes = np.abs(np.diff(np.log(levels), axis=0))
        if number >= _WEIGHT_ROUNDS and np.max(changes) < _SAME_WEIGHT:
            break
        fitted = fit(weighed, fitted.unknowns, x, rounds=1, keep_noise=True)
        states = _scale_of_states(fitted)
    return fitted


def independent_readings(fitted: Fit) -> float:
    """Number of independent readings that its records are worth."""
    rho = np.array(fitted.problem.correlations(fitted.residual))
    bins = np.array([len(block.signal.time) for block in fitted.problem.blocks])
    return float(np.sum(np.maximum(bins * (1.0 - rho) / (1.0 + rho), 1.0)))


def log_evidence(fitted: Fit, readings: float) -> float:
    """ln Z of the model for N independent readings, without constants. The size of its misfit is
    integrated out: with its mean square m (in strokes), and a prior of 1.5 % worth two readings,

        ln Z = -(2 + N)/2 ln(2 0.015^2 + N m) - q^2/2 - ln|H|/2

    with unknowns and nuisances q in prior deviations, and their information H (Laplace)."""
    blocks = fitted.problem.blocks
    squares = [np.mean(fitted.residual[b.rows] ** 2)
               / max(np.ptp(b.signal.value), b.signal.noise) ** 2 for b in blocks]
    spread = USUAL_WEIGHT * USUAL_MISFIT**2 + readings * float(np.mean(squares))
    moved = float(fitted.x @ fitted.x + fitted.z @ fitted.z)
    freedom = float(np.linalg.slogdet(fitted.joint)[1])
    return -0.5 * (USUAL_WEIGHT + readings) * float(np.log(spread)) - 0.5 * moved + 0.5 * freedom


def _with_common_states(fitted: Fit) -> Array:
    """(k,) of the fit, with the mean state of its runs moved into the bench's own parameters."""
    unknowns, runs, x = fitted.unknowns, len(fitted.problem.observations), fitted.x.copy()
    items = (item for own in fitted.problem.nuisances for item in own.items)
    for item, z in zip(items, fitted.z.tolist(), strict=True):
        if item.kind == STATE and item.subject in unknowns.names:
            k = unknowns.names.index(item.subject)
            unknown = unknowns.items[k]
            x[k] = unknown.x_of(unknown.value(x[k]) + item.std * z / runs)
    return np.clip(x, *unknowns.bounds())


def _scale_of_states(fitted: Fit) -> float:
    """Size of the runs' states in times the usual, with half a usual one as prior; without their
    mean, which cannot be separated from the bench's own parameters."""
    before, runs = fitted.problem.states, len(fitted.problem.observations)
    items = [item for own in fitted.problem.nuisances for item in own.items]
    names = {item.subject for item in items if item.kind == STATE}
    if before == 0.0 or not names:
        return 0.0
    power, apart = _USUAL_STATES, np.eye(runs) - 1.0 / runs
    for name in names:
        which = [k for k, i in enumerate(items) if (i.kind, i.subject) == (STATE, name)]
        z, places = fitted.z[which], len(fitted.x) + np.array(which)
        variance = np.trace(apart @ fitted.joint[np.ix_(places, places)])
        power += before**2 * float(z @ apart @ z + variance)
    return max(float(np.sqrt(power / (_USUAL_STATES + len(names) * (runs - 1)))), _LEAST_STATE)


def least_scale(fitted: Fit) -> float:
    """Least size of a new run's state in times the usual: 1 after one run, less after several."""
    compared = len(STATES) * (len(fitted.problem.observations) - 1)
    return float(np.sqrt(_USUAL_STATES / (_USUAL_STATES + compared)))


class _State:
    def __init__(self, problem: Problem, unknowns: Unknowns, x: Array, frozen: Array | None,
                 predicted: Array | None) -> None:
        # The deflection's zero wanders if that is one of the effects.
        drifting = ("deflection",) if DRIFT_EFFECT in unknowns.effects else ()
        noise = {n: replace(own, wanders=n in drifting) for n, own in problem.noise.items()}
        self.problem = replace(problem, noise=noise)
        self.unknowns, self.given, self.base = unknowns, frozen, frozen
        self.linear_about: Array | None = None
        # Cache: problem, baseline's derivatives, these whitened, information, and on the nuisances.
        self.kept: tuple[Problem, Array, Array, Array, Array] | None = None
        self.slopes_of: tuple[Array | None, Array | None] = None, None
        self.x = np.clip(x, *unknowns.bounds())
        if predicted is None:
            predicted = self.problem.predict(unknowns.parameters(self.x))
        self.predicted = predicted
        self.z = self._best_nuisances()

    def linearise(self, rough: bool = False) -> None:
        """Take derivatives at x, or reuse those from nearby; `rough`: for steps from afar."""
        about, near = self.linear_about, 0.0 if self.problem.voltage_noise else _NEAR
        off = np.inf if about is None else np.max(np.abs(self.x - about), initial=0.0)
        if self.given is None and off > near:
            self.linear_about = self.x
            self.base = self.problem.derivatives(self.unknowns, self.x, self.predicted,
                                                 range(self.unknowns.baseline), rough)
        self._take_slopes()

    def _take_slopes(self) -> None:
        assert self.base is not None
        if self.slopes_of[0] is not self.base or self.slopes_of[1] is not self.x:
            self.slopes_of = self.base, self.x
            own = self.problem.derivatives(self.unknowns, self.x, self.predicted,
                                           range(self.unknowns.baseline, len(self.x)))
            self.slopes = np.hstack([self.base, own])

    def residual(self) -> Array:
        return self.problem.measured - self.predicted - self.problem.nuisance_rows @ self.z

    def cost(self) -> float:
        """Twice the negative log posterior, without its constants."""
        white = self.problem.whiten(self.residual())
        return float(white @ white + self.x @ self.x + self.z @ self.z)

    def approach(self) -> None:
        """Steps from afar, as long as they gain. At every second one rough derivatives are not
        computed, but updated by the last step (Broyden, Math. Comp. 19 (1965) 577)."""
        before, last, rough = np.inf, None, self.problem.voltage_noise
        for _ in range(_FAR_STEPS):
            self.problem = self.problem.with_noise(self.residual())
            if not rough or last is None or (self.x == last[0]).all():
                last = self.x, self.predicted
                self.linearise(rough)
            else:
                self._broyden(*last)
                last = None
            now = self._descend(self.cost()) + 2.0 * self.problem.log_scale()
            if last is not None and before - now < 2.0 * _SETTLED:
                break
            before = now
        if rough:
            self.linear_about = None  # such derivatives are not those at x

    def _broyden(self, x: Array, predicted: Array) -> None:
        """Update the baseline's derivatives to reproduce the step from x to here."""
        assert self.base is not None
        moved, missed = self.x - x, self.predicted - predicted - self.slopes @ (self.x - x)
        self.base = self.base + np.outer(missed, moved[: self.base.shape[1]]) / (moved @ moved)
        self._take_slopes()

    def climb(self, most: int) -> None:
        """Steps as long as they gain."""
        cost = self.cost()
        for number in range(most):
            if number:
                self._take_slopes()
            now = self._descend(cost)
            if cost - now < 2.0 * _GAIN:
                return
            cost = now

    def _descend(self, cost: float) -> float:
        """Take the least damped step that gains, if one does; returns the cost after it."""
        low, high = self.unknowns.bounds()
        normal, force = self._system()
        force[: len(self.x)] -= self.x
        before = self.x, self.z, self.predicted
        for damping in _DAMPINGS:
            step = self._step(normal, force, damping, low, high)
            gain = 0.5 * float(step @ force[: len(step)])
            if np.max(np.abs(step), initial=0.0) < _SHORTEST and gain < _SETTLED:
                break
            self.x = np.clip(before[0] + step, low, high)
            self.predicted = self.problem.predict(self.unknowns.parameters(self.x))
            self.z = self._best_nuisances()
            now = self.cost()
            if now < cost:
                return now
        self.x, self.z, self.predicted = before
        return cost

    def _system(self) -> tuple[Array, Array]:
        """Information (k + q, k + q) on x and z with their priors; right-hand side (k + q,)."""
        problem, nuisances = self.problem, self.problem.white_nuisances
        if self.kept is None or self.kept[0] is not problem or self.kept[1] is not self.base:
            assert self.base is not None
            base = problem.whiten(self.base)
            known = base.T @ base + np.eye(base.shape[1])
            self.kept = problem, self.base, base, known, base.T @ nuisances
        _, _, base, known, across = self.kept
        own = problem.whiten(self.slopes[:, self.unknowns.baseline :])
        mixed, shared = base.T @ own, own.T @ nuisances
        information = np.block([[known, mixed, across],
                                [mixed.T, own.T @ own + np.eye(own.shape[1]), shared],
                                [across.T, shared.T, problem.nuisance_information]])
        white = problem.whiten(problem.measured - self.predicted)
        return information, np.concatenate([base.T @ white, own.T @ white, nuisances.T @ white])

    def _step(self, normal: Array, force: Array, damping: float, low: Array, high: Array) -> Array:
        """(k,) step in prior deviations, within bounds, damped in the unknowns (Levenberg)."""
        k, damped = len(self.x), normal.copy()
        damped[range(k), range(k)] += damping
        free = np.ones(len(force), dtype=bool)
        for _ in range(4):
            step = np.zeros(len(force))
            step[free] = np.linalg.solve(damped[np.ix_(free, free)], force[free])
            outward = ((self.x <= low) & (step[:k] < 0.0)) | ((self.x >= high) & (step[:k] > 0.0))
            if not (outward & free[:k]).any():
                break
            free[:k] &= ~outward
        longest = float(np.max(np.abs(step[:k]), initial=0.0))
        return step[:k] * (_RADIUS / longest) if longest > _RADIUS else step[:k]

    def _best_nuisances(self) -> Array:
        problem = self.problem
        seen = problem.white_nuisances.T @ problem.whiten(problem.measured - self.predicted)
        return np.asarray(cho_solve(problem.nuisance_factor, seen))

    def finished(self) -> Fit:
        self._take_slopes()
        information, _ = self._system()
        joint: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
        freedom = float(np.linalg.slogdet(information)[1])
        evidence = -0.5 * self.cost() - 0.5 * freedom - self.problem.log_scale()
        evidence += self.problem.log_prior()
        # The problem without its whitened columns, which are large.
        return Fit(replace(self.problem), self.unknowns, self.x, self.z, joint, evidence,
                   self.predicted, self.slopes, self.residual())

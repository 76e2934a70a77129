"""Most probable numbers of one candidate, and how well its model predicts all records.

    maximise  log p(records | x, z, noise) + log p(x) + log p(z)

by Gauss-Newton steps; the noise of every sensor is estimated anew from what the candidate itself
leaves, so that a model is charged for structure it leaves only as far as noise cannot be that.
The evidence is Laplace's: the fit, less what its freedom was worth.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.problem import Problem
from sma_bench.diagnose.unknowns import Unknowns
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

_MOST_STEPS, _FAR_STEPS = 10, 20
_RADIUS = 8.0  # prior deviations a step
_GAIN = 0.3  # nats: a step that gains less is the last
_SHORTEST = 1e-2


@dataclass(frozen=True, eq=False)
class Fit:
    """One candidate, fitted.

    Attributes:
        problem: with the noise that this candidate leaves.
        unknowns, x: what was moved and to where; z: nuisances (q,).
        covariance: (k, k) of x.
        evidence: log of p(records | candidate), up to a constant common to all candidates.
        predicted: readings per view and signal; derivatives: of these.
        left: residual per view and signal, the nuisances' part taken off.
    """

    problem: Problem
    unknowns: Unknowns
    x: Array
    z: Array
    covariance: Array
    evidence: float
    predicted: list[list[Array]]
    derivatives: list[list[Array]]
    left: list[list[Array]]

    @property
    def parameters(self) -> Parameters:
        """The bench as this candidate has it."""
        return self.unknowns.parameters(self.x)

    @property
    def surprise(self) -> float:
        """Sum of the squared prior deviations of the bench's parameters: about their number where
        the model is right."""
        moved = self.x[: len(self.unknowns.prior.names)]
        return float(moved @ moved)

    @property
    def std(self) -> Array:
        """(k,) standard errors in the parameters' units."""
        return self.unknowns.scales(self.x) * np.sqrt(np.diag(self.covariance))


def fit(
    problem: Problem,
    unknowns: Unknowns,
    x: Array,
    *,
    rounds: int = 3,
    frozen: list[list[Array]] | None = None,
    keep_noise: bool = False,
    far: bool = False,
) -> Fit:
    """Fit one candidate.

    Args:
        problem: records and their noise as first guessed.
        unknowns, x: what may move, and its start (k,).
        rounds: of fitting and estimating the noise.
        frozen: derivatives of the baseline's unknowns, per view and signal, taken as they are:
            quick and a little off. They are computed anew in every round when None; those of the
            effects at every step.
        keep_noise: take the problem's noise as it is.
        far: from the optimum: all derivatives anew at every step, in as many as it takes.
    """
    state = _State(problem, unknowns, x, frozen)
    for number in range(rounds):
        if number:
            state.linearise()
        state.climb(_FAR_STEPS if far else _MOST_STEPS, far)
        if not keep_noise:
            state.problem = state.problem.with_noise(state.left())
        if number == rounds - 1:
            state.climb(2)
    return state.finished()


class _State:
    def __init__(
        self, problem: Problem, unknowns: Unknowns, x: Array, frozen: list[list[Array]] | None
    ) -> None:
        self.problem = problem.for_effects(unknowns.effects)
        self.unknowns, self.given = unknowns, frozen
        self.x = np.clip(x, *unknowns.bounds())
        self.predicted = self.problem.predict(unknowns.parameters(self.x))
        self.z = self._best_nuisances()
        self.linearise()

    def linearise(self) -> None:
        """Derivatives at the present place."""
        self.base = self.given
        if self.base is None:
            self.base = self.problem.derivatives(
                self.unknowns, self.x, self.predicted, range(self.unknowns.baseline)
            )
        self.slopes = self._slopes()

    def _slopes(self) -> list[list[Array]]:
        assert self.base is not None
        baseline = self.unknowns.baseline
        own = self.problem.derivatives(
            self.unknowns, self.x, self.predicted, range(baseline, len(self.x))
        )
        return [
            [np.hstack([f, e]) for f, e in zip(fs, es, strict=True)]
            for fs, es in zip(self.base, own, strict=True)
        ]

    def left(self) -> list[list[Array]]:
        nuisance = self.problem.explained_by_nuisances(self.z)
        return [
            [d - n for d, n in zip(ds, ns, strict=True)]
            for ds, ns in zip(self.problem.differences(self.predicted), nuisance, strict=True)
        ]

    def cost(self) -> float:
        """Twice the negative log posterior, without its constants."""
        white = self.problem.stack(self.left())
        return float(white @ white + self.x @ self.x + self.z @ self.z)

    def climb(self, most: int, far: bool = False) -> None:
        """Gauss-Newton steps, halved until they gain."""
        low, high = self.unknowns.bounds()
        cost = self.cost()
        fresh = True
        for _ in range(most):
            if not fresh and far:
                self.linearise()
            elif not fresh:
                self.slopes = self._slopes()
            step, z = self._step(low, high)
            gained = False
            while not gained and np.max(np.abs(step)) > _SHORTEST:
                before = self.x, self.z, self.predicted
                self.x = np.clip(self.x + step, low, high)
                self.predicted = self.problem.predict(self.unknowns.parameters(self.x))
                self.z = z
                now = self.cost()
                gained = now < cost
                if not gained:
                    self.x, self.z, self.predicted = before
                    step = 0.4 * step
            if not gained:
                self.z = self._best_nuisances()
                return
            self.z = self._best_nuisances()
            now = self.cost()
            if cost - now < 2.0 * _GAIN:
                return
            cost, fresh = now, False

    def _step(self, low: Array, high: Array) -> tuple[Array, Array]:
        k = len(self.x)
        rows = np.hstack([self.problem.stack(self.slopes), self.problem.nuisance_rows])
        residual = self.problem.stack(self.problem.differences(self.predicted))
        now = np.concatenate([self.x, np.zeros(rows.shape[1] - k)])
        normal = rows.T @ rows + np.eye(rows.shape[1])
        force = rows.T @ residual - now
        free = np.ones(len(now), dtype=bool)
        step = np.zeros(len(now))
        for _ in range(4):
            step[:] = 0.0
            step[free] = np.linalg.solve(normal[np.ix_(free, free)], force[free])
            outward = ((self.x <= low) & (step[:k] < 0.0)) | ((self.x >= high) & (step[:k] > 0.0))
            if not (outward & free[:k]).any():
                break
            free[:k] &= ~outward
        longest = float(np.max(np.abs(step[:k]), initial=0.0))
        if longest > _RADIUS:
            step *= _RADIUS / longest
        return step[:k], step[k:]

    def _best_nuisances(self) -> Array:
        rows = self.problem.nuisance_rows
        residual = self.problem.stack(self.problem.differences(self.predicted))
        normal = rows.T @ rows + np.eye(rows.shape[1])
        return np.asarray(np.linalg.solve(normal, rows.T @ residual))

    def finished(self) -> Fit:
        k = len(self.x)
        self.slopes = self._slopes()
        rows = np.hstack([self.problem.stack(self.slopes), self.problem.nuisance_rows])
        information = rows.T @ rows + np.eye(rows.shape[1])
        covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
        freedom = float(np.linalg.slogdet(information)[1])
        evidence = -0.5 * self.cost() - 0.5 * freedom - self.problem.log_scale()
        evidence += self.problem.log_prior()
        return Fit(
            self.problem, self.unknowns, self.x, self.z, covariance[:k, :k], evidence,
            self.predicted, self.slopes, self.left(),
        )

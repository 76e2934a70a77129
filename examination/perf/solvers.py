"""What the estimation's own solver saves beside scipy's on the same residual."""

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import least_squares

from examination.perf.figures import Figure, Outcome, at_least

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test"))

from planted import believed, planted_record

from sma_bench.diagnose.starts import Remainder, find_start
from sma_bench.estimation.observation import Observation, observe
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit
from sma_bench.estimation.unknowns import unknowns_of_records

EFFECTS = {"effect.residual_strain.share": 0.15}
CANDIDATES = ("residual_strain", "latent_heat", "viscoelastic_matrix")


def measure(tiny: bool = False) -> list[Outcome]:
    """Recalibration, then effects begun where it ended, as a diagnosis does."""
    with TemporaryDirectory() as folder:
        record = planted_record(Path(folder) / "bag", EFFECTS)
        observation = observe(record, believed())
    problem = Problem.of([observation]).with_nuisances(believed())
    baseline = unknowns_of_records(believed(), observation.quantities)
    fit(problem, baseline, baseline.start(), rounds=1)  # compiles
    recalibrated, seconds, runs = _timed(
        lambda: fit(problem, baseline, baseline.start(), rounds=1, keep_noise=True, far=True)
    )
    outcomes = _beside("recalibration", recalibrated, baseline.start(), seconds, runs)
    # With the noise that recalibration leaves, as a diagnosis goes on from there.
    recalibrated = fit(problem, baseline, recalibrated.x, rounds=2)
    problem, remainder = recalibrated.problem, Remainder(recalibrated)
    for name in CANDIDATES[: 1 if tiny else None]:
        unknowns = baseline.with_effects([name])
        start = find_start(remainder, unknowns, name).x
        found, seconds, runs = _timed(
            lambda unknowns=unknowns, start=start, problem=problem: fit(
                problem, unknowns, start, rounds=1, keep_noise=True,
                frozen=recalibrated.derivatives,
            )
        )
        outcomes += _beside(name, found, start, seconds, runs)
    return outcomes


def _timed(work) -> tuple[Fit, float, int]:
    """What work gives, processor seconds, simulations."""
    count = 0
    predict = Observation.predict

    def counting(self, benches):
        nonlocal count
        before = count
        found = predict(self, benches)
        count = before + len(benches)  # not those of its own halves besides
        return found

    Observation.predict = counting
    try:
        begin = time.process_time()
        return work(), time.process_time() - begin, count
    finally:
        Observation.predict = predict


def _beside(
    case: str, ours: Fit, start: np.ndarray, seconds: float, runs: int
) -> list[Outcome]:
    (theirs, cost), its_seconds, its_runs = _timed(lambda: _scipy(ours, start))
    own = _cost(ours.problem, ours.unknowns, ours.x)[0]
    assert np.all(np.isfinite(theirs))
    return [
        Figure(case, "ours: simulations", runs, ""),
        Figure(case, "least_squares: simulations", its_runs, ""),
        Figure(case, "least_squares: times slower", its_seconds / seconds, "x", at_least(1.0)),
        Figure(case, "least_squares: finds better by, nats", 0.5 * (own - cost), ""),
    ]


def _scipy(ours: Fit, start: np.ndarray) -> tuple[np.ndarray, float]:
    """The same posterior with the nuisances eliminated, every derivative anew at every step."""
    problem, unknowns = ours.problem, ours.unknowns
    low, high = unknowns.bounds()
    inside = np.clip(start, low + 1e-9, high - 1e-9)

    def residual(x: np.ndarray) -> np.ndarray:
        return _cost(problem, unknowns, x)[1]

    def jacobian(x: np.ndarray) -> np.ndarray:
        predicted = problem.predict(unknowns.parameters(x))
        rows = problem.whiten(problem.derivatives(unknowns, x, predicted, range(len(x))))
        z = _eliminated(problem, rows)
        return np.vstack([problem.white_nuisances @ z - rows, -z, np.eye(len(x))])

    found = least_squares(residual, inside, jacobian, (low, high), ftol=1e-4, xtol=1e-4)
    return found.x, 2.0 * found.cost


def _eliminated(problem: Problem, rows: np.ndarray) -> np.ndarray:
    nuisances = problem.white_nuisances
    normal = nuisances.T @ nuisances + np.eye(nuisances.shape[1])
    return np.linalg.solve(normal, nuisances.T @ rows)


def _cost(problem: Problem, unknowns, x: np.ndarray) -> tuple[float, np.ndarray]:
    white = problem.whiten(problem.measured - problem.predict(unknowns.parameters(x)))
    z = _eliminated(problem, white)
    rows = np.concatenate([white - problem.white_nuisances @ z, z, x])
    return float(rows @ rows), rows

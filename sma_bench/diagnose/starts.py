"""Where the fit of an effect begins: sizes tried against what recalibration leaves.

A score test at zero is blind to effects whose number acts only together with another (a time
constant of a relaxation that is not there yet), so whole differences are tried, not slopes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sma_bench.estimation.solver import Fit
from sma_bench.estimation.unknowns import Unknowns, default_of, number_of_effect
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

# Prior deviations of the number that switches an effect on: what a large one does says little
# about a small one.
_SIZES = (0.012, 0.06, 0.3, 1.5)
_STRETCH = (0.3, 2.0)  # of a tried size that is still believed
# Numbers that shape an effect are tried over their range; the others start at their default.
_SHAPES = {
    "effect.matrix_thermal_mass.inner_share": (0.25, 0.5, 0.8),
    "effect.viscoelastic_matrix.time_constant": (4.0, 20.0, 90.0),
    "effect.transition_drift.cycles": (1.0, 6.0),
    "effect.opposing_wires.detwinning_stress": (20e6, 100e6, 400e6),
}


@dataclass(frozen=True)
class Start:
    """Where to begin, and the gain in log posterior that a straight line from there promises."""

    x: Array
    gain: float


class Remainder:
    """What recalibration leaves, with all directions that recalibration can still go taken out."""

    def __init__(self, fitted: Fit) -> None:
        self.fitted = fitted
        problem = fitted.problem
        self._rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
        self._normal = self._rows.T @ self._rows + np.eye(self._rows.shape[1])
        residual = problem.whiten(problem.measured - fitted.predicted)
        # The priors pull back what they had to let go: an effect may relieve them of it.
        moved = np.concatenate([fitted.x, np.zeros(self._rows.shape[1] - len(fitted.x))])
        self._left = residual - self._explained(self._rows.T @ residual - moved)
        self._before = problem.coarse.predict(fitted.parameters)

    def _explained(self, pull: Array) -> Array:
        return np.asarray(self._rows @ np.linalg.solve(self._normal, pull))

    def changes(self, benches: Sequence[Parameters]) -> Array:
        """(n, p) whitened, of the readings from the fit's to these benches'."""
        problem = self.fitted.problem
        return problem.whiten(problem.coarse.predict_many(benches) - self._before[:, np.newaxis])

    def gain(self, change: Array) -> tuple[float, float]:
        """Gain of adding a multiple of `change` (n,) whitened, and that multiple."""
        power = float(change @ (change - self._explained(self._rows.T @ change)))
        if power <= 0.0:
            return 0.0, 1.0
        pull = float(change @ self._left)
        share = float(np.clip(pull / power, *_STRETCH))
        return share * pull - 0.5 * share**2 * power, share


def find_start(
    remainder: Remainder, unknowns: Unknowns, name: str, quick: bool = False
) -> Start:
    """Best of the tried sizes of one effect, added to a fit.

    Args:
        remainder: of the fit without this effect; unknowns: with this effect's numbers last.
        quick: every shape at its default.

    Where no size promises anything the fit begins with the effect off.
    """
    fitted = remainder.fitted
    effect = EFFECTS[name]
    low, high = unknowns.bounds()
    first = len(unknowns.names) - len(effect.parameters)
    trials = []
    for offset in _offsets(name, quick):
        x = np.concatenate([fitted.x, offset])
        trials.append(np.clip(x, low, high))

    best = Start(start_off(fitted, unknowns, name), 0.0)
    switches = [first + k for k, p in enumerate(effect.parameters) if p in effect.switches]
    changes = remainder.changes([unknowns.parameters(x) for x in trials])
    for x, change in zip(trials, np.ascontiguousarray(changes.T), strict=True):
        gain, share = remainder.gain(change)
        if gain > best.gain:
            there = x.copy()
            there[switches] *= share
            best = Start(np.clip(there, low, high), gain)
    return best


def start_off(fitted: Fit, unknowns: Unknowns, name: str) -> Array:
    """Where a fit without this effect ended, the effect added but off."""
    effect = EFFECTS[name]
    offset = np.zeros(len(effect.parameters))
    return np.clip(np.concatenate([fitted.x, offset]), *unknowns.bounds())


def _offsets(name: str, quick: bool) -> list[Array]:
    """Trial values of an effect's numbers: one switch at a time, every shape."""
    effect = EFFECTS[name]
    known = {} if quick else _SHAPES
    shapes = [
        [number_of_effect(p).x_of(value) for value in known.get(p.name, (default_of(p),))]
        if p not in effect.switches else [0.0]
        for p in effect.parameters
    ]
    trials = []
    for k, number in enumerate(effect.parameters):
        if number not in effect.switches:
            continue
        signs = (1.0, -1.0) if number.low is not None and number.low < 0.0 else (1.0,)
        for shape, size, sign in product(product(*shapes), _SIZES, signs):
            offset = np.array(shape)
            offset[k] = sign * size
            trials.append(offset)
    return trials

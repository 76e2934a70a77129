"""Simulated readings of all records, their derivatives, and the residual they leave."""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.noise import Noise, estimate_noise, first_guess
from sma_bench.diagnose.unknowns import Unknowns
from sma_bench.diagnose.view import View
from sma_bench.parameters import Parameters
from sma_bench.physics.simulate import Simulation

Array = NDArray[np.float64]
T = TypeVar("T")

_STEP = 0.02  # prior deviations, of a derivative
_THREADS = 2
_WORKER = threading.local()
# Its numbers are the straight part of a wander whose rest is the sensor's noise.
DRIFT_EFFECT = "deflection_drift"


@dataclass(frozen=True, eq=False)
class Problem:
    """Records, the noise of their sensors, and what else may be off in each record.

    Rows are all bins of all signals of all records, whitened. Besides the unknowns there are
    nuisances z, linear, of unit prior: sensors' zeros, delays of clocks, moments of jumps, levels
    held between two steps of a converter.

    Attributes:
        views: the records; noise: one per signal name.
        nuisances: per view and signal (b, q), unwhitened, of this view's own q nuisances.
    """

    views: tuple[View, ...]
    noise: dict[str, Noise]
    nuisances: tuple[tuple[Array, ...], ...]

    @classmethod
    def of(cls, views: Sequence[View]) -> Self:
        """Noise as yet unknown, nuisances none."""
        noise = {
            s.name: first_guess(s.noise, s.period, s.usual_drift)
            for view in views for s in view.signals
        }
        none = tuple(tuple(np.zeros((len(s.time), 0)) for s in v.signals) for v in views)
        return cls(tuple(views), noise, none)

    def with_nuisances(self, parameters: Parameters) -> Self:
        """Nuisances about the model at these parameters."""
        return replace(self, nuisances=tuple(_nuisances(v, parameters) for v in self.views))

    def with_noise(self, residuals: Sequence[Sequence[Array]]) -> Self:
        """Noise estimated anew from residuals, per view and signal."""
        found: dict[str, Noise] = {}
        for name in self.noise:
            own = [
                (r, s)
                for view, left in zip(self.views, residuals, strict=True)
                for s, r in zip(view.signals, left, strict=True)
                if s.name == name
            ]
            white = float(np.median([s.noise for _, s in own]))
            found[name] = estimate_noise(
                [r for r, _ in own], white, own[0][1].period, own[0][1].usual_drift,
                self.noise[name].wanders,
            )
        return replace(self, noise=found)

    def for_effects(self, effects: Sequence[str]) -> Self:
        """The same, the deflection's zero wandering if that is one of the effects."""
        wanders = DRIFT_EFFECT in effects
        return replace(
            self,
            noise={
                name: replace(noise, wanders=wanders and name == "deflection")
                for name, noise in self.noise.items()
            },
        )

    def predict(self, parameters: Parameters) -> list[list[Array]]:
        """Readings, per view and signal (b,)."""
        return [view.readings(view.simulate(parameters)) for view in self.views]

    def differences(self, predicted: Sequence[Sequence[Array]]) -> list[list[Array]]:
        """Measured minus simulated, per view and signal (b,)."""
        return [
            [s.value - p for s, p in zip(view.signals, own, strict=True)]
            for view, own in zip(self.views, predicted, strict=True)
        ]

    def derivatives(
        self, unknowns: Unknowns, x: Array, predicted: Sequence[Sequence[Array]],
        which: Sequence[int] | None = None,
    ) -> list[list[Array]]:
        """d(readings)/dx, per view and signal (b, k) of the `which` unknowns (all when None)."""
        low, high = unknowns.bounds()
        chosen = range(len(x)) if which is None else which
        steps = [_STEP if x[i] + _STEP <= high[i] else -_STEP for i in chosen]

        def moved(i: int, step: float) -> list[list[Array]]:
            there = x.copy()
            there[i] = np.clip(x[i] + step, low[i], high[i])
            return self.predict(unknowns.parameters(there))

        columns = in_threads(moved, list(zip(chosen, steps, strict=True)))
        return [
            [
                np.column_stack(
                    [(c[v][s] - base) / step for c, step in zip(columns, steps, strict=True)]
                ) if columns else np.zeros((len(base), 0))
                for s, base in enumerate(own)
            ]
            for v, own in enumerate(predicted)
        ]

    def stack(self, parts: Sequence[Sequence[Array]]) -> Array:
        """Whitened rows (n,) or (n, k) of everything."""
        return np.concatenate(
            [
                self.noise[s.name].whiten(part)
                for view, own in zip(self.views, parts, strict=True)
                for s, part in zip(view.signals, own, strict=True)
            ]
        )

    @cached_property
    def nuisance_rows(self) -> Array:
        """(n, q) whitened, block diagonal in the records."""
        blocks = [
            np.concatenate(
                [self.noise[s.name].whiten(c) for s, c in zip(v.signals, own, strict=True)]
            )
            for v, own in zip(self.views, self.nuisances, strict=True)
        ]
        rows, columns = (sum(b.shape[axis] for b in blocks) for axis in (0, 1))
        whole = np.zeros((rows, columns))
        row = column = 0
        for block in blocks:
            whole[row : row + block.shape[0], column : column + block.shape[1]] = block
            row, column = row + block.shape[0], column + block.shape[1]
        return whole

    def explained_by_nuisances(self, z: Array) -> list[list[Array]]:
        """What nuisances `z` (q,) of all records add to the readings, per view and signal."""
        parts, start = [], 0
        for own in self.nuisances:
            count = own[0].shape[1]
            parts.append([columns @ z[start : start + count] for columns in own])
            start += count
        return parts

    def log_scale(self) -> float:
        """Sum over all rows of the log of what whitening divided by."""
        return sum(
            self.noise[s.name].log_scale(len(s.time)) for v in self.views for s in v.signals
        )

    def log_prior(self) -> float:
        """Log of how probable such noise is of these sensors."""
        return sum(noise.log_prior for noise in self.noise.values())


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results in the order of the arguments; the core lets go of the interpreter's lock.

    What such a call calls in its turn runs in the one thread that it has.
    """
    if getattr(_WORKER, "busy", False):
        return [function(*args) for args in arguments]

    def work(args: tuple[Any, ...]) -> T:
        _WORKER.busy = True
        return function(*args)

    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(work, arguments))


def _nuisances(view: View, parameters: Parameters) -> tuple[Array, ...]:
    simulation = view.simulate(parameters)
    base = view.readings(simulation)
    moved = in_threads(
        lambda voltage: view.readings(view.simulate(parameters, voltage)),
        [(v,) for v in (*view.jumps, *view.levels)],
    )
    columns: list[list[Array]] = []
    for k, signal in enumerate(view.signals):
        zero = [np.zeros_like(b) for b in base]
        zero[k] = np.full_like(base[k], signal.zero_std)
        columns.append(zero)
    columns += _delays(view, simulation, base)
    columns += [[m - b for m, b in zip(one, base, strict=True)] for one in moved]
    return tuple(np.column_stack([c[k] for c in columns]) for k in range(len(base)))


def _delays(view: View, simulation: Simulation, base: Sequence[Array]) -> list[list[Array]]:
    rates = view.rates(simulation)
    columns = []
    for quantity in view.quantities:
        late = [
            -s.clock_std * rate if s.quantity == quantity else np.zeros_like(b)
            for s, rate, b in zip(view.signals, rates, base, strict=True)
        ]
        if any(part.any() for part in late):
            columns.append(late)
    return columns

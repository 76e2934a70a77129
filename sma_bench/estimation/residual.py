"""One flat residual of all records, with an index of its rows, and its derivatives.

    y = O[ F(V(z); theta) ] + N z + e

A row is a bin of a signal of a record. Whitened, rows are independent of unit variance."""

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads, threads_to_spare
from sma_bench.errors import FitError, InputError
from sma_bench.estimation.noise_model import Noise, estimate_noise, first_guess, whiten
from sma_bench.estimation.nuisances import (
    NONLINEAR,
    STATE,
    STEP,
    TICK,
    Nuisances,
    linearised,
    moved_to,
)
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.unknowns import Unknowns
from sma_bench.parameters import Parameters

# Misfits as shares of a stroke, and how many independent readings they or a record count for.
_FIRST_MISFIT, _FIRST_COUNT = 0.03, 10.0  # before the first fit
USUAL_MISFIT, USUAL_WEIGHT = 0.015, 2.0  # the prior of a misfit
_DIFFER = 0.02  # of a stroke, between two runs of a bench
_LEAST_COUNT, _MOST_MISFIT, _NOTHING = 8.0, 0.06, 1e-300
# Its numbers are the straight part of a wandering zero; the rest is noise of the sensor.
DRIFT_EFFECT = "deflection_drift"


class Block(NamedTuple):
    """The rows of one signal of one record."""

    observation: Observation
    signal: BinnedSignal
    rows: slice


@dataclass(frozen=True, eq=False)
class Problem:
    """Records, the noise of their sensors, and the nuisances of each record."""

    observations: tuple[Observation, ...]
    noise: dict[str, Noise]  # by signal name
    nuisances: tuple[Nuisances, ...]  # one per record
    # Fit errors of straight voltage stretches along (two simulations each), and take derivatives
    # on the records' own cells: for estimates whose errors matter
    voltage_noise: bool = False
    # cache of what does not depend on the noise, for problems that differ in it only
    shared: dict[tuple[Nuisances, ...], Array] = field(default_factory=dict)
    weights: tuple[Noise, ...] = ()  # one per block instead of its sensor's: the misfit of a model
    states: float = 0.0  # size of the runs' states, in times the usual; 0: all runs are alike
    later: float = 0.0  # the same if only runs after the first may differ from the parameters

    @classmethod
    def of(cls, observations: Sequence[Observation], voltage_noise: bool = False,
           later: float = 0.0) -> Self:
        """With a first guess of the noise and without nuisances."""
        noise = {s.name: first_guess(s.noise, s.period, s.usual_drift)
                 for observation in observations for s in observation.signals}
        none = tuple(Nuisances((), np.zeros((sum(len(s.time) for s in o.signals), 0)))
                     for o in observations)
        return cls(tuple(observations), noise, none, voltage_noise, later=later)

    def with_nuisances(self, parameters: Parameters, states: float = 0.0) -> Self:
        """With nuisances linearised at these parameters, about where they were `moved` to."""
        asked = [(o, parameters, self.voltage_noise, states or (self.later if k else 0.0))
                 for k, o in enumerate(self.observations)]
        pairs = zip(in_threads(linearised, asked), self.nuisances, strict=True)
        found = tuple(replace(new, about=own.about) if len(new.items) == len(own.items) else new
                      for new, own in pairs)
        return replace(self, nuisances=found, states=states, shared={})

    def of_kind(self, kind: str) -> NDArray[np.bool_]:
        """(q,) True for nuisances of this kind."""
        return np.array([item.kind == kind for own in self.nuisances for item in own.items], bool)

    def about(self, parameters: Parameters, z: Array) -> Self:
        """`moved`: the states of runs, or all kinds if a slow logger's jumps are among them."""
        return self.moved(parameters, z, NONLINEAR if self.of_kind(TICK).any() else (STATE,))

    def moved(self, parameters: Parameters, z: Array, kinds: Collection[str] = NONLINEAR) -> Self:
        """Nuisances of these kinds moved to where a fit found them (q,); all linearised there."""
        observations, nuisances = [], list[Nuisances]()
        ends = np.cumsum([len(own.items) for own in self.nuisances])[:-1]
        for observation, own, here in zip(self.observations, self.nuisances, np.split(z, ends),
                                          strict=True):
            differs = self.later if nuisances else 0.0
            there, about = moved_to(observation, own, here, kinds, differs)
            found = linearised(there, parameters, self.voltage_noise, differs)
            observations.append(there)
            nuisances.append(replace(found, about=about))
        return replace(self, observations=tuple(observations), nuisances=tuple(nuisances),
                       shared={})

    def with_noise(self, residual: Array) -> Self:
        """Noise estimated anew from a residual (n,)."""
        found = {}
        for name, before in self.noise.items():
            own = list(self.of_signal(name))
            white, usual = np.median([b.signal.noise for b in own]), own[0].signal.usual_drift
            found[name] = estimate_noise([residual[b.rows] for b in own], float(white),
                                         before.period, usual, before.wanders)
        return replace(self, noise=found)

    def with_weights(self, residual: Array | None = None, repeated: bool = False) -> Self:
        """With weights by the misfit of an imperfect model, whose residual (n,) this is.

        A misfit is not noise: of n bins whose residuals have the correlation rho from one to the
        next, n (1 - rho)/(1 + rho) are independent, and each bin counts for less accordingly. The
        size of the misfit is that of the residual, averaged with a prior that counts as two
        readings: laws of wires leave 1.5 % of a stroke, and runs differ by 2 % unless each has its
        own state. Before the first fit: 3 %, ten readings a record. At most 6 %: where more is left
        the fit has not arrived, and a smaller weight would keep it there. `repeated`: every stroke
        shows the misfit again, so all strokes count as one for it; for errors only."""
        found, rho = [], [] if residual is None else self.correlations(residual)
        for number, block in enumerate(self.blocks):
            signal, bins = block.signal, len(block.signal.time)
            reach = max(float(np.ptp(signal.value)), signal.noise)
            size, count = _FIRST_MISFIT * reach, _FIRST_COUNT
            if residual is not None:
                power = float(np.mean(residual[block.rows] ** 2))
                if not repeated:
                    power = min(power, (_MOST_MISFIT * reach) ** 2)
                count = bins * (1.0 - rho[number]) / (1.0 + rho[number])
                count = min(max(count, _LEAST_COUNT), bins)
                differ = 0.0 if self.states else _DIFFER
                usual = USUAL_WEIGHT * (USUAL_MISFIT**2 + differ**2) * reach**2
                size = np.sqrt((usual + count * power) / (USUAL_WEIGHT + count))
            level = max(size, signal.noise) * np.sqrt(max(bins / count, 1.0))
            if repeated:
                excess = max(size**2 - signal.noise**2, 0.0) * max(bins / count, 1.0)
                strokes = max(block.observation.strokes, 1)
                level = max(level, np.sqrt(signal.noise**2 + strokes * excess))
            found.append(Noise(float(level), 0.0, 1.0, signal.period))
        return replace(self, weights=tuple(found))

    def correlations(self, residual: Array) -> list[float]:
        """Correlation of a residual (n,) from one bin to the next, for each block, 0 to 1. What is
        below a sensor's noise is no misfit, however smooth it is."""
        found = []
        for block in self.blocks:
            own = residual[block.rows]
            power = max(float(own @ own), len(own) * block.signal.noise**2, _NOTHING)
            found.append(max(float(own[1:] @ own[:-1]) / power, 0.0))
        return found

    def in_states(self, z: Array, errors: Array) -> list[Observation]:
        """The records with the states of their runs at z (q,) and their standard `errors` (q,)."""
        items = [(k, item) for k, own in enumerate(self.nuisances) for item in own.items]
        away, within = ([dict[str, float]() for _ in self.observations] for _ in range(2))
        sizes = (self.states or self.later) * np.column_stack([z, errors])
        for (k, item), (at, error) in zip(items, sizes.tolist(), strict=True):
            if item.kind == STATE:
                away[k][item.subject], within[k][item.subject] = at, error
        return [replace(one, away=far, within=near)
                for one, far, near in zip(self.observations, away, within, strict=True)]

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """The index of the rows: records in order, signals in order."""
        pairs = [(o, signal) for o in self.observations for signal in o.signals]
        ends = np.cumsum([0, *(len(signal.time) for _, signal in pairs)]).tolist()
        rows = itertools.starmap(slice, itertools.pairwise(ends))
        return tuple(Block(*pair, own) for pair, own in zip(pairs, rows, strict=True))

    def of_signal(self, name: str) -> Iterator[Block]:
        return (block for block in self.blocks if block.signal.name == name)

    def stretches(self, parts: int) -> Iterator[NDArray[np.intp]]:
        """Rows of all signals in each of the equally long parts of every record."""
        for observation in self.observations:
            borders = np.linspace(observation.grid[0], observation.grid[-1], parts + 1)[1:-1]
            own = [(b.rows.start, np.searchsorted(borders, b.signal.time)) for b in self.blocks
                   if b.observation is observation]
            for number in range(parts):
                found = np.concatenate([start + np.flatnonzero(p == number) for start, p in own])
                if len(found):
                    yield found

    @cached_property
    def measured(self) -> Array:
        """(n,) values, shifted as if the nuisances had been linearised about 0."""
        about = np.concatenate([own.about + np.zeros(len(own.items)) for own in self.nuisances])
        values = np.concatenate([block.signal.value for block in self.blocks])
        return values + self.nuisance_rows @ about if about.any() else values

    def predict(self, parameters: Parameters) -> Array:
        """(n,) readings; raises as `predict_many`."""
        return self.predict_many([parameters])[:, 0]

    def predict_many(self, benches: Sequence[Parameters]) -> Array:
        """(n, p) readings of p benches. Raises FitError: invalid parameters."""
        parts = max(1, min(threads_to_spare(), len(benches) // 2))
        ends = np.linspace(0, len(benches), parts + 1).astype(int).tolist()

        def predicted(start: int, stop: int) -> Array:
            return np.vstack([one.predict(benches[start:stop]) for one in self.observations])

        try:
            return np.hstack(in_threads(predicted, list(itertools.pairwise(ends))))
        except InputError as error:
            raise FitError(f"within a fit: {error}") from error

    def derivatives(self, unknowns: Unknowns, x: Array, predicted: Array, which: Sequence[int],
                    rough: bool = False) -> Array:
        """d(readings)/dx (n, k) of the `which` unknowns, where the readings are `predicted`.
        `rough`: on cells of a whole bin, good enough for a direction only.

        The steps are small, because across a narrow valley large ones pretend information (with
        0.02 prior deviations a supply's resistance seemed known six times as well as it was).
        Cells of a quarter of a bin change the evidence by 0.01 nats, half a bin by up to 0.9."""
        if not len(which):
            return np.empty((len(predicted), 0))
        seen, here = self.rough if rough else self.coarse, unknowns.parameters(x)
        steps = np.where(x + STEP <= unknowns.bounds()[1], STEP, -STEP)[[*which]]
        benches = [unknowns.nudged(here, x, i, step)
                   for i, step in zip(which, steps.tolist(), strict=True)]
        cells, of_seen = (sum(len(o.grid) for o in one.observations) for one in (self, seen))
        if len(which) * cells <= (len(which) + 1) * of_seen:  # on which readings at x are known
            return (self.predict_many(benches) - predicted[:, np.newaxis]) / steps
        readings = seen.predict_many([here, *benches])
        return (readings[:, 1:] - readings[:, :1]) / steps

    @cached_property
    def coarse(self) -> "Problem":
        """The same rows from simulations on coarse cells, to take differences of."""
        if self.voltage_noise:
            return self
        seen = tuple(o.coarse for o in self.observations)
        return self if seen == self.observations else replace(self, observations=seen)

    @cached_property
    def rough(self) -> "Problem":
        """The same rows from simulations on cells of a bin."""
        return replace(self, observations=tuple(o.rough for o in self.observations))

    def whiten(self, rows: Array) -> Array:
        """Rows (n,) or (n, k), made independent with unit variance."""
        return whiten(rows, [len(block.signal.time) for block in self.blocks], self.noises)

    @property
    def noises(self) -> tuple[Noise, ...]:
        """Noise of each block: its weight if there is one, else its sensor's."""
        return self.weights or tuple(self.noise[block.signal.name] for block in self.blocks)

    @property
    def nuisance_rows(self) -> Array:
        """(n, q), block diagonal in the records."""
        if self.nuisances not in self.shared:
            self.shared[self.nuisances] = block_diag(*(own.columns for own in self.nuisances))
        return self.shared[self.nuisances]

    @cached_property
    def white_nuisances(self) -> Array:
        return self.whiten(self.nuisance_rows)

    @cached_property
    def nuisance_information(self) -> Array:
        """(q, q) of the nuisances alone with their priors, block diagonal in the records."""
        rows, first, known = self.white_nuisances, np.zeros(2, dtype=int), []
        for own in self.nuisances:
            last = first + own.columns.shape
            part = rows[first[0] : last[0], first[1] : last[1]]
            known.append(part.T @ part + np.eye(part.shape[1]))
            first = last
        return np.asarray(block_diag(*known))

    @cached_property
    def nuisance_factor(self) -> tuple[Array, bool]:
        return cho_factor(self.nuisance_information)

    def log_scale(self) -> float:
        """Sum over all rows of the log of what whitening divided by."""
        pairs = zip(self.blocks, self.noises, strict=True)
        return sum(noise.log_scale(len(block.signal.time)) for block, noise in pairs)

    def log_prior(self) -> float:
        """Log prior of the noise of all sensors."""
        return sum(noise.log_prior for noise in self.noise.values())

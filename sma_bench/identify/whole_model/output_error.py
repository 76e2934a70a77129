"""Output-error fit of the whole model: most likely parameters under priors and coloured noise.

Minimised is |whitened (measured - simulated)|^2 + |(theta - prior)/std|^2 over the parameters,
the sensors' zeros, and the moments of voltage jumps between two samples.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from sma_bench.identify.colour import Colour
from sma_bench.identify.estimate import Array
from sma_bench.identify.whole_model.bounded_newton import minimise
from sma_bench.identify.whole_model.prior import Prior, prior_of
from sma_bench.identify.whole_model.record_noise import RecordNoise
from sma_bench.identify.whole_model.rig_record import InputErrors, Measured, RigRecord
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, part, silent

_STEP = 1e-3
_PLACE_STD = 1.0 / np.sqrt(12.0)
_TOLERANCE, _LAST_TOLERANCE = 1.0, 1e-2  # of chi-square
_PASSES = 3
_INPUT_DRAWS = 80
_CONFLICT = 3.5
_RELEASE = 10.0
_USUAL_STEPS = 4  # of a pass; tells only how far the fit is
_FIRST_FIT = 0.7  # of the work, where a prior that the data contradict makes a second one due
# Temperatures know R h A_c and m c_p/(h A_c) only: some relative derivatives are sums of others.
_SUMS = {
    "wire.resistance": ("wire.heat_transfer_coefficient", "wire.specific_heat"),
    "wire.mass": ("wire.specific_heat",),
    "wire.surface_area": ("wire.heat_transfer_coefficient",),
}


@dataclass(frozen=True)
class SignalFit:
    """One measured signal beside the model.

    `model` (m,) in its unit; `residual` (m,) what the model and possible errors of the voltage
    leave of it, `white` (m,) whitened; `floor` its noise from sample to sample.
    """

    path: str
    measured: Measured
    model: Array
    residual: Array
    white: Array
    floor: float
    colour: Colour


@dataclass(frozen=True)
class BenchFit:
    """Most likely parameters with their covariance.

    `x` (k,) and `covariance` (k, k) of the unknowns (Prior); `released` names whose prior the data
     contradict and which was therefore widened; `delays` (path, quantity, s, its error) of the
    stamps behind the voltage's; `n` samples.
    """

    prior: Prior
    stated: Prior
    x: Array
    covariance: Array
    signals: tuple[SignalFit, ...]
    released: tuple[str, ...]
    delays: tuple[tuple[str, str, float, float], ...]
    n: int

    @property
    def values(self) -> Array:
        """(k,) parameters in their units."""
        return self.prior.values(self.x)

    @property
    def std(self) -> Array:
        """(k,) standard errors in their units."""
        return self.prior.slopes(self.x) * np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """(k, k) correlations of the parameters' errors."""
        sigma = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(sigma, sigma)


def fit_bench(
    rigs: Sequence[RigRecord], parameters: Parameters, names: Iterable[str],
    report: Report = silent,
) -> BenchFit:
    """Fit `names` jointly to all records; `report` is told how far it is.

    The noise of each signal is first taken as white, then estimated from what the fit leaves and
    removed (autoregression), then once more. A prior that the data contradict is widened.
    """
    stated = prior_of(parameters, names)
    problem = _Problem(rigs, stated)
    x = problem.fit(report=part(report, 0.0, _FIRST_FIT))
    k = len(stated.names)
    conflicting = np.abs(stated.deviations(x[:k])) > _CONFLICT
    if conflicting.any():
        problem.prior = stated.widened(conflicting, _RELEASE)
        x[:k] = problem.prior.x_of(stated.values(x[:k]))
        x = problem.fit(x, part(report, _FIRST_FIT, 1.0))
    covariance = problem.covariance(x)
    released = tuple(n for n, bad in zip(stated.names, conflicting, strict=True) if bad)
    n = sum(len(m.time) for rig in rigs for m in rig.measured)
    return BenchFit(
        problem.prior, stated, x[:k], covariance[:k, :k], tuple(problem.signals(x)), released,
        tuple(problem.delays(x, covariance)), n,
    )


@dataclass(frozen=True)
class _Own:
    """Where a record's own unknowns lie: zeros, delays, places of jumps; in prior deviations."""

    start: int
    zeros: tuple[float, ...]
    delays: dict[str, float]
    jumps: int

    @property
    def first_delay(self) -> int:
        return self.start + len(self.zeros)

    @property
    def first_jump(self) -> int:
        return self.first_delay + len(self.delays)

    @property
    def stop(self) -> int:
        return self.first_jump + self.jumps

    def split(self, x: Array) -> tuple[Array, dict[str, float], Array]:
        delays = {
            quantity: float(x[self.first_delay + i]) * std
            for i, (quantity, std) in enumerate(self.delays.items())
        }
        return x[self.start : self.first_delay], delays, x[self.first_jump : self.stop]


class _Problem:
    """Unknowns x: the parameters in prior deviations, then each record's own."""

    def __init__(self, rigs: Sequence[RigRecord], prior: Prior) -> None:
        self.rigs = rigs
        self.prior = prior
        self._own: list[_Own] = []
        self._size = len(prior.names)
        for rig in rigs:
            zeros = tuple(m.offset_std for m in rig.measured if m.offset_std)
            own = _Own(self._size, zeros, rig.delayed, len(rig.voltage.early))
            self._own.append(own)
            self._size = own.stop
        self._std = np.ones(self._size)
        for own in self._own:
            self._std[own.first_jump : own.stop] = _PLACE_STD
        self._noise = [RecordNoise(rig) for rig in rigs]

    def fit(self, x: Array | None = None, report: Report = silent) -> Array:
        x = np.zeros(self._size) if x is None else x
        for pass_number in range(_PASSES):
            if pass_number == 1:
                self._add_input_errors(x)
            if pass_number:
                for index, noise in enumerate(self._noise):
                    noise.estimate(self._differences(index, x))
            tolerance = _LAST_TOLERANCE if pass_number == _PASSES - 1 else _TOLERANCE
            name = f"pass {pass_number + 1} of {_PASSES}"
            told = part(report, pass_number / _PASSES, (pass_number + 1) / _PASSES, name)
            x = minimise(
                self.residuals, _telling(self.jacobian, told), x, self._bounds(), tolerance
            )
        return x

    def residuals(self, x: Array) -> Array:
        rows = [n.rows(self._differences(index, x)) for index, n in enumerate(self._noise)]
        return np.concatenate([*rows, self._prior_rows(x)])

    def jacobian(self, x: Array) -> Array:
        rows = [n.rows(self._derivatives(index, x)) for index, n in enumerate(self._noise)]
        k = len(self.prior.names)
        slope = 1.0 / self._std
        slope[:k] = self.prior.slopes(x[:k]) / self.prior.std
        return np.vstack([*rows, np.diag(slope)])

    def _prior_rows(self, x: Array) -> Array:
        k = len(self.prior.names)
        return np.concatenate([self.prior.deviations(x[:k]), x[k:] / self._std[k:]])

    def covariance(self, x: Array) -> Array:
        """(size, size), the errors of the voltages counted."""
        jacobian = self.jacobian(x)
        return np.asarray(np.linalg.inv(jacobian.T @ jacobian))

    def signals(self, x: Array) -> list[SignalFit]:
        """Every signal beside the model."""
        found = []
        for index, (rig, noise) in enumerate(zip(self.rigs, self._noise, strict=True)):
            models = self._models(index, x)
            differences = self._differences(index, x)
            explained = noise.explained_by_input(differences)
            for k, m in enumerate(rig.measured):
                left = explained[k] - differences[k]
                found.append(
                    SignalFit(
                        str(rig.record.path), m, models[k], left, noise.whiten(k, left),
                        noise.floor[k], noise.colour[k],
                    )
                )
        return found

    def delays(self, x: Array, covariance: Array) -> list[tuple[str, str, float, float]]:
        """(path, quantity, delay, standard error) in s."""
        return [
            (
                str(rig.record.path), quantity, float(x[own.first_delay + i]) * std,
                float(np.sqrt(covariance[own.first_delay + i, own.first_delay + i])) * std,
            )
            for rig, own in zip(self.rigs, self._own, strict=True)
            for i, (quantity, std) in enumerate(own.delays.items())
        ]

    def _bounds(self) -> tuple[Array, Array]:
        low, high = np.full(self._size, -np.inf), np.full(self._size, np.inf)
        low[: len(self.prior.names)], high[: len(self.prior.names)] = self.prior.bounds()
        for own in self._own:
            low[own.first_jump : own.stop], high[own.first_jump : own.stop] = -0.5, 0.5
        return low, high

    def _models(
        self, index: int, x: Array, errors: InputErrors | None = None
    ) -> list[Array]:
        zeros, delays, place = self._own[index].split(x)
        rig = self.rigs[index]
        models = rig.predict(
            self.prior.parameters(x[: len(self.prior.names)]), place, delays, errors
        )
        shifts = iter(zeros)
        return [
            model + (next(shifts) * m.offset_std if m.offset_std else 0.0)
            for m, model in zip(rig.measured, models, strict=True)
        ]

    def _derivatives(self, index: int, x: Array) -> list[Array]:
        """(m, size) derivative of each signal's model, by differences where it must be."""
        rig, own = self.rigs[index], self._own[index]
        here = self._models(index, x)
        blocks = [np.zeros((len(m.time), self._size)) for m in rig.measured]
        parameters = [c for c in range(len(self.prior.names)) if not self._sources(rig, c)]
        for column in [*parameters, *range(own.first_delay, own.stop)]:
            step = _STEP if x[column] < 0.4 else -_STEP  # away from the bound of a jump's place
            nudged = x.copy()
            nudged[column] += step
            for block, before, after in zip(blocks, here, self._models(index, nudged), strict=True):
                block[:, column] = (after - before) / step
        self._add_sums(rig, x, blocks)
        self._add_sensors(index, x, here, blocks)
        return blocks

    def _relative(self, x: Array) -> Array:
        own = x[: len(self.prior.names)]
        return self.prior.slopes(own) / self.prior.values(own)

    def _add_sensors(
        self, index: int, x: Array, here: list[Array], blocks: list[Array]
    ) -> None:
        own = self._own[index]
        zero = own.start
        for m, model, block in zip(self.rigs[index].measured, here, blocks, strict=True):
            if m.offset_std:
                block[:, zero] = m.offset_std
                zero += 1
            if m.quantity == "current" and "wire.resistance" in self.prior.names:
                column = self.prior.names.index("wire.resistance")
                block[:, column] = -model * self._relative(x)[column]

    def _sources(self, rig: RigRecord, column: int) -> tuple[int, ...]:
        """Columns whose relative derivatives sum up to this one's, if there are such."""
        names = self.prior.names
        others = _SUMS.get(names[column], ())
        # The load frame knows the wire's length from its mass.
        if (rig.holds and names[column] == "wire.mass") or any(o not in names for o in others):
            return ()
        return tuple(names.index(other) for other in others)

    def _add_sums(self, rig: RigRecord, x: Array, blocks: list[Array]) -> None:
        relative = self._relative(x)
        for column in range(len(self.prior.names)):
            for source in self._sources(rig, column):
                for block in blocks:
                    block[:, column] += block[:, source] * (relative[column] / relative[source])

    def _differences(self, index: int, x: Array) -> list[Array]:
        measured = self.rigs[index].measured
        return [y - m.values for m, y in zip(measured, self._models(index, x), strict=True)]

    def _add_input_errors(self, x: Array) -> None:
        """What possible errors of voltages and loads do to the signals of each record."""
        random = np.random.default_rng(0)
        for index, (rig, noise) in enumerate(zip(self.rigs, self._noise, strict=True)):
            clean = self._models(index, x)
            drawn = [rig.draw_errors(random) for _ in range(_INPUT_DRAWS)]
            moved = [
                [
                    [a - b for a, b in zip(self._models(index, x, e), clean, strict=True)]
                    for e in errors
                ]
                for errors in (drawn, rig.hold_errors())
            ]
            noise.set_input_errors(*moved)


def _telling(jacobian: Callable[[Array], Array], report: Report) -> Callable[[Array], Array]:
    """The same function, which reports each step of a fit before it is taken."""
    steps = count()

    def told(x: Array) -> Array:
        step = next(steps)
        report(step / (step + _USUAL_STEPS), f"step {step + 1}")
        return jacobian(x)

    return told

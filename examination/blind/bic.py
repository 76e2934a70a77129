"""A naive rival of the diagnosis, which sits the same examination: the lowest BIC.

The baseline's numbers and one effect are refitted together by least squares, noise taken as white:

    BIC = n ln(S/n) + k ln n

with the sum S of n squared residuals over noise and k fitted numbers (Schwarz, Annals of Statistics
6, 1978); the lab's parameters as they are (k = 0) and refitted alone compete. Probabilities go as
exp(-BIC/2). Neither the lab's uncertainties nor the noise's correlation enter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from examination.blind.case_files import NO_EFFECT, NO_GAP, RECALIBRATION, STAGE_OF
from examination.blind.rigs import quantity_of, simulated_reading
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.simulate import Simulation, simulate
from sma_bench.records import Record
from sma_bench.records.samples import held_voltages

Array = npt.NDArray[np.float64]

# --- A record as it is fitted: means over a tenth of a second.

PERIOD = 0.1
_GRID = PERIOD / 2.0
_FEWEST = 20  # samples of a signal
_BLOCK = 50  # bins of a bootstrap block: 5 s
_STAGE_OF_QUANTITY = {
    "current": "electrical", "temperature": "thermal", "deflection": "mechanical",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Reading:
    """One signal in bins: `mean` of the samples at `time` that fall into bin number `row` of `at`,
    its white noise, and, of a current, `volts` on the wire at each sample and on the grid."""

    name: str
    time: Array
    row: npt.NDArray[np.intp]
    at: npt.NDArray[np.intp]
    mean: Array
    noise: float
    volts: Array | None = None
    grid_volts: Array | None = None

    def residual(self, simulation: Simulation) -> Array:
        """Measured less simulated, over the noise."""
        values = simulated_reading(simulation, self.name)
        if self.volts is not None and self.grid_volts is not None:  # follows its voltage at once
            conductance = np.where(self.grid_volts > 0.0, values, 0.0) / np.maximum(
                self.grid_volts, 1e-9
            )
            held = np.minimum((self.time / _GRID).astype(np.intp), len(values) - 1)
            samples = conductance[held] * self.volts
        else:
            samples = np.interp(self.time, simulation.time, values)
        binned = np.bincount(self.row, samples) / np.bincount(self.row)
        return (self.mean - binned) / self.noise


@dataclass(frozen=True, eq=False)
class Observed:
    """One record: (m,) s and (m, w) V that a simulation plays, and its signals."""

    time: Array
    voltage: Array
    readings: tuple[Reading, ...]

    def residuals(self, parameters: Parameters) -> list[Array]:
        """Of every signal over its noise."""
        simulation = simulate(parameters, self.time, self.voltage)
        return [reading.residual(simulation) for reading in self.readings]


def observe(record: Record, parameters: Parameters) -> Observed:
    """Bin a record; raises InputError without voltages, or without a signal that the model has."""
    channels = tuple(parameters["bench.channels"])
    commanded, volts = held_voltages(record, channels)
    time = np.arange(2 * int(record.duration / PERIOD) + 1) * _GRID
    # Root mean square of the held voltages over each step of the grid: the heat is right.
    corners = np.union1d(time, commanded[(commanded > time[0]) & (commanded < time[-1])])
    held = volts[np.maximum(np.searchsorted(commanded, corners[:-1], side="right") - 1, 0)]
    energy = held**2 * np.diff(corners)[:, None]
    sums = np.add.reduceat(energy, np.searchsorted(corners, time[:-1]), axis=0)
    voltage = np.sqrt(np.vstack([sums, sums[-1:]]) / _GRID)
    names = [f"{channel}.{q}" for channel in channels for q in ("current", "temperature")]
    readings = []
    for name in (*names, "deflection"):
        signal = record.get(name)
        if signal is None or len(signal) < _FEWEST:
            continue
        inside = (signal.time >= 0.0) & (signal.time < time[-1])
        instants, values = signal.time[inside], signal.values[inside]
        at, row = np.unique((instants / PERIOD).astype(np.intp), return_inverse=True)
        # Second differences: the signal's own slope does not count as noise.
        scatter = np.sqrt(np.mean(np.diff(values, 2) ** 2) / 6.0 * len(at) / len(values))
        mean = np.bincount(row, values) / np.bincount(row)
        wire: tuple[Array, ...] = ()
        if name.endswith("current"):
            column = channels.index(name.rpartition(".")[0])
            now = np.maximum(np.searchsorted(commanded, instants, side="right") - 1, 0)
            wire = (volts[now, column], voltage[:, column])
        readings.append(Reading(name, instants, row, at, mean, max(float(scatter), 1e-12), *wire))
    if not readings:
        raise InputError(f"{record.path}: nothing measured besides the voltages")
    return Observed(time, voltage, tuple(readings))


# --- Least squares over some numbers, with finite differences and few simulations.

_STEP = 0.05  # of a finite difference, in scales
_ENOUGH = 1e-4  # relative gain below which a fit is done
_BACK = {"composite.stress_per_deflection_front": "composite.stress_per_deflection_back"}
# Those of the baseline that may be off. The area acts only together with h, the mass only together
# with c_p; both sides share one beta.
_BASELINE = (
    "environment.ambient_temperature",
    *(f"wire.{name}" for name in (
        "resistance", "heat_transfer_coefficient", "specific_heat",
        "austenite_start_temperature", "austenite_finish_temperature",
        "martensite_start_temperature", "martensite_finish_temperature",
        "stress_influence_austenite", "stress_influence_martensite",
        "martensite_modulus", "austenite_modulus", "maximum_recoverable_strain",
        "thermal_expansion_factor",
    )),
    "composite.deflection_per_strain", *_BACK,
)  # fmt: skip
_ORDERED = (("austenite_start", "austenite_finish"), ("martensite_finish", "martensite_start"))


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted parameters, the sum of squares of the residuals over noise, how many were fitted."""

    parameters: Parameters
    square: float
    fitted: int


def whitened(observed: Sequence[Observed], parameters: Parameters) -> Array:
    """Residuals of all records over their noise."""
    return np.concatenate([row for one in observed for row in one.residuals(parameters)])


def moved(parameters: Parameters, names: Sequence[str], steps: Array) -> Parameters:
    """Parameters moved by so many of their stated standard deviations, held within their ranges; a
    transformation that would end before it begins keeps its temperatures."""
    values = {}
    for name, step in zip(names, steps.tolist(), strict=True):
        low, high = BY_NAME[name].low, BY_NAME[name].high
        value = parameters[name] + step * parameters.std(name)
        value = value if low is None else max(value, low)
        values[name] = float(value if high is None else min(value, high))
        if name in _BACK:
            values[_BACK[name]] = values[name]
    for pair in _ORDERED:
        first, last = (f"wire.{which}_temperature" for which in pair)
        if values.get(last, parameters[last]) - values.get(first, parameters[first]) < 0.5:
            values.pop(first, None), values.pop(last, None)
    return parameters.replace(values)


def slopes(
    observed: Sequence[Observed], parameters: Parameters, names: Sequence[str], here: Array
) -> Array:
    """(n, k) change of the residuals `here` a standard deviation of each parameter."""
    columns = [np.zeros((len(here), 0))]
    for k, name in enumerate(names):
        high = BY_NAME[name].high
        step = _STEP * (np.arange(len(names)) == k)
        if high is not None and parameters[name] + _STEP * parameters.std(name) > high:
            step = -step
        there = whitened(observed, moved(parameters, names, step))
        columns.append(((there - here) / step[k])[:, None])
    return np.hstack(columns)


def fit(
    observed: Sequence[Observed], start: Parameters, names: Sequence[str], rounds: int,
    slow: tuple[Sequence[str], Array] | None = None,
) -> Fit:
    """Least squares over some parameters; `slow` are fitted too, with their slopes at the start."""
    more, columns = slow or ((), None)
    every = (*names, *more)

    def residual(steps: Array) -> Array:
        return whitened(observed, moved(start, every, steps))

    def jacobian(steps: Array) -> Array:
        fast = slopes(observed, moved(start, every, steps), names, residual(steps))
        return fast if columns is None else np.hstack([fast, columns])

    found = least_squares(
        residual, np.zeros(len(every)), jacobian, method="lm", x_scale="jac", ftol=_ENOUGH,
        max_nfev=2 * rounds,
    )
    return Fit(moved(start, every, found.x), 2.0 * float(found.cost), len(every))


# --- The answer, in the form of the contract.


def bic_answer(
    records: Sequence[Record], hold_out: Sequence[Record], nominal: Parameters
) -> tuple[dict[str, Any], Parameters]:
    """What the rival says, to the contract, and its improved parameters.

    Args:
        records: to fit; hold_out: to measure the shrinkage on.
        nominal: what the lab believes.

    Raises:
        InputError: a record without voltages or without anything to compare.
    """
    observed = [observe(record, nominal) for record in records]
    fits = every_fit(observed, nominal)
    n = sum(len(reading.at) for one in observed for reading in one.readings)
    bic = {k: n * np.log(f.square / n) + f.fitted * np.log(n) for k, f in fits.items()}
    weights = {name: float(np.exp(-0.5 * (b - min(bic.values())))) for name, b in bic.items()}
    shares = dict.fromkeys((*STAGE_OF, *NO_EFFECT), 0.0)
    shares |= {name: weight / sum(weights.values()) for name, weight in weights.items()}
    best = max(shares, key=lambda name: shares[name])
    improved = fits[best].parameters
    numbers = EFFECTS[best].parameters if best in EFFECTS else ()
    fitted = {p.name: {"value": float(improved[p.name]), "std": None, "unit": p.unit}
              for p in numbers}  # fmt: skip
    unseen = [observe(record, nominal) for record in hold_out] or observed
    answer = {
        "verdict": best if best in NO_EFFECT else "effect",
        "cause": [] if best in NO_EFFECT else [best],
        "candidates": [
            {"name": name, "stage": STAGE_OF.get(name, ""), "probability": shares[name],
             "parameters": fitted if name == best else {}}
            for name in sorted(shares, key=lambda name: -shares[name])
        ],
        "where": where(observed, nominal, best),
        "shrinkage": shrinkage(unseen, nominal, improved),
        "next_experiment": None,
    }  # fmt: skip
    return answer, improved


def every_fit(observed: Sequence[Observed], nominal: Parameters) -> Mapping[str, Fit]:
    """The lab's parameters, refitted, and refitted with each effect."""
    baseline = [n for n in _BASELINE if nominal[n] != 0.0 and nominal.std(n) > 0.0]
    residual = whitened(observed, nominal)
    fits = {NO_GAP: Fit(nominal, float(residual @ residual), 0)}
    fits[RECALIBRATION] = fit(observed, nominal, baseline, 15)
    refitted = fits[RECALIBRATION].parameters
    near = slopes(observed, refitted, baseline, whitened(observed, refitted))
    for name in EFFECTS:
        numbers = [p.name for p in EFFECTS[name].parameters]
        # The refit may have led away from a large effect, which is then found alone first.
        alone = fit(observed, nominal, numbers, 3).parameters
        far = slopes(observed, alone, baseline, whitened(observed, alone))
        trials = [fit(observed, start, numbers, 4, (baseline, slow))
                  for start, slow in ((refitted, near), (alone, far))]  # fmt: skip
        fits[name] = min(trials, key=lambda trial: trial.square)
    return fits


def where(observed: Sequence[Observed], nominal: Parameters, cause: str) -> dict[str, str]:
    """Signal, phase and side with the most squared residual."""
    sides = dict(zip(nominal["bench.channels"], nominal["bench.channel_sides"], strict=True))
    cells: dict[tuple[str, str, str], float] = {}
    for one in observed:
        voltage = np.maximum(one.voltage[:-1:2], one.voltage[1::2])
        driven = (voltage > 0.0).any(axis=1)
        phase = np.where(driven, "drive", "rest").astype("<U7")
        phase[~np.maximum.accumulate(driven)] = "initial"
        # The side that is driven now, or was last.
        last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), 0))
        of_channel = np.array(list(sides.values()))
        side = of_channel[np.argmax(voltage[last], axis=1)]
        for reading, row in zip(one.readings, one.residuals(nominal), strict=True):
            own = sides.get(reading.name.rpartition(".")[0])
            for k, square in zip(reading.at, row**2, strict=True):
                key = (quantity_of(reading.name), str(phase[k]), own or str(side[k]))
                cells[key] = cells.get(key, 0.0) + float(square)
    signal, when, which = max(cells, key=lambda key: cells[key])
    stage = STAGE_OF.get(cause, _STAGE_OF_QUANTITY[signal])
    return {"signal": signal, "phase": when, "side": which, "stage": stage}


def shrinkage(
    observed: Sequence[Observed], nominal: Parameters, improved: Parameters
) -> dict[str, dict[str, Any]]:
    """Claims by quantity: share of the reducible root mean square that is gone, blocks of 5 s
    bootstrapped."""
    rows: dict[str, list[list[float]]] = {}
    for one in observed:
        both = zip(one.readings, one.residuals(nominal), one.residuals(improved), strict=True)
        for reading, before, after in both:
            blocks = max(1, len(before) // _BLOCK)
            parts = (np.array_split(r**2, blocks) for r in (before, after))
            means = [[float(b.mean()), float(a.mean())] for b, a in zip(*parts, strict=True)]
            rows.setdefault(quantity_of(reading.name), []).extend(means)
    claims: dict[str, dict[str, Any]] = {}
    for quantity, found in rows.items():
        b, a = np.array(found).T
        value = _gone(b, a)
        low = high = value
        if len(b) > 1 and np.isfinite(value):
            drawn = np.random.default_rng(1).integers(0, len(b), (400, len(b)))
            low, high = np.nanpercentile([_gone(b[k], a[k]) for k in drawn], [5.0, 95.0])
        known = bool(np.isfinite([low, value, high]).all())
        interval = [min(float(low), value), max(float(high), value)] if known else None
        claims[quantity] = {"fraction": value if known else None, "ci90": interval}
    return claims


def _gone(before: Array, after: Array) -> float:
    """Of mean squares over the noise's; NaN where nothing was reducible."""
    reducible = before.mean() - 1.0
    if reducible <= 0.1:
        return float("nan")
    return float(1.0 - np.sqrt(max(after.mean() - 1.0, 0.0) / reducible))

"""The chain broken at each measured signal: what is missed when a block gets what was measured.

    V -> I, V -> T         the records' voltages drive the model
    T -> deflection        the measured temperatures drive transformation and bending
    V -> deflection        the free run

With recalibrated parameters and without any effect. A block that misses little from measured input
and much in the free run is innocent; the fault lies before it. The measured temperature is the
model's plus the smoothed difference, which moves only when it has changed by more than its noise:
a wire's hysteresis would follow every wiggle.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from sma_bench.diagnose.result import Link
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.estimation.solver import Fit
from sma_bench.parameters.audit import wire_length
from sma_bench.parameters.parameters import as_recorded
from sma_bench.physics.heat import heat_loss, heated_resistance
from sma_bench.physics.simulate import Simulation

Array = NDArray[np.float64]

_SMOOTHING = 2.0  # bins, standard deviation
_PLAY = 3.0  # of the noise that smoothing leaves
# A wire so light that it is where its heating would settle it, at the end of every cell.
_LIGHT = {"wire.mass": 1e-6, "wire.specific_heat": 50.0}
_BLOCK = 8.0  # s
_MUCH = 2.0  # times
_DRAWS, _SEED = 200, 2


V_TO_DEFLECTION, T_TO_DEFLECTION = "V -> deflection", "temperature -> deflection"


def break_chain(recalibrated: Fit) -> list[Link]:
    """Every block whose two ends are measured, in the order of the chain."""
    observations = recalibrated.problem.observations
    quantities = list(dict.fromkeys(q for obs in observations for q in obs.quantities))
    links = [
        _link(f"V -> {quantity}", quantity, recalibrated, recalibrated.left)
        for quantity in ("current", "temperature") if quantity in quantities
    ]
    if "deflection" in quantities:
        if all(_sees_every_wire(obs) for obs in observations):
            links.append(
                _link(T_TO_DEFLECTION, "deflection", recalibrated,
                      _left_behind_temperature(recalibrated))
            )
        links.append(_link(V_TO_DEFLECTION, "deflection", recalibrated, recalibrated.left))
    return links


def _sees_every_wire(obs: Observation) -> bool:
    seen = {s.wire for s in obs.signals if s.quantity == "temperature"}
    return seen == set(range(len(obs.channels)))


def _left_behind_temperature(recalibrated: Fit) -> Array:
    """(n,) what the deflection's block leaves of its signal when measured temperatures drive it."""
    changes = []
    known = recalibrated.parameters
    heated = heat_loss(known) * heated_resistance(as_recorded(known))
    for obs in recalibrated.problem.observations:
        run = obs.simulate(known)
        # The model made to pass through temperatures (n, w) K, ambient at least.
        ambient = known["environment.ambient_temperature"]
        volts = np.sqrt(np.maximum(measured_temperature(obs, run) - ambient, 0.0) * heated)
        ahead = np.vstack([volts[1:], volts[-1:]])  # held until the next time is reached
        light = known.replace(_LIGHT | {"wire.length": wire_length(known)})
        driven = obs.simulate(light, ahead)
        changes += [a - b for a, b in zip(obs.readings(driven), obs.readings(run), strict=True)]
    return recalibrated.left - np.concatenate(changes)


def measured_temperature(obs: Observation, run: Simulation) -> Array:
    """(n, w) K on the grid: the model's temperature, corrected by what was measured."""
    corrected = run.temperature.copy()
    for signal, reading in zip(obs.signals, obs.readings(run), strict=True):
        if signal.quantity == "temperature":
            smooth = gaussian_filter1d(signal.value - reading, _SMOOTHING, mode="nearest")
            left = signal.noise / np.sqrt(2.0 * np.sqrt(np.pi) * _SMOOTHING)
            # A course that follows only beyond `play` on either side.
            course = smooth - smooth[0]
            play = _PLAY * left
            correction = np.empty_like(course)
            place = course[0]
            for k, value in enumerate(course):
                place = min(max(place, value - play), value + play)
                correction[k] = place
            corrected[:, signal.wire] += np.interp(obs.grid, signal.time, correction)
    return corrected


def _link(block: str, quantity: str, fitted: Fit, left: Array) -> Link:
    energies = [
        _energies(own.signal, left[own.rows])
        for own in fitted.problem.blocks if own.signal.quantity == quantity
    ]
    energy, count, power = np.concatenate(energies).T
    random = np.random.default_rng(_SEED)
    draws = random.integers(0, len(count), (_DRAWS, len(count)))
    low, high = np.quantile([_gap(energy[d], count[d]) for d in draws], [0.05, 0.95])
    rms = float(np.sqrt(power.sum() / count.sum()))
    return Link(block, _gap(energy, count), (float(low), float(high)), rms)


def _energies(signal: BinnedSignal, left: Array) -> Array:
    """(blocks, 3): squared misfit beyond that of white noise, over a sample's noise; samples; and
    squared misfit."""
    which = np.floor((signal.time - signal.time[0]) / _BLOCK).astype(np.intp)
    _, which = np.unique(which, return_inverse=True)
    own = signal.noise**2  # of a bin: what averaging has left
    square = signal.count * left**2
    beyond = (square - signal.count * own) / (own * np.median(signal.count))
    return np.column_stack(
        [np.bincount(which, beyond), np.bincount(which, signal.count), np.bincount(which, square)]
    )


def _gap(energy: Array, count: Array) -> float:
    return float(np.sqrt(max(float(energy.sum()), 0.0) / float(count.sum())))


def reading_of(links: Sequence[Link]) -> str:
    """What the broken chain says, in one sentence; "" without temperatures and a deflection."""
    by_block = {link.block: link for link in links}
    if T_TO_DEFLECTION not in by_block or V_TO_DEFLECTION not in by_block:
        return ""
    free, driven = by_block[V_TO_DEFLECTION].gap, by_block[T_TO_DEFLECTION].gap
    said = (
        f"Recalibrated and without any effect, the model misses the deflection by {free:.2g} times "
        f"a sample's noise when the voltages drive it, and by {driven:.2g} times when the measured "
        "temperatures do"
    )
    if max(free, driven) < 1.0:
        return f"{said}: both little."
    if driven > _MUCH * free:
        return (
            f"{said}: the voltages tell more about the deflection than the temperatures do, so "
            "what reads or shapes the temperatures is to be doubted first."
        )
    if free > _MUCH * driven:
        return f"{said}: what is missing acts before the temperature."
    return f"{said}: what is missing acts after the temperature."

"""The shape of what no effect explains: against time, simulated temperature and voltage."""

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.sizes import locate
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.physics.simulate import Simulation
from sma_bench.report.diagnosis_maps import PHASES
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, legend_above, new_figure
from sma_bench.report.free_form import free_form
from sma_bench.report.page import Picture
from sma_bench.results import scale_of

Array = NDArray[np.float64]

_MOST_SIGNALS = 3
_WORTH_A_PICTURE = 0.05  # of all that is missing
_COLOURS = dict(zip(PHASES, (FAINT, MODEL, MEASURED), strict=True))


def missing_pictures(result: Diagnosis) -> list[Picture]:
    """A picture for each signal that most of what is missing lies in."""
    cells = locate(result.model.problem, result.search.recalibrated.left)
    shares: dict[str, float] = {}
    for cell in cells:
        shares[cell.signal] = shares.get(cell.signal, 0.0) + cell.share
    ranked = sorted(shares, key=lambda name: shares[name], reverse=True)
    worth = [name for name in ranked if shares[name] > _WORTH_A_PICTURE]
    return [_missing(result, name) for name in worth[:_MOST_SIGNALS]]


def _missing(result: Diagnosis, name: str) -> Picture:
    unit, factor = scale_of(name)
    figure, (course, temperature, voltage) = new_figure(3, 8.0, shared=False)
    model = result.search.recalibrated
    shown = ""
    response = free_form(result)
    for block in model.problem.of_signal(name):
        obs, time = block.observation, block.signal.time
        left, smooth = model.left[block.rows], response[block.rows]
        if not shown:
            shown = obs.path
            course.plot(time, factor * left, color=FAINT, lw=1.0, label="left by recalibration")
            if smooth.any():
                course.plot(time, factor * smooth, color=SECOND, lw=1.2,
                            label="of it a smooth response of free form")
        warm, volts = _causes(obs, block.signal, obs.simulate(model.parameters))
        phases = obs.phase_of(time)
        for phase, colour in _COLOURS.items():
            here = phases == phase
            for ax, x in ((temperature, warm), (voltage, volts)):
                ax.plot(x[here], factor * left[here], ".", ms=2.5, color=colour)
    for phase, colour in _COLOURS.items():
        temperature.plot([], [], ".", ms=8, color=colour, label=phase)
    legend_above(course)
    legend_above(temperature)
    course.set(xlabel="time [s]")
    bends = name == "deflection"
    temperature.set(
        xlabel="simulated temperature, front less back [K]" if bends
        else "simulated temperature of the wire [K]"
    )
    voltage.set(
        xlabel="voltage, back counted negative [V]" if bends else "voltage of the wire [V]"
    )
    for ax in (course, temperature, voltage):
        ax.set_ylabel(f"missing [{unit}]")
    caption = (
        f"What recalibration leaves of the {name}, sensors' zeros taken off: over time ({shown}), "
        "over simulated temperature and over voltage (all records). A curve means a dependence, a "
        "loop means memory, a spread over both means that its cause lies elsewhere."
    )
    title = f"What is missing in {name}"
    return Picture(f"diagnosis_missing_{name.replace('.', '_')}", title, caption, figure)


def _causes(obs: Observation, signal: BinnedSignal, simulation: Simulation) -> tuple[Array, Array]:
    """Temperature and voltage (b,) that the term may depend on."""
    at = np.clip(np.searchsorted(obs.grid, signal.time), 0, len(obs.grid) - 1)
    temperature, voltage = simulation.temperature[at], obs.voltage[at]
    if signal.quantity != "deflection":
        return temperature[:, signal.wire], voltage[:, signal.wire]
    front = np.array(obs.sides) == obs.sides[0]
    return _difference(temperature, front), _difference(voltage, front)


def _difference(values: Array, front: NDArray[np.bool_]) -> Array:
    back = values[:, ~front].max(axis=1) if (~front).any() else np.zeros(len(values))
    return np.asarray(values[:, front].max(axis=1) - back)

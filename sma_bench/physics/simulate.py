"""Simulate a bench: whole voltage records at once, or live, step by step, with the same kernel."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from sma_bench.arrays import Array
from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length
from sma_bench.physics import columns as at
from sma_bench.physics.bending import channel_section
from sma_bench.physics.boundary import Boundary
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.ambient_drift import air_temperature
from sma_bench.physics.effects.deflection_drift import zero
from sma_bench.physics.kernel import Kernel, State, at_rest, require_possible


@dataclass(eq=False, repr=False)
class Readings:
    """Signals that follow from a bench's states, at one instant or at many (along a first axis).

    `temperature`: (..., w) K; `martensite_fraction`: (..., w); `stress`: (..., w) Pa;
    `contraction`: (..., s), -(eps - eps_0) of each side, in the order of `side_names`; `bending`:
    (..., s), the part that bends the beam: all of it, unless wires are slack or opposed;
    `temperature_reading`: (..., w) K, the temperature, unless effects of the sensor are on;
    `mount`: (..., w) K, warming of the deflection sensor's mount by each wire (they are averaged);
    `sag`: (..., w) V, voltage drop of each channel's battery; `clock`: s since the bench's start.
    """

    kernel: Kernel
    temperature: Array
    martensite_fraction: Array
    stress: Array
    contraction: Array
    bending: Array
    temperature_reading: Array
    mount: Array
    sag: Array
    clock: ClassVar[Any]

    @property
    def parameters(self) -> Parameters:
        return self.kernel.parameters

    @property
    def boundary(self) -> Boundary:
        return self.kernel.boundary

    @property
    def deflection(self) -> Any:
        """(...) m, positive toward the front; a loaded wire's elongation; 0 if fixed."""
        return self.bending @ self.boundary.levers(self.parameters)

    @property
    def deflection_reading(self) -> Any:
        """(...) m, what a sensor reads: the deflection, unless its zero drifts."""
        drifts = EFFECTS["deflection_drift"].is_on(self.parameters)
        return self.deflection + (zero(self.parameters, self.clock, self.mount) if drifts else 0.0)

    @property
    def elongation(self) -> Array:
        """(..., s) m, of each side's wires from the clamped length; contraction is negative."""
        return -wire_length(self.parameters) * self.bending

    @property
    def force(self) -> Array:
        """(..., w) N of each channel, tension positive, eq. (13)."""
        return self.stress * channel_section(self.parameters)

    def current_at(self, voltage: ArrayLike) -> Array:
        """(..., w) A through the channels in their states at `voltage` (..., w) V, as read or
        commanded: the mean of a duty; eq. (3) with all effects off."""
        of_one = self.kernel.currents(voltage, self.temperature, self.martensite_fraction, self.sag)
        return self.parameters["wire.count"] * of_one


# With these the current is not in proportion to the voltage. Least share of the highest voltage
# that drives: less may be noise around 0.
_NOT_OHMIC = tuple(f"effect.supply_drop.{n}" for n in ("threshold", "overload", "battery"))
_DRIVES = 0.01


@dataclass(eq=False, repr=False)
class Simulation(Readings, Drawn):
    """Response of a bench to given voltages: `Readings` of n samples at `time` (n,) s; `voltage`:
    (n, w) V, held from each sample to the next; `final`: the state after the last sample, for a
    simulation that continues; `started`: s, the bench's clock at the first sample."""

    time: Array
    voltage: Array
    final: State
    started: float = 0.0

    def __repr__(self) -> str:
        span = f"{self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self.time) else "no time"
        rig = f"{', '.join(self.parameters['bench.channels'])} ({load_kind(self.parameters)})"
        return f"<Simulation of {rig}: {len(self.time)} samples, {span}>"

    @cached_property
    def clock(self) -> Array:  # type: ignore[override]
        """(n,) s since the bench's start, summed as the core does, step by step."""
        return np.cumsum(np.concatenate([[self.started], np.diff(self.time)]))

    @property
    def most_austenite(self) -> Array:
        """(w,) largest austenite fraction so far, reduced as residual strain recovers."""
        assert self.final.memory is not None
        return self.final.memory[0][:, at.MOST_AUSTENITE - at.WIRE_STATE]

    @cached_property
    def current(self) -> Array:
        """(n, w) A."""
        return self.current_at(self.voltage)

    @property
    def conductance(self) -> Array:
        """(n, w) A/V; of a wire that is not driven, that at its last volts, or at 1 V."""
        volts = np.ones_like(self.temperature)
        if any(self.parameters[name] for name in _NOT_OHMIC):
            driven = self.voltage > _DRIVES * np.max(self.voltage, initial=0.0)
            last = np.maximum.accumulate(driven * np.arange(1, len(volts) + 1)[:, None], axis=0) - 1
            volts = np.where(last < 0, volts, np.take_along_axis(self.voltage, last, axis=0))
        return self.current_at(volts) / volts


def simulate(parameters: Parameters, time: ArrayLike, voltage: ArrayLike, *,
             initial: State | None = None, boundary: Boundary | None = None,
             elongation: ArrayLike | None = None) -> Simulation:
    """Solve the baseline model (contract section 4) with the law and effects of `parameters`.

    Temperatures are exact for the held voltages; phase, stress and contraction are solved together
    at every sample. With latent heat the rate of transformation is constant over a step; the inputs
    of other effects are those at its start. InputError: wrong shape, time that does not increase, a
    number that is not finite, an elongation with another `load.kind`, or, with no `initial`, a
    bench that is too warm at rest for martensite.

    Args:
        time: (n,) s, increasing.
        voltage: (n, w) V, one column a channel; voltage[k] is held from time[k] to time[k+1].
            One wire may come as (n,).
        initial: state at time[0], at rest when not given; `Simulation.final` continues a run.
        boundary: the rig's own load when not given.
        elongation: (n,) m imposed with `load.kind` displacement, linear between samples; 0 when
            not given."""
    if elongation is not None and boundary is None and np.size(elongation):
        boundary = Boundary.imposed(parameters, float(np.ravel(elongation)[0]))
    return Bench(parameters, initial=initial, boundary=boundary).follow(time, voltage, elongation)


def simulate_from_rest(parameters: Parameters, time: Array, voltage: Array, boundary: Boundary,
                       most_austenite: Array | None = None) -> Simulation:
    """As `simulate`, for fits: from rest even where martensite is impossible, arrays unchecked.
    `most_austenite` (w,): largest austenite fraction before the start; 0 when not given."""
    kernel = Kernel(parameters, boundary)
    memory = kernel.memory(None)
    if most_austenite is not None:
        kernel.carry_over(memory, most_austenite)
    recorded = kernel.run(time, voltage, memory)
    return _simulated(kernel, time, voltage, recorded, kernel.state(memory), 0.0)


def _simulated(kernel: Kernel, time: Array, voltage: Array, recorded: tuple[Array, Array],
               final: State, started: float) -> Simulation:
    history, strain = recorded
    rest: Any = (*history[:3], *strain, *history[3:], time, voltage, final, started)
    return Simulation(kernel, *rest)


def run_once() -> None:
    """Simulate two steps of the default bench, so that the core is compiled or read from disk."""
    bench = Parameters.defaults()
    volts = np.ones((3, len(bench["bench.channels"])))
    simulate(bench, [0.0, 0.05, 0.1], volts).current_at(volts)


def _checked(name: str, given: ArrayLike, expected: tuple[int, ...]) -> Array:
    """As an array. InputError: another shape, or not finite."""
    array = np.ascontiguousarray(given, dtype=float)
    if array.shape != expected:
        raise InputError(f"simulation: {name} has shape {array.shape}, expected {expected}")
    if not np.all(np.isfinite(array)):
        k = int(np.argwhere(~np.isfinite(array))[0][0])
        raise InputError(f"simulation: {name} of sample {k} is {array[k]}, expected finite")
    return array


class Bench(Readings):
    """A bench simulated live, step by step, with its present readings."""

    state: State  # the present one, to carry into another Bench or `simulate`

    def __init__(self, parameters: Parameters, *, initial: State | None = None,
                 boundary: Boundary | None = None) -> None:
        """A bench at rest, or in the state `initial`; arguments as for `simulate`."""
        self.kernel = Kernel(parameters, boundary)
        if initial is None:
            initial = at_rest(parameters, self.kernel.boundary)
            require_possible(initial, parameters)
        self._memory = self.kernel.memory(initial)
        self._settle()

    def advance(self, voltage: ArrayLike, dt: float) -> State:
        """Hold `voltage` (w,) V for `dt` s; returns the state. InputError: wrong shape, not finite,
        dt not above 0."""
        if not 0.0 < dt < np.inf:
            raise InputError(f"bench step: dt is {dt} s, expected above 0")
        volts = _checked("voltage", np.asarray(voltage, float)[np.newaxis], (1, self.kernel.wires))
        self.kernel.run(np.array([0.0, dt]), np.vstack([volts, volts]), self._memory)
        return self._settle()

    def follow(self, time: ArrayLike, voltage: ArrayLike,
               elongation: ArrayLike | None = None) -> Simulation:
        """Continue over samples as in `simulate`; the first sample is the present state."""
        seconds, volts = np.asarray(time, dtype=float), np.asarray(voltage, dtype=float)
        if seconds.ndim != 1 or seconds.size == 0:
            raise InputError(f"simulation: time has shape {seconds.shape}, expected (n,)")
        if volts.ndim == 1 and self.kernel.wires == 1:
            volts = volts[:, np.newaxis]
        volts = _checked("voltage", volts, (seconds.size, self.kernel.wires))
        seconds = _checked("time", seconds, seconds.shape)
        if not np.all(seconds[1:] > seconds[:-1]):
            k = int(np.argmax(seconds[1:] <= seconds[:-1]))
            goes = f"from {seconds[k]} to {seconds[k + 1]} s at sample {k + 1}"
            raise InputError(f"simulation: time goes {goes}, expected increasing")
        started, contraction = float(self.clock), None
        if elongation is not None:
            if (kind := load_kind(self.parameters)) != "displacement":
                found = f"elongation with load.kind {kind}"
                raise InputError(f"simulation: {found}, expected displacement")
            moved = _checked("elongation", elongation, seconds.shape)
            contraction = -moved / wire_length(self.parameters)
        recorded = self.kernel.run(seconds, volts, self._memory, contraction)
        return _simulated(self.kernel, seconds, volts, recorded, self._settle(), started)

    def pull_against(self, boundary: Boundary) -> None:
        """Continue under another load."""
        self.kernel = Kernel(self.parameters, boundary)
        self._memory = self.kernel.memory(self.state)

    @property
    def ambient_temperature(self) -> float:
        """Air around the wires [K]."""
        return float(air_temperature(self._memory[0], 0))

    def _settle(self) -> State:
        self.state = now = self.kernel.state(self._memory)
        wires, sides = self._memory
        super().__init__(self.kernel, now.temperature, now.martensite_fraction, now.stress,
                         now.contraction, sides[:, at.BENDING].copy(),
                         *(wires[:, k].copy() for k in (at.READING, at.MOUNT, at.SAG)))
        self.clock = now.clock  # type: ignore[misc]
        return now


# --- Wires driven through given temperatures: a wire without heat capacity reaches its steady
# temperature within a step, so the heating is chosen that has the given one as steady temperature.

_NO_TIME = 1e-9  # s, time constant of such a wire
_RAMP_STEP = 1e-3  # s, between samples of a ramp


class TemperatureDriven:
    """Transformation, stress and bending of a bench whose temperatures are given."""

    def __init__(self, parameters: Parameters, initial: State | None = None,
                 boundary: Boundary | None = None) -> None:
        """At rest, or in the state `initial`; electrical and thermal effects are switched off."""
        plain = {p.name: p.default for effect in EFFECTS.values()
                 if effect.stage in ("electrical", "thermal") for p in effect.parameters}
        plain |= {"bench.drive": "voltage", "bench.lead_resistance": 0.0}
        self._parameters = parameters.replace({**plain, "wire.convection": "constant"})
        self._kernel = Kernel(self._parameters, boundary)
        wires = self._kernel.rows[0]
        wires[:, at.TIME_CONSTANT], wires[:, at.HEATING] = _NO_TIME, 1.0
        self.begin(initial)
        self._ambient = float(parameters["environment.ambient_temperature"])

    def begin(self, initial: State | None) -> None:
        """Return to rest, or to the state `initial`."""
        self._memory = self._kernel.memory(initial)

    def run(self, time: ArrayLike, temperature: ArrayLike) -> tuple[Array, Array]:
        """Go through temperatures (n, w) K, at least ambient, at times (n + 1,) s, the first the
        present; readings of deflection (n,) m, 0 if fixed, and force (n, w) N."""
        seconds, kelvin = np.asarray(time, dtype=float), np.asarray(temperature, dtype=float)
        clock = float(self._memory[0][0, at.CLOCK])
        volts = np.sqrt(np.maximum(kelvin - self._ambient, 0.0))
        held = np.vstack([volts, volts[-1:]])
        history, strain = self._kernel.run(seconds, held, self._memory)
        drift = zero(self._parameters, clock + seconds[1:] - seconds[0], history[4, 1:])
        levers = self._kernel.boundary.levers(self._parameters)
        return strain[1, 1:] @ levers + drift, history[2, 1:] * channel_section(self._parameters)

    @property
    def state(self) -> State:
        """The present state, from which another bench may continue."""
        return self._kernel.state(self._memory)


def warmed_from_rest(parameters: Parameters, temperature: Array,
                     by_way_of: float | None = None) -> State:
    """The state of a bench led from rest to (w,) K, at least ambient, by way of `by_way_of` K."""
    start = np.full_like(temperature, parameters["environment.ambient_temperature"])
    bench, share = TemperatureDriven(parameters), np.linspace(0.0, 1.0, 201)
    ends = [np.maximum(temperature, start)]
    for end in ends if by_way_of is None else [np.full_like(temperature, by_way_of), *ends]:
        bench.run(_RAMP_STEP * 200.0 * share, start + share[1:, np.newaxis] * (end - start))
        start = end
    return bench.state

"""Simulate a bench: whole voltage records at once, or live, step by step, with the same kernel."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.drawn import Drawn
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import wire_length
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics import columns as at
from sma_bench.physics import core
from sma_bench.physics.bending import channel_section
from sma_bench.physics.boundary import Boundary, per_side, side_names
from sma_bench.physics.effects import EFFECTS, active_effects
from sma_bench.physics.effects.ambient_drift import air as air_temperature
from sma_bench.physics.effects.deflection_drift import zero as zero_drift
from sma_bench.physics.heat import EnergyBalance, energy_balance
from sma_bench.physics.kernel import Kernel, State, require_possible
from sma_bench.physics.material import current

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Drawn):
    """What a bench does under given voltages.

    Attributes:
        parameters, boundary: what it was simulated with, effects among them.
        time: (n,) s; voltage: (n, w) V, held from each sample to the next.
        temperature: (n, w) K; martensite_fraction: (n, w); stress: (n, w) Pa.
        contraction: (n, s), -(eps - eps_0) of each side, in the order of `side_names`.
        bending: (n, s), what of it bends the beam: all of it, unless the wires hang (slack).
        temperature_reading: (n, w) K, what a sensor reads: the temperature, unless effects of the
            sensor are on.
        final: the state after the last sample, for a simulation that continues.
        started: s, the bench's clock at the first sample (drifts count from its start).
    """

    parameters: Parameters
    boundary: Boundary
    time: Array
    voltage: Array
    temperature: Array
    martensite_fraction: Array
    stress: Array
    contraction: Array
    bending: Array
    temperature_reading: Array
    final: State
    started: float = 0.0

    def __repr__(self) -> str:
        span = f"{self.time[0]:.4g} to {self.time[-1]:.4g} s" if len(self.time) else "no time"
        channels = ", ".join(self.parameters["bench.channels"])
        load = load_kind(self.parameters)
        return f"<Simulation of {channels} ({load}): {len(self.time)} samples, {span}>"

    @cached_property
    def clock(self) -> Array:
        """(n,) s since the bench's start, summed as the core does, step by step."""
        return np.cumsum(np.concatenate([[self.started], np.diff(self.time)]))

    @cached_property
    def deflection(self) -> Array:
        """(n,) m, positive toward the front; elongation of a wire that moves its load; zeros where
        nothing moves."""
        return self.bending @ _levers(self.parameters, self.boundary)

    @cached_property
    def deflection_reading(self) -> Array:
        """(n,) m, what a sensor reads: the deflection, unless its zero drifts."""
        if not EFFECTS["deflection_drift"].is_on(self.parameters):
            return self.deflection
        return self.deflection + zero_drift(self.parameters, self.clock)

    @cached_property
    def current(self) -> Array:
        """(n, w) A, eq. (3)."""
        return current(self.parameters, self.voltage, self.temperature, self.martensite_fraction)

    @cached_property
    def elongation(self) -> Array:
        """(n, s) m, of each side's wires from the clamped length; contraction is negative."""
        return -wire_length(self.parameters) * self.bending

    @cached_property
    def force(self) -> Array:
        """(n, w) N of each channel, tension positive, eq. (13)."""
        return self.stress * channel_section(self.parameters)

    def energy_balance(self) -> EnergyBalance:
        """Energies of every step and wire, eq. (1).

        Raises:
            InputError: an effect other than latent heat changes how the wires are heated.
        """
        active = active_effects(self.parameters)
        others = [name for name in active if "HEATED_OTHERWISE" in EFFECTS[name].marks]
        if others:
            raise InputError(f"energy balance: {others[0]} is on, expected latent_heat at most")
        return energy_balance(
            self.parameters, self.time, self.voltage, self.temperature, self.martensite_fraction,
            self.parameters["effect.latent_heat.heat"],
        )


def simulate(
    parameters: Parameters, time: ArrayLike, voltage: ArrayLike, *, initial: State | None = None,
    boundary: Boundary | None = None,
) -> Simulation:
    """Solve the baseline model (contract section 4), and the effects that the parameters switch on.

    Temperatures are exact for the held voltages; phase, stress and contraction are solved
    together at every sample. With latent heat the transformation rate is constant over a step;
    what other effects depend on (T in h(T), xi in R(xi), the other side's temperature) is taken
    from its start.

    Args:
        time: (n,) s, increasing.
        voltage: (n, w) V, one column a channel; voltage[k] is held from time[k] to time[k+1].
            One wire may come as (n,).
        initial: state at time[0], at rest when not given; `Simulation.final` continues a run.
        boundary: the rig's own load when not given.

    Raises:
        InputError: wrong shape, time that does not increase, a number that is not finite, or, with
            no `initial`, a bench that is too warm at rest for martensite.
    """
    kernel = Kernel.of(parameters, boundary)
    if initial is None:
        require_possible(kernel.rest, parameters)
    seconds, volts = _checked_input(time, voltage, kernel.wires)
    memory = kernel.memory(initial)
    history, strain = kernel.run(seconds, volts, memory)
    temperature, fraction, sigma, reading = history
    contraction, bending = strain
    return Simulation(
        parameters, kernel.boundary, seconds, volts, temperature, fraction, sigma, contraction,
        bending, reading, kernel.state(memory), initial.clock if initial else 0.0,
    )


def simulate_many(
    benches: Sequence[Parameters], time: Array, voltage: Array
) -> list[Simulation]:
    """Benches that differ in numbers, on one drive by direct voltage and in one call of the core.

    Each begins at rest, and may be too warm for martensite there: it leaves that at once.

    Args:
        benches: of the same channels and load; time: (n,) s, increasing; voltage: (n, w) V.
    """
    kernels = [Kernel(bench, None) for bench in benches]
    memories = [kernel.memory(None) for kernel in kernels]
    wires, sides = (np.stack(rows) for rows in zip(*memories, strict=True))
    samples = len(time)
    history = np.empty((len(benches), 4, samples, wires.shape[1]))
    strain = np.empty((len(benches), 2, samples, sides.shape[1]))
    core.run_many(time, voltage, wires, sides, history, strain)
    return [
        Simulation(
            kernel.parameters, kernel.boundary, time, voltage, run[0], run[1], run[2], pulled[0],
            pulled[1], run[3], kernel.state((of_wires, of_sides)),
        )
        for kernel, run, pulled, of_wires, of_sides in zip(
            kernels, history, strain, wires, sides, strict=True
        )
    ]


class Bench:
    """The same bench stepped live; the simulator node turns its time into a clock."""

    def __init__(
        self, parameters: Parameters, *, initial: State | None = None,
        boundary: Boundary | None = None,
    ) -> None:
        """A bench at rest, or in the state `initial`; arguments as for `simulate`."""
        self.parameters = parameters
        self._kernel = Kernel(parameters, boundary)
        if initial is None:
            require_possible(self._kernel.rest, parameters)
        self._memory = self._kernel.memory(initial)
        self._state = self._kernel.state(self._memory)
        self._levers = _levers(parameters, self._kernel.boundary)
        self._section = channel_section(parameters)

    def advance(self, voltage: ArrayLike, dt: float) -> State:
        """Hold `voltage` (w,) V for `dt` s; the state after it.

        Raises:
            InputError: wrong shape, a voltage that is not finite, or dt not above 0.
        """
        if not 0.0 < dt < np.inf:
            raise InputError(f"bench step: dt is {dt} s, expected above 0")
        wires = self._kernel.wires
        volts = np.ascontiguousarray(voltage, dtype=float)
        if volts.shape != (wires,):
            raise InputError(f"bench step: voltage has shape {volts.shape}, expected ({wires},)")
        if not np.all(np.isfinite(volts)):
            raise InputError(f"bench step: voltage is {volts}, expected finite numbers")
        self._kernel.run(np.array([0.0, dt]), np.stack([volts, volts]), self._memory)
        self._state = self._kernel.state(self._memory)
        return self._state

    def follow(self, time: ArrayLike, voltage: ArrayLike) -> Simulation:
        """Go on over samples as `simulate` takes them; time[0] is that of the present state.

        Raises:
            InputError: as `simulate`.
        """
        seconds, volts = _checked_input(time, voltage, self._kernel.wires)
        started = self._state.clock
        history, strain = self._kernel.run(seconds, volts, self._memory)
        self._state = self._kernel.state(self._memory)
        return Simulation(
            self.parameters, self._kernel.boundary, seconds, volts, history[0], history[1],
            history[2], strain[0], strain[1], history[3], self._state, started,
        )

    def pull_against(self, boundary: Boundary) -> None:
        """Go on under another load."""
        self._kernel = self._kernel.against(boundary)
        self._memory = self._kernel.memory(self._state)
        self._levers = _levers(self.parameters, boundary)

    @property
    def state(self) -> State:
        """The present state, to carry into another Bench or `simulate`."""
        return self._state

    @property
    def temperature(self) -> Array:
        """(w,) K."""
        return self._state.temperature

    @property
    def martensite_fraction(self) -> Array:
        """(w,)."""
        return self._state.martensite_fraction

    @property
    def stress(self) -> Array:
        """(w,) Pa."""
        return self._state.stress

    @property
    def force(self) -> Array:
        """(w,) N of each channel, tension positive."""
        return self._state.stress * self._section

    @property
    def elongation(self) -> Array:
        """(s,) m, of each side's wires from the clamped length; contraction is negative."""
        return -wire_length(self.parameters) * self._state.bending

    @property
    def contraction(self) -> Array:
        """(s,), sides in the order of `side_names`."""
        return self._state.contraction

    @property
    def deflection(self) -> float:
        """Deflection [m], as `Simulation.deflection`."""
        return float(self._state.bending @ self._levers)

    def current(self, voltage: ArrayLike) -> Array:
        """(w,) A through the wires in their present state at `voltage` (w,) V."""
        return current(
            self.parameters, voltage, self._state.temperature, self._state.martensite_fraction
        )

    @property
    def temperature_reading(self) -> Array:
        """(w,) K, what a sensor reads."""
        return self._state.temperature_reading

    @property
    def deflection_reading(self) -> float:
        """Deflection that a sensor reads [m]."""
        return self.deflection + float(zero_drift(self.parameters, self._state.clock))

    @property
    def ambient_temperature(self) -> float:
        """Air around the wires [K]."""
        return float(air_temperature(self.parameters, self._state.clock))


def _levers(parameters: Parameters, boundary: Boundary) -> Array:
    return per_side("lever", boundary.lever, len(side_names(parameters)))


def _checked_input(time: ArrayLike, voltage: ArrayLike, wires: int) -> tuple[Array, Array]:
    seconds = np.ascontiguousarray(time, dtype=float)
    volts = np.ascontiguousarray(voltage, dtype=float)
    if seconds.ndim != 1 or seconds.size == 0:
        raise InputError(f"simulation: time has shape {seconds.shape}, expected (n,)")
    if volts.ndim == 1 and wires == 1:
        volts = volts[:, np.newaxis]
    if volts.shape != (seconds.size, wires):
        raise InputError(
            f"simulation: voltage has shape {volts.shape}, expected ({seconds.size}, {wires})"
        )
    for name, array in (("time", seconds), ("voltage", volts)):
        if not np.all(np.isfinite(array)):
            k = int(np.argwhere(~np.isfinite(array))[0][0])
            raise InputError(f"simulation: {name} of sample {k} is {array[k]}, expected finite")
    backward = np.flatnonzero(np.diff(seconds) <= 0.0)
    if backward.size:
        k = int(backward[0])
        raise InputError(
            f"simulation: time goes from {seconds[k]} to {seconds[k + 1]} s at sample {k + 1}, "
            "expected increasing"
        )
    return seconds, volts


# --- The bench with its heat taken away: wires pass through given temperatures.
#
# The same core as everywhere. A wire without heat capacity is where its heating settles it at the
# end of every step, so a heating is chosen that settles it at the temperature that is wanted.

_NO_TIME = 1e-9  # s, time constant of such a wire
_RAMP_STEP = 1e-3  # s
_RAMP_STEPS = 200


class TemperatureDriven:
    """Transformation, stress and bending of a bench whose temperatures are given."""

    def __init__(self, parameters: Parameters, initial: State | None = None) -> None:
        """At rest, or in the state `initial`; effects on the heating are left out."""
        heating = [e for e in EFFECTS.values() if e.stage in ("electrical", "thermal")]
        without = [p for effect in heating for p in effect.parameters]
        given = {"bench.drive": "voltage", "bench.lead_resistance": 0.0}
        self._parameters = parameters.replace({**given, **{p.name: p.default for p in without}})
        self._kernel = Kernel(self._parameters, None)
        wires = self._kernel.rows[0]
        wires[:, at.TIME_CONSTANT], wires[:, at.HEATING] = _NO_TIME, 1.0
        self._memory = self._kernel.memory(initial)
        self._ambient = float(parameters["environment.ambient_temperature"])
        self._levers = per_side("lever", self._kernel.boundary.lever, len(side_names(parameters)))
        self._section = channel_section(parameters)

    def run(self, time: ArrayLike, temperature: ArrayLike) -> tuple[Array, Array]:
        """Pass through temperatures; what the sensors of the mechanics read on the way.

        Args:
            time: (n + 1,) s, increasing; the first is that of the present state.
            temperature: (n, w) K at the other times; below ambient counts as ambient.

        Returns:
            deflection (n,) m, zeros for a rig that does not bend, and force (n, w) N.

        Raises:
            InputError: shapes that do not fit.
        """
        seconds, kelvin = np.asarray(time, dtype=float), np.asarray(temperature, dtype=float)
        if kelvin.shape != (len(seconds) - 1, self._kernel.wires):
            raise InputError(
                f"driven bench: temperature has shape {kelvin.shape}, expected "
                f"({len(seconds) - 1}, {self._kernel.wires})"
            )
        clock = self.state.clock
        volts = np.sqrt(np.maximum(kelvin - self._ambient, 0.0))
        held = np.vstack([volts, volts[-1:]])
        history, strain = self._kernel.run(seconds, held, self._memory)
        drift = zero_drift(self._parameters, clock + seconds[1:] - seconds[0])
        return strain[1, 1:] @ self._levers + drift, history[2, 1:] * self._section

    @property
    def state(self) -> State:
        """The present state, from which another bench may go on."""
        return self._kernel.state(self._memory)


def warmed_from_rest(parameters: Parameters, temperature: Array) -> State:
    """The state of a bench that was heated from rest to temperatures (w,) K, ambient at least."""
    ambient = float(parameters["environment.ambient_temperature"])
    bench = TemperatureDriven(parameters)
    share = np.linspace(0.0, 1.0, _RAMP_STEPS + 1)
    course = ambient + share[1:, np.newaxis] * np.maximum(temperature - ambient, 0.0)
    bench.run(share * _RAMP_STEP * _RAMP_STEPS, course)
    return bench.state

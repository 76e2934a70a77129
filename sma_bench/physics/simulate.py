"""Simulate a bench: whole voltage records at once, or live, step by step, with the same kernel."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics.bending import wire_section
from sma_bench.physics.boundary import Boundary, per_side, side_names
from sma_bench.physics.effects import active_effects
from sma_bench.physics.effects.ambient_drift import air as air_temperature
from sma_bench.physics.effects.deflection_drift import zero as zero_drift
from sma_bench.physics.electrical import current
from sma_bench.physics.heat import EnergyBalance, energy_balance
from sma_bench.physics.kernel import Kernel
from sma_bench.physics.rows import HEATING_EFFECTS
from sma_bench.physics.state import State

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Simulation:
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

    @cached_property
    def clock(self) -> Array:
        """(n,) s since the bench's start, summed as the core does, step by step."""
        return np.cumsum(np.concatenate([[self.started], np.diff(self.time)]))

    @cached_property
    def deflection(self) -> Array:
        """(n,) m, positive toward the front; zeros for a rig that does not bend."""
        return self.bending @ _levers(self.parameters, self.boundary)

    @cached_property
    def deflection_reading(self) -> Array:
        """(n,) m, what a sensor reads: the deflection, unless its zero drifts."""
        return self.deflection + zero_drift(self.parameters, self.clock)

    @cached_property
    def current(self) -> Array:
        """(n, w) A, eq. (3)."""
        return current(
            self.parameters, self.voltage, self.temperature, self.martensite_fraction
        )

    @cached_property
    def force(self) -> Array:
        """(n, w) N, tension positive, eq. (13)."""
        return self.stress * wire_section(self.parameters)

    def energy_balance(self) -> EnergyBalance:
        """Energies of every step and wire, eq. (1).

        Raises:
            InputError: an effect other than latent heat changes how the wires are heated.
        """
        others = [n for n in active_effects(self.parameters) if n in HEATING_EFFECTS]
        if others:
            raise InputError(f"energy balance: {others[0]} is on, expected latent_heat at most")
        return energy_balance(
            self.parameters,
            self.time,
            self.voltage,
            self.temperature,
            self.martensite_fraction,
            self.parameters["effect.latent_heat.heat"],
        )


def simulate(
    parameters: Parameters,
    time: ArrayLike,
    voltage: ArrayLike,
    *,
    initial: State | None = None,
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
        boundary: the rig's own when not given: one wire is clamped, several bend the composite.

    Raises:
        InputError: wrong shape, time that does not increase, a number that is not finite.
    """
    kernel = Kernel(parameters, boundary)
    seconds, volts = _checked_input(time, voltage, kernel.wires)
    memory = kernel.memory(initial)
    history, strain = kernel.run(seconds, volts, memory)
    temperature, fraction, sigma, reading = history
    contraction, bending = strain
    return Simulation(
        parameters, kernel.boundary, seconds, volts, temperature, fraction, sigma, contraction,
        bending, reading, kernel.state(memory), initial.clock if initial else 0.0,
    )


class Bench:
    """The same bench stepped live; the simulator node turns its time into a clock."""

    def __init__(
        self,
        parameters: Parameters,
        *,
        initial: State | None = None,
        boundary: Boundary | None = None,
    ) -> None:
        """A bench at rest, or in the state `initial`; arguments as for `simulate`."""
        self.parameters = parameters
        self._kernel = Kernel(parameters, boundary)
        self._memory = self._kernel.memory(initial)
        self._state = self._kernel.state(self._memory)
        self._levers = _levers(parameters, self._kernel.boundary)
        self._section = wire_section(parameters)

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
        """(w,) N, tension positive."""
        return self._state.stress * self._section

    @property
    def contraction(self) -> Array:
        """(s,), sides in the order of `side_names`."""
        return self._state.contraction

    @property
    def deflection(self) -> float:
        """Deflection [m], positive toward the front."""
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

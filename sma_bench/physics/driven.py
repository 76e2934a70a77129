"""The bench with its heat taken away: wires pass through given temperatures, and the rest follows.

The same core as everywhere. A wire without heat capacity is where its heating settles it at the end
of every step, so a heating is chosen that settles it at the temperature that is wanted.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at
from sma_bench.physics.bending import wire_section
from sma_bench.physics.boundary import per_side, side_names
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.deflection_drift import zero as zero_drift
from sma_bench.physics.kernel import Kernel
from sma_bench.physics.rows import HEATING_EFFECTS
from sma_bench.physics.state import State

Array = NDArray[np.float64]

_NO_TIME = 1e-9  # s, time constant of such a wire
_RAMP_STEP = 1e-3  # s
_RAMP_STEPS = 200


class TemperatureDriven:
    """Transformation, stress and bending of a bench whose temperatures are given."""

    def __init__(self, parameters: Parameters, initial: State | None = None) -> None:
        """At rest, or in the state `initial`; effects on the heating are left out."""
        heating = (*HEATING_EFFECTS, "latent_heat")
        without = [p for name in heating for p in EFFECTS[name].parameters]
        self._parameters = parameters.replace({p.name: p.default for p in without})
        self._kernel = Kernel(self._parameters, None)
        wires = self._kernel.rows[0]
        wires[:, at.TIME_CONSTANT], wires[:, at.HEATING] = _NO_TIME, 1.0
        self._memory = self._kernel.memory(initial)
        self._ambient = float(parameters["environment.ambient_temperature"])
        self._levers = per_side("lever", self._kernel.boundary.lever, len(side_names(parameters)))
        self._section = wire_section(parameters)

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

"""The compiled core as Python sees it: parameters converted once, its rows filled and read."""

import numpy as np
from numpy.typing import NDArray

from sma_bench.compiled import Meanwhile, warn_if_plain
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.physics import columns as at
from sma_bench.physics import core
from sma_bench.physics.boundary import Boundary, per_side
from sma_bench.physics.otherwise import see
from sma_bench.physics.rows import side_rows, wire_rows
from sma_bench.physics.state import State, initial_state

Array = NDArray[np.float64]

RUN = Meanwhile(core.run)

class Kernel:
    """Parameters converted once for the compiled core, and the core's calls."""

    def __init__(self, parameters: Parameters, boundary: Boundary | None) -> None:
        warn_if_plain()
        self.parameters = parameters
        self.boundary = boundary or Boundary.of(parameters)
        self.wires = len(parameters["bench.channels"])
        self.rows = wire_rows(parameters), side_rows(parameters, self.boundary)

    def memory(self, initial: State | None) -> tuple[Array, Array]:
        """Fresh rows of the kernel: constants of this bench, state of `initial`."""
        state = initial or initial_state(self.parameters, boundary=self.boundary)
        wires, sides = self.rows[0].copy(), self.rows[1].copy()
        if state.temperature.shape != (len(wires),) or state.contraction.shape != (len(sides),):
            raise InputError(
                f"initial state: {state.temperature.size} wires on {state.contraction.size} sides, "
                f"expected {len(wires)} on {len(sides)}"
            )
        if state.memory is not None:
            wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :] = state.memory
        else:
            wires[:, at.TEMPERATURE] = state.temperature
            wires[:, at.FRACTION] = state.martensite_fraction
            wires[:, at.MOST_AUSTENITE] = 1.0 - state.martensite_fraction
            wires[:, at.STRESS] = state.stress
            sides[:, at.PASSIVE_FRACTION] = 1.0
            for column in (at.CONTRACTION, at.BENDING, at.RELAXED):
                sides[:, column] = state.contraction
            for i in range(len(wires)):
                wires[i, [at.READING, at.SEEN]] = see(wires, i)
        # Of effects that may be off by now:
        wires[:, at.OFFSET] = 0.0
        sides[sides[:, at.ENGAGEMENT] == 0.0, at.PASSIVE_BENDING] = 0.0
        if self.boundary.contraction is not None:
            given = per_side("contraction", self.boundary.contraction, len(sides))
            sides[:, at.CONTRACTION], sides[:, at.CONTRACTION_CHANGE] = given, 0.0
        return wires, sides

    def run(self, time: Array, voltage: Array, memory: tuple[Array, Array]) -> tuple[Array, Array]:
        """Advance `memory` in place; history (4, n, w) and strain (2, n, s) as of core.run."""
        history = np.empty((4, time.size, self.wires))
        strain = np.empty((2, time.size, len(memory[1])))
        RUN(time, voltage, *memory, history, strain)
        return history, strain

    def state(self, memory: tuple[Array, Array]) -> State:
        """Snapshot of the kernel's state."""
        wires, sides = memory[0].copy(), memory[1].copy()
        return State(
            wires[:, at.TEMPERATURE],
            wires[:, at.FRACTION],
            wires[:, at.STRESS],
            sides[:, at.CONTRACTION],
            (wires[:, at.WIRE_STATE :], sides[:, at.SIDE_STATE :]),
        )



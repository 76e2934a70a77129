"""The baseline model: heat, phase, stress, bending; simulated by a compiled core."""

from sma_bench.physics.bending import bending_coefficients
from sma_bench.physics.boundary import Boundary, side_names
from sma_bench.physics.kernel import State, initial_state
from sma_bench.physics.simulate import Bench, Simulation, simulate

__all__ = ["Bench", "Boundary", "Simulation", "State", "bending_coefficients", "initial_state",
           "side_names", "simulate"]  # fmt: skip

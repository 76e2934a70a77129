"""Controllers of the bench, without ROS: readings and references in, volts out."""

from sma_bench.control.deflection import DeflectionController
from sma_bench.control.temperature import PI, Gains, TemperatureController

__all__ = ["PI", "DeflectionController", "Gains", "TemperatureController"]

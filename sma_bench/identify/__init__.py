"""Parameters from records: one file per experiment of the paper, or per kind of staircase."""

from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.identification import EXPERIMENTS, identify
from sma_bench.identify.result import Experiment, Identification

__all__ = ["EXPERIMENTS", "Estimate", "Experiment", "Identification", "identify"]

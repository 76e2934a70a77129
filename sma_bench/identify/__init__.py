"""Parameters from records, a file an experiment of the paper, or those that a staircase tells."""

from sma_bench.estimation.estimate import Estimate
from sma_bench.identify.identification import EXPERIMENTS, identify
from sma_bench.identify.result import Experiment, Identification

__all__ = ["EXPERIMENTS", "Estimate", "Experiment", "Identification", "identify"]

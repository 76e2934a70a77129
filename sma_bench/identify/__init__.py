"""Parameters from records, one file an experiment of the paper."""

from sma_bench.identify.estimate import Estimate, Experiment
from sma_bench.identify.identification import EXPERIMENTS, Identification, identify

__all__ = ["EXPERIMENTS", "Estimate", "Experiment", "Identification", "identify"]

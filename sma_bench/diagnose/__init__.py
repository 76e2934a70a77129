"""Diagnosis of the gap between a bench and its model."""

from sma_bench.diagnose.diagnosis import Diagnosis, diagnose

__all__ = ["Diagnosis", "diagnose"]

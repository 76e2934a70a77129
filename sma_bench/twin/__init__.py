"""The model beside the bench: predictions, residuals, and where a gap between the two grows."""

from sma_bench.twin.twin import Twin, compile_model

__all__ = ["Twin", "compile_model"]

"""The model beside the bench: predictions, residuals, and where a gap between the two grows."""

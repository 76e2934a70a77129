"""Parameters of the whole model from a record of it: the composite, a wire in a load frame."""

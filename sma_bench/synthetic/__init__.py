"""What the instruments of the paper would write down if its wire obeyed the model. Synthetic."""

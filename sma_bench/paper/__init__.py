"""The paper: its figures and tables redrawn, its errata next to what is computed instead."""

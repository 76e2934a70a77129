"""The paper: its figures and tables redrawn, its slips beside what is computed instead."""

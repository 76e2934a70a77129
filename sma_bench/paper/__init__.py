"""The paper: its figures and tables redrawn, its errata beside what is computed instead."""

"""Benches and instruments with faults, made without any of the package's physics."""

"""Simulated benches and instruments with faults, without any physics of the package."""

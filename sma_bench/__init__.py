"""Test bench software for shape-memory-alloy actuators (Keshtkar et al.)."""

__version__ = "0.1.0"

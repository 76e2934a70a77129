"""The kernel against a stiff solver on the same model, written independently (stiff_solver.py)."""

import numpy as np
import pytest
from stiff_solver import Wires, solve, triangle

from sma_bench.physics import bending_coefficients, simulate

SIGNALS = ("temperature", "martensite_fraction", "stress", "contraction")


def assert_agree(run, reference, relative):
    for name in SIGNALS:
        span = np.ptp(reference[name])
        error = np.abs(getattr(run, name) - reference[name]).max()
        assert error <= relative * span, f"{name}: {error:g} of {span:g}"


def composite_wires(rig, latent_heat=0.0):
    alpha, front, back = bending_coefficients(rig)
    return Wires(rig, np.array([0, 0, 1, 1]), alpha * np.array([front, back]), latent_heat)


def composite_voltage(time):
    wave = triangle(time, 6.25, 10.0)
    return np.stack([wave, 0.95 * wave, 0.8 * wave[::-1], wave], axis=1)


def test_clamped_wire_agrees_with_lsoda(wire_rig):
    time = np.arange(0.0, 12.01, 0.5)
    voltage = triangle(time, 6.25, 12.0)[:, np.newaxis]
    reference = solve(Wires(wire_rig, np.array([0]), None), time, voltage, 1e-12)
    assert np.ptp(reference["martensite_fraction"]) > 0.2
    assert_agree(simulate(wire_rig, time, voltage), reference, 1e-9)


def test_composite_of_four_wires_agrees_with_lsoda(composite_rig):
    time = np.arange(0.0, 20.01, 0.5)
    voltage = composite_voltage(time)
    reference = solve(composite_wires(composite_rig), time, voltage)
    assert np.ptp(reference["martensite_fraction"]) > 0.9
    assert_agree(simulate(composite_rig, time, voltage), reference, 1e-7)


def test_latent_heat_converges_to_the_stiff_solver_with_the_square_of_the_step(composite_rig):
    time = np.arange(0.0, 10.01, 0.5)
    voltage = composite_voltage(time)
    reference = solve(composite_wires(composite_rig, 9e3), time, voltage)
    errors = []
    for parts in (8, 16, 32):
        fine = np.arange((len(time) - 1) * parts + 1) * 0.5 / parts
        held = np.repeat(voltage, parts, axis=0)[: len(fine)]
        run = simulate(composite_rig.replace({"effect.latent_heat.heat": 9e3}), fine, held)
        errors.append(np.abs(run.temperature[::parts] - reference["temperature"]).max())
    assert errors[-1] < 3e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=1.0)
    assert errors[1] / errors[2] == pytest.approx(4.0, abs=1.0)

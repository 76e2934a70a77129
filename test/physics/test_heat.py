"""Heat: the equations, the closed-form responses, the energy balance."""

import numpy as np
import pytest

from sma_bench.physics import heat, simulate


def test_steady_temperature_inverts_the_heat_transfer_coefficient(wire_rig):
    voltage = np.array([0.5, 2.0, 6.25])
    temperature = heat.steady_temperature(voltage, wire_rig)
    assert heat.temperature_rate(temperature, voltage, wire_rig) == pytest.approx(0.0, abs=1e-10)
    # Eq. (4), with Table I's R, A_c and T_inf.
    h = voltage**2 / (2.6987 * 395.84e-6 * (temperature - 296.15))
    assert h == pytest.approx(403.26)
    # 6.25^2/(2.6987 * 403.26 * 395.84e-6) = 90.677 K
    assert temperature[-1] - 296.15 == pytest.approx(90.677, abs=1e-3)


def held_voltage_response(start, voltage, elapsed, wire):
    """T [K] after `elapsed` [s] at a held voltage [V] from `start` [K]: eq. (2) solved."""
    steady = heat.steady_temperature(voltage, wire)
    return steady + (start - steady) * np.exp(-elapsed / heat.time_constant(wire))


@pytest.mark.parametrize("period", [0.05, 0.17, 4.0])
def test_temperature_does_not_depend_on_the_sampling_of_a_held_voltage(wire_rig, period):
    time = np.arange(0.0, 24.0001, period)
    voltage = np.where(time < 12.0, 4.0, 1.0)[:, np.newaxis]
    run = simulate(wire_rig, time, voltage)
    change = time[np.argmax(time >= 12.0)]
    hot = held_voltage_response(296.15, 4.0, change, wire_rig)
    end = held_voltage_response(hot, 1.0, time[-1] - change, wire_rig)
    assert run.temperature[-1, 0] == pytest.approx(float(end), rel=1e-12)


def test_sampled_sine_of_heating_follows_the_closed_form(wire_rig):
    # Heating power p0 (1 + cos wt): first-order low-pass of known gain and phase.
    omega, tau = 2.0, heat.time_constant(wire_rig)
    time = np.arange(0.0, 12.0, 1e-4)
    mid = time + 0.5e-4
    voltage = np.sqrt(9.0 * (1.0 + np.cos(omega * mid)))[:, np.newaxis]
    run = simulate(wire_rig, time, voltage)
    rise = float(heat.steady_temperature(3.0, wire_rig)) - 296.15
    late = time > 20 * tau
    gain, lag = 1.0 / np.hypot(1.0, omega * tau), np.arctan(omega * tau)
    closed = 296.15 + rise * (1.0 + gain * np.cos(omega * time[late] - lag))
    assert run.temperature[late, 0] == pytest.approx(closed, abs=1e-6)


@pytest.mark.parametrize("latent_heat", [0.0, 12e3])
def test_energy_balance_closes_in_every_step(wire_rig, composite_rig, latent_heat):
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.uniform(0.01, 0.4, 2000))
    for rig in (wire_rig, composite_rig):
        voltage = rng.uniform(0.0, 6.5, (2000, len(rig["bench.channels"])))
        run = simulate(rig.replace({"effect.latent_heat.heat": latent_heat}), time, voltage)
        balance = run.energy_balance()
        scale = np.abs(balance.stored).max()
        assert np.abs(balance.imbalance).max() < 1e-11 * scale
        assert (np.ptp(balance.latent) > 0.01 * scale) == (latent_heat > 0.0)

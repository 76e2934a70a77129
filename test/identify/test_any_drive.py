"""E0: what a drive that was made for something else tells of R, h and c_p. Synthetic records, of
eq. (2) in closed form between the samples."""

import numpy as np
import pytest

import sma_bench
from sma_bench.errors import InputError

TRUTH = {
    "wire.resistance": 3.0, "wire.heat_transfer_coefficient": 80.0, "wire.specific_heat": 500.0
}  # fmt: skip
LAB = {
    "bench.channels": ["wire"], "bench.channel_sides": ["front"], "wire.mass": 0.09e-3,
    "wire.surface_area": 236e-6, "wire.resistance": 3.3, "wire.heat_transfer_coefficient": 60.0,
    "wire.specific_heat": 450.0, "uncertainty.wire.resistance": 0.3,
    "uncertainty.wire.heat_transfer_coefficient": 30.0, "uncertainty.wire.specific_heat": 150.0,
}  # fmt: skip
RATE, ROOM = 20.0, 296.0


def on_wait_off(time, rng):
    return np.where((time > 5.0) & (time < 40.0), 0.9, 0.0)


def random_binary(time, rng):
    return 0.9 * np.repeat(rng.integers(0, 2, len(time) // 50 + 1), 50)[: len(time)]


def record_of(drive, quantities=("voltage", "current", "temperature"), seed=1):
    """A wire that follows m c_p dT/dt = V^2/R - h A_c (T - T_inf), its readings with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 80.0, 1.0 / RATE)
    volts = drive(time, rng)
    loss = TRUTH["wire.heat_transfer_coefficient"] * LAB["wire.surface_area"]
    left = np.exp(-loss / (LAB["wire.mass"] * TRUTH["wire.specific_heat"]) / RATE)
    rise = np.zeros(len(time))
    for k in range(1, len(time)):
        steady = volts[k - 1] ** 2 / TRUTH["wire.resistance"] / loss
        rise[k] = steady + (rise[k - 1] - steady) * left
    read = {
        "voltage": volts,
        "current": volts / TRUTH["wire.resistance"] + 0.002 * rng.standard_normal(len(time)),
        "temperature": ROOM + rise + 0.2 * rng.standard_normal(len(time)),
    }
    signals = {f"wire.{name}": (time, read[name]) for name in quantities}
    return sma_bench.load(signals)


@pytest.mark.parametrize("drive", [on_wait_off, random_binary])
def test_any_drive_that_excites_gives_resistance_loss_and_heat(drive):
    found = sma_bench.identify(record_of(drive), LAB)
    assert "E0" in [e.name for e in found.experiments]
    for name, true in TRUTH.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, abs=3.0 * estimate.std)
        assert estimate.std < 0.15 * true
        assert estimate.informed > 0.8
    assert not found.is_misfit
    better = next(f.text for e in found.experiments for f in e.findings if f.subject == "E0")
    assert all(name in better for name in ("E1", "E2", "E3"))


def test_of_a_current_alone_comes_the_resistance_and_no_heat_loss():
    found = sma_bench.identify(record_of(random_binary, ("voltage", "current")), LAB)
    assert set(found.estimates) == {"wire.resistance"}
    estimate = found.estimates["wire.resistance"]
    assert estimate.value == pytest.approx(3.0, abs=3.0 * estimate.std)


@pytest.mark.parametrize(
    ("drive", "quantities"),
    [
        (lambda time, rng: 0.0 * time, ("voltage", "current", "temperature")),
        (random_binary, ("voltage",)),
    ],
)
def test_a_wire_at_rest_or_not_read_has_nothing_to_identify(drive, quantities):
    with pytest.raises(InputError, match="E0"):
        sma_bench.identify(record_of(drive, quantities), LAB)

"""E0: what a drive that was made for something else tells of R, h and c_p."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from wire_records import Sensors, Wire, record_of

import sma_bench
from sma_bench.errors import InputError

TRUTH = {"wire.resistance": 3.0, "wire.heat_transfer_coefficient": 80.0,
         "wire.specific_heat": 500.0}  # fmt: skip
LAB = {"bench.channels": ["wire"], "bench.channel_sides": ["front"], "wire.mass": 0.09e-3,
       "wire.surface_area": 236e-6, "wire.resistance": 3.3, "wire.heat_transfer_coefficient": 60.0,
       "wire.specific_heat": 450.0, "uncertainty.wire.resistance": 0.3,
       "uncertainty.wire.heat_transfer_coefficient": 30.0,
       "uncertainty.wire.specific_heat": 150.0}  # fmt: skip


def on_wait_off(t):
    return np.where((t > 5.0) & (t < 40.0), 0.9, 0.0)


def random_binary(t):
    return 0.9 * np.random.default_rng(1).integers(0, 2, 33)[(t / 2.5).astype(int)]


def record_read(drive, quantities=("voltage", "current", "temperature")):
    wire = Wire(3.0, 80.0, 500.0, LAB["wire.mass"], LAB["wire.surface_area"], ambient=296.0)
    record = record_of(wire, Sensors(), 1, drive, 80.0, 0.05)
    signals = {name: record[name] for name in (f"wire.{q}" for q in quantities)}
    return replace(record, signals=signals)


@pytest.mark.parametrize("drive", [on_wait_off, random_binary])
def test_any_drive_that_excites_gives_resistance_loss_and_heat(drive):
    found = sma_bench.identify(record_read(drive), LAB)
    assert "E0" in [e.name for e in found.experiments]
    for name, true in TRUTH.items():
        estimate = found.estimates[name]
        assert estimate.value == pytest.approx(true, abs=3.0 * estimate.std)
        assert estimate.std < 0.15 * true
        assert estimate.informed > 0.8
    assert not found.is_misfit
    better = next(f.text for e in found.experiments for f in e.findings if f.subject == "E0")
    assert all(name in better for name in ("E1", "E2", "E3"))
    alone = sma_bench.identify(record_read(drive, ("voltage", "current")), LAB).estimates
    assert set(alone) == {"wire.resistance"}  # of a current comes no heat loss
    assert alone["wire.resistance"].value == pytest.approx(3.0, rel=0.03)


def test_a_wire_at_rest_or_not_read_has_nothing_to_identify():
    for record in (record_read(lambda t: 0.0 * t), record_read(random_binary, ("voltage",))):
        with pytest.raises(InputError, match="E0"):
            sma_bench.identify(record, LAB)

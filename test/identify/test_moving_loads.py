"""Wires that pull a weight, a spring or each other: identified from motion and voltage alone."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

import sma_bench
from examination.check import loads
from sma_bench.identify import identify, whole_model
from sma_bench.parameters import Parameters
from sma_bench.records import Record, Signal
from sma_bench.records.record import first_order_lag
from sma_bench.synthetic.bench_records import signals_of, simulate_finely

PAIR = {"bench.channels": ("left", "right"), "bench.channel_sides": ("front", "back")}
RIGS = {
    "beam": {"load.kind": "beam", "composite.deflection_per_strain": 1.0,
             "composite.stress_per_deflection_front": 2.5e9,
             "composite.stress_per_deflection_back": 2.5e9},
    "force": {"load.kind": "force", "load.force": 6.0},
    "spring": {"load.kind": "spring", "load.stiffness": 800.0, "load.preload": 6.0},
    "antagonist": {**PAIR, "load.kind": "antagonist", "load.stiffness": 200.0,
                   "load.preload": 6.0},
}  # fmt: skip
BELIEVED = {"wire.length": 0.2, "wire.stress_influence_austenite": 8e6,
            "wire.stress_influence_martensite": 8e6}  # fmt: skip
NOISE = 2e-5  # m
RATE = 25.0


def drives(shape, wires, duration=110.0):
    """Volts (n, w) up to 5.5: one wire after the other."""
    time = np.arange(0.0, duration, 1.0 / RATE)
    inside = ((time - 2.0) % 35.0) / 35.0
    shapes = {
        "triangle": 2.0 * np.minimum(inside, 1.0 - inside),
        "step": (inside < 0.5) * (0.6 + 0.4 * ((time // 35.0) % 2)),
        "sine": np.sin(np.pi * inside) ** 2,
    }
    volts = 5.5 * shapes[shape] * (time > 2.0)
    turn = (time // 35.0).astype(int) % wires
    return time, np.stack([volts * (turn == k) for k in range(wires)], axis=1)


def recorded(truth, shape, seed, keep=("voltage", "elongation", "deflection")):
    time, volts = drives(shape, len(truth["bench.channels"]))
    random = np.random.default_rng(seed)
    signals = {}
    for signal in signals_of(simulate_finely(truth, time, volts)):
        if signal.name.rsplit(".", 1)[-1] not in keep:
            continue
        noise = NOISE if "tion" in signal.name else 0.0
        values = signal.values + noise * random.standard_normal(len(signal.values))
        signals[signal.name] = Signal(signal.name, signal.unit, signal.time, values)
    return Record(Path(shape), 0, signals)


def drawn(believed, seed, sizes=1.0):
    """A bench as probable as any other under what is believed."""
    random = np.random.default_rng(seed)
    names = ["wire.resistance", "wire.heat_transfer_coefficient", "wire.specific_heat",
             "wire.austenite_start_temperature", "wire.austenite_finish_temperature",
             "wire.maximum_recoverable_strain"]  # fmt: skip
    names += [n for n in ("load.force", "load.stiffness", "load.preload") if believed[n]]
    moved = {n: believed[n] + sizes * believed.std(n) * random.standard_normal() for n in names}
    return believed.replace(moved)


def unseen_error(truth, found, shape):
    """Largest of the motion that was not fitted, in shares of the stroke."""
    time, volts = drives(shape, len(truth["bench.channels"]))
    here, there = (
        next(s for s in signals_of(simulate_finely(p, time, volts)) if "tion" in s.name)
        for p in (truth, found)
    )
    return np.sqrt(np.mean((here.values - there.values) ** 2)) / np.ptp(here.values)


@pytest.mark.parametrize("kind", ["force", "spring", "antagonist"])  # test_composite.py: beams
def test_motion_and_voltage_of_two_runs_predict_a_third(kind):
    believed = Parameters.of_paper().replace(
        {**BELIEVED, **RIGS[kind]}, {"load.stiffness": 40.0, "load.preload": 0.5}
    )
    truth = drawn(believed, seed=4)
    seen = [recorded(truth, shape, k) for k, shape in enumerate(("triangle", "step"))]
    found = identify(seen, believed)
    assert [e.name for e in found.experiments] == ["E10"]
    before, after = (unseen_error(truth, p, "sine") for p in (believed, found.parameters))
    assert after < min(0.01, 0.5 * before)
    for name, estimate in found.estimates.items():
        assert abs(estimate.value - truth[name]) < 4.0 * estimate.std, name
        assert estimate.std <= believed.std(name) * 1.0001
    assert max(estimate.informed for estimate in found.estimates.values()) > 0.9


def test_a_duty_is_recorded_as_the_direct_voltage_of_the_same_heat():
    duty = {"bench.drive": "duty", "bench.supply_voltage": 12.0}
    believed = Parameters.of_paper().replace({**BELIEVED, **RIGS["spring"]})
    switched = believed.replace(duty)
    time, volts = drives("triangle", 1)
    direct = signals_of(simulate_finely(believed, time, np.sqrt(12.0 * volts)))
    for signal, other in zip(
        direct, signals_of(simulate_finely(switched, time, volts)), strict=True
    ):
        assert signal.values == pytest.approx(other.values, rel=1e-9, abs=1e-12), signal.name
    record = recorded(switched, "triangle", 1)
    again = sma_bench.simulate(record, switched)
    assert again.elongation == pytest.approx(sma_bench.simulate(record, believed).elongation)


def test_a_current_source_needs_no_voltmeter():
    rises = {"effect.phase_dependent_resistance.austenite_change": -0.1}
    believed = Parameters.of_paper().replace(
        {**BELIEVED, **RIGS["spring"], "bench.drive": "current"}
    )
    truth = drawn(believed, seed=6).replace(rises)
    seen, unseen = (recorded(truth, s, 1, ("current", "elongation")) for s in ("triangle", "sine"))
    assert "wire.voltage" not in seen.signals
    exact = sma_bench.simulate(unseen, truth).elongation[:, 0]
    assert exact == pytest.approx(unseen["elongation"].values, abs=6.0 * NOISE)
    found = identify([seen], believed).parameters
    before, after = (
        np.std(sma_bench.simulate(unseen, p).elongation[:, 0] - exact) for p in (believed, found)
    )
    assert after < min(0.01 * np.ptp(exact), 0.2 * before)


@pytest.mark.slow
def test_two_runs_of_another_reality_predict_five_of_other_shapes(monkeypatch):
    """Of which the wire has latent heat, free convection and a resistance that changes.

    `./bench check loads` plays the other loads.
    """
    monkeypatch.setattr(whole_model, "starts", lambda unknowns: [unknowns.start()])
    found = loads.try_bench(("spring", 7, "rich"))
    assert np.median(found["believed"]) > 5.0 * np.median(found["unseen"])
    assert np.median(found["unseen"]) < loads.MEDIAN and max(found["unseen"]) < loads.TAIL


def test_a_thermometer_that_lags_does_not_make_another_wire():
    believed = Parameters.of_paper().replace({**BELIEVED, **RIGS["beam"]})
    truth = drawn(believed, seed=4)
    random = np.random.default_rng(8)
    kept = np.exp(-1.0 / (RATE * 1.2))  # a thermocouple of 1.2 s
    seen = []
    for shape in ("triangle", "step"):
        record = recorded(truth, shape, 3, ("voltage", "deflection", "temperature"))
        hot = record["wire.temperature"]
        read = first_order_lag(hot.values, kept, hot.values[0])
        read = read + 0.1 * random.standard_normal(len(read))
        signals = {**record.signals, hot.name: Signal(hot.name, hot.unit, hot.time, read)}
        seen.append(Record(record.path, 0, signals))
    found = identify(seen, believed)
    lag = found.estimates["sensor.temperature.lag"]
    assert abs(lag.value - 1.2) < 0.02
    for name in ("wire.specific_heat", "wire.austenite_finish_temperature"):
        assert abs(found.estimates[name].value - truth[name]) < 3.0 * found.estimates[name].std
    assert {one.verdict for one in found.fit.values()} == {"ok"}

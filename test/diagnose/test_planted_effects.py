"""A planted effect is named and its size found with any set of sensors; without one none is named,
whatever the spectrum of the noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted import (
    ALL,
    CHANNELS,
    DURATION,
    FEW,
    FINER,
    NOISE,
    ONE_WIRE,
    RATE,
    believed,
    drive,
    few_effects,
    planted_pair,
    planted_record,
    true_bench,
)

from sma_bench.diagnose import diagnose
from sma_bench.estimation.observation import STATES, observe_all
from sma_bench.estimation.unknowns import LAW_EFFECT
from sma_bench.physics import simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record, Signal

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

VISCOUS = "effect.viscoelastic_matrix"
CASES = [
    ({f"{VISCOUS}.relaxation": 0.25, f"{VISCOUS}.time_constant": 5.0}, ALL, FEW),
    # With all effects as candidates, from the deflection alone.
    ({"effect.residual_strain.share": 0.12}, ("deflection",), tuple(EFFECTS)),
    ({"effect.residual_strain.share": 0.12, "effect.residual_strain.recovery": 0.05}, ALL[1:],
     ("residual_strain", "transition_drift", "viscoelastic_matrix")),
    ({"effect.supply_drop.battery": 0.6, "effect.supply_drop.battery_time": 8.0}, ALL,
     ("supply_drop", "ambient_drift", "phase_dependent_resistance")),
    ({"effect.supply_drop.threshold": 0.4}, ALL,
     ("supply_drop", "ambient_drift", "temperature_underfill", "phase_dependent_resistance")),
    ({"effect.opposing_wires.buckled": 0.6, "effect.opposing_wires.gap": 0.002,
      "effect.opposing_wires.detwinning_stress": 60e6}, ALL[1:],
     ("opposing_wires", "stress_dependent_transition", "side_asymmetry")),
    ({"effect.slack.rubbing_strain": 0.002, "effect.slack.friction": 5e6}, ALL[1:],
     ("slack", "residual_strain", "transition_drift")),
]
COUPLING = {"effect.side_heat_coupling.conductance": 0.002}


def expect(result, numbers):
    name = next(iter(numbers)).split(".")[1]
    assert (result.verdict, result.cause) == ("effect", (name,))
    first = result.to_json()["candidates"][0]
    assert first["stage"] == EFFECTS[name].stage
    for number, true in numbers.items():
        found = first["parameters"][number]
        assert abs(found["value"] - true) < 4.0 * found["std"], number
        assert found["std"] < 0.15 * true, number


@pytest.mark.slow
@pytest.mark.parametrize(("numbers", "quantities", "library"), CASES,
                         ids=["viscous", "strained", "recovering", "battery", "transistor",
                              "detwinning", "rubbing"])
def test_a_planted_effect_is_named_and_measured(numbers, quantities, library, tmp_path):
    seen, unseen = planted_pair(tmp_path, numbers, quantities=quantities)
    with few_effects(library):
        result = diagnose(seen, believed(), unseen)
    expect(result, numbers)
    deflection = result.shrinkage["deflection"]
    assert deflection.fraction > 0.8
    assert deflection.rmse_after < 0.3 * deflection.rmse_before
    shown = {name for name in library if set(EFFECTS[name].acts_on) & set(quantities)}
    competing = {c.name for c in result.candidates} | {LAW_EFFECT}  # part of every candidate
    assert shown | {"recalibration", "no_gap", "unexplained"} <= competing


@pytest.mark.slow
def test_residual_strain_is_carried_over_into_the_next_record():
    """Two records of one run with a rest between them: wires of the second were heated before."""
    numbers, random = {"effect.residual_strain.share": 0.12}, np.random.default_rng(3)
    bench, fine = true_bench(numbers), FINER * RATE
    (time, volts), (_, turned) = drive(rate=fine), drive(turned=True, rate=fine)
    both = np.vstack([volts, turned])
    steps = 0.5 * (both + np.vstack([both[1:], both[-1:]]))
    tip = simulate(bench, np.append(time, 2 * DURATION + time), steps).deflection
    records, begin = [], 1_760_000_000
    halves = zip(("first", "second"), (volts, turned), np.split(tip, 2), strict=True)
    for name, driven, moved in halves:
        noise = NOISE["deflection"] * random.standard_normal(len(moved))
        read = {"deflection": ("m", moved + noise)}
        read |= {f"{c}.voltage": ("V", v) for c, v in zip(CHANNELS, driven.T, strict=True)}
        signals = {n: Signal(n, unit, time[::FINER], v[::FINER]) for n, (unit, v) in read.items()}
        records.append(Record(Path(name), begin * 10**9, signals))
        begin += int(2 * DURATION)
    carried = bench.replace({"effect.residual_strain.fresh_start": 0.0})
    _, second = observe_all(records, believed())
    there = second.readings(second.simulate(carried))
    assert np.std(second.signals[0].value - there) < 2.0 * second.signals[0].noise
    anew = second.readings(second.simulate(bench))
    assert np.std(second.signals[0].value - anew) > 10.0 * second.signals[0].noise

    with few_effects(("residual_strain", "transition_drift", "viscoelastic_matrix")):
        found = diagnose(records[:1], believed(), records[1:])
    expect(found, numbers)
    assert found.shrinkage["deflection"].fraction > 0.8


@pytest.mark.slow
@pytest.mark.parametrize(("switched", "lag"), [(0.46, 0.0), (0.46, 1.5)])
def test_a_slow_loggers_loop_is_no_lag_of_a_sensor(switched, lag):
    """A logger reads the voltage twice a second, and the drive always switches at the same moment
    between two readings; a real lag of the sensor is still found."""
    lab = believed().replace(ONE_WIRE)
    bench, records = lab.replace({"effect.temperature_lag.time_constant": lag}), []
    for name, seed in (("seen", 1), ("unseen", 2)):
        random, time = np.random.default_rng(seed), np.arange(0.0, 100.0, 0.005)
        levels = np.append(0.0, random.uniform(0.5, 3.0, 10))
        volts = levels[np.searchsorted(np.arange(5.0, 100.0, 10.0) + switched, time, "right")]
        read = simulate(bench, time, volts).temperature_reading[::10, 0]
        read = read + NOISE["temperature"] * random.standard_normal(len(read))
        signals = {"wire.voltage": Signal("wire.voltage", "V", time[::100], volts[::100]),
                   "wire.temperature": Signal("wire.temperature", "K", time[::10], read)}
        records.append(Record(Path(name), 0, signals))
    with few_effects(("temperature_lag", "latent_heat", "supply_drop")):
        found = diagnose(records[:1], lab, records[1:])
    if lag:
        assert found.candidates[0].effects == ("temperature_lag",)
        size = found.to_json()["candidates"][0]["parameters"]
        assert size["effect.temperature_lag.time_constant"]["value"] == pytest.approx(lag, rel=0.1)
    else:
        assert found.verdict in ("no_gap", "recalibration")
        assert found.effects["temperature_lag"] < 0.1


def test_heat_coupling_between_sides_is_found_and_located_with_all_sensors(planted_diagnosis):
    expect(planted_diagnosis, COUPLING)
    ((number, size),) = COUPLING.items()
    assert planted_diagnosis.improved[number] == pytest.approx(size, rel=0.05)
    assert 0.0 < planted_diagnosis.improved.std(number) < 0.5 * size
    where = planted_diagnosis.to_json()["where"]
    assert where["stage"] == "thermal"
    currents = [c for c in planted_diagnosis.where.table if c.signal.endswith("current")]
    warm = [c for c in planted_diagnosis.where.table if c.signal.endswith("temperature")]
    assert max(c.gap for c in currents) < 0.05 < 2.0 < max(c.gap for c in warm)
    assert sum(c.share for c in planted_diagnosis.where.table) == pytest.approx(1.0)


def test_the_gap_shrinks_on_the_record_that_was_held_out(planted_diagnosis):
    assert [v.path.endswith("unseen") for v in planted_diagnosis.held_out] == [True]
    for quantity in ("temperature", "deflection"):
        s = planted_diagnosis.shrinkage[quantity]
        assert s.fraction > 0.9 and s.ci90[0] <= s.fraction <= s.ci90[1] <= 1.0
        assert s.rmse_after == pytest.approx(s.noise_floor, rel=0.15)
        assert s.rmse_before > 3.0 * s.noise_floor
    # The residual of the effect's fit is noise.
    model = planted_diagnosis.model
    white = model.problem.whiten(model.residual)
    assert white.std() == pytest.approx(1.0, abs=0.1)
    assert planted_diagnosis.search.beyond.gain < 10.0


@pytest.mark.slow
def test_wrong_parameters_and_a_drifting_sensor_are_not_taken_for_an_effect(tmp_path):
    seen, unseen = planted_pair(tmp_path, kind="drifting", quantities=ALL[1:])
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    assert result.verdict in ("recalibration", "no_gap")
    assert result.cause == ()
    assert sum(c.probability for c in result.candidates if c.effects) < 0.35


def test_a_bench_that_is_as_stated_has_no_gap(tmp_path):
    seen, unseen = planted_pair(tmp_path, quantities=("deflection",), bench=believed())
    with few_effects():
        result = diagnose(seen, believed(), unseen)
    assert result.verdict == "no_gap"
    assert result.improved == result.parameters
    deflection = result.shrinkage["deflection"]
    assert deflection.rmse_after == deflection.rmse_before
    assert deflection.rmse_before == pytest.approx(deflection.noise_floor, rel=0.1)


def test_a_wrong_parameter_is_named_and_no_effect_that_acts_alike(tmp_path):
    lab, name = believed(), "wire.stress_influence_austenite"
    bench = lab.replace({name: lab[name] + 5.0 * lab.std(name)})
    quantities = ("temperature", "deflection")
    record = planted_record(tmp_path / "bag", {}, quantities=quantities, bench=bench)
    with few_effects(("stress_dependent_transition", "side_heat_coupling")):
        result = diagnose([record], lab)
    assert result.verdict == "recalibration"
    assert name in {moved.name for moved in result.moved}
    assert result.improved[name] == pytest.approx(bench[name], abs=2.0 * lab.std(name))


def test_a_supply_overloaded_at_a_small_current_is_found_without_a_recorded_current(tmp_path):
    """Wires that take a third of the current for the same heat."""
    lab, factors = believed(), {"wire.resistance": 3.0, "wire.heat_transfer_coefficient": 1 / 3.0,
                                "wire.mass": 1 / 3.0}
    lab = lab.replace({name: by * lab[name] for name, by in factors.items()},
                      {name: by * lab.std(name) for name, by in factors.items()})
    amperes = planted_record(tmp_path / "whole", bench=lab)["front_1.current"].values.max()
    gives_way = {"effect.supply_drop.overload": 1.2, "effect.supply_drop.knee": 0.6 * amperes}
    quantities = ("temperature", "deflection")
    record = planted_record(tmp_path / "bag", quantities=quantities, bench=lab.replace(gives_way))
    with few_effects(("supply_drop", "phase_dependent_resistance")):
        found = diagnose([record], lab)
    assert amperes < 0.5 and found.cause == ("supply_drop",)
    knee = found.to_json()["candidates"][0]["parameters"]["effect.supply_drop.knee"]
    assert abs(knee["value"] - 0.6 * amperes) < 4.0 * knee["std"] < amperes


ROOM, STROKE = "environment.ambient_temperature", "wire.maximum_recoverable_strain"


@pytest.mark.slow
@pytest.mark.parametrize("away", [{ROOM: 2.0}, {STROKE: 0.0008}], ids=["room", "stroke"])
def test_a_run_of_another_day_is_no_cause(away, tmp_path):
    """Air temperature, draughts and strokes differ from run to run; if each record drives another
    side, the difference could be taken for one of the sides."""
    bench, records = true_bench(), []
    for name, more in (("monday", {}), ("tuesday", {n: bench[n] + d for n, d in away.items()})):
        there, turned = bench.replace(more), bool(more)
        seed = 2 if turned else 1
        records.append(planted_record(tmp_path / name, bench=there, turned=turned, seed=seed))
    found = diagnose(records[:1], believed(), records[1:])
    assert found.verdict == "recalibration" and not found.cause
    assert max(found.effects.values()) < 0.1
    for quantity in ("temperature", "deflection"):
        shrunk = found.shrinkage[quantity]
        assert shrunk.rmse_recalibrated < 1.5 * shrunk.noise_floor
    (name,) = away
    (second,) = found.held_out
    size = 1.0 if name == ROOM else bench[name]
    assert second.away[name] * STATES[name] * size == pytest.approx(away[name], rel=0.5)
    assert any("tuesday" in line for line in found.record)


@pytest.mark.slow
def test_a_record_that_begins_with_warm_wires_is_compared_after_they_have_cooled(tmp_path):
    (seen,), (unseen,) = planted_pair(tmp_path, COUPLING)
    records = []
    for record in (seen, unseen):
        late = {
            n: Signal(n, s.unit, s.time[s.time >= 5.2] - 5.2, s.values[s.time >= 5.2])
            for n, s in record.signals.items()
        }  # the first side has just been driven
        records.append(replace(record, signals=late))
    found = diagnose(records[:1], believed(), records[1:])
    assert found.effects["deflection_drift"] < 0.05 and found.effects["ambient_drift"] < 0.1
    assert found.candidates[0].name == "side_heat_coupling"
    assert any("left out" in line for line in found.record)


def test_an_unset_zero_is_taken_from_the_rest_of_the_first_record(tmp_path):
    records, set_up = [], 0.006  # m, of a laser's housing
    for name, begin in (("first", 1_760_000_000), ("second", 1_760_000_600)):
        record = planted_record(tmp_path / name, quantities=("deflection",))
        tip = record["deflection"]
        # The second record rests bent, which is real.
        bent = 0.003 if records else 0.0
        signals = record.signals | {"deflection": replace(tip, values=tip.values + set_up + bent)}
        records.append(replace(record, start_ns=begin * 10**9, signals=signals))
    first, second = observe_all(records, believed())
    assert first.zeros["deflection"] == pytest.approx(set_up, abs=1e-4)
    assert abs(first.signals[0].value[:3].mean()) < 1e-4
    assert second.signals[0].value[:3].mean() == pytest.approx(0.003, abs=1e-4)
    assert "deflection" in first.remarks[0]
    zeroed = planted_record(tmp_path / "set", quantities=("deflection",))
    (alone,) = observe_all([zeroed], believed())
    assert not alone.zeros and not alone.remarks

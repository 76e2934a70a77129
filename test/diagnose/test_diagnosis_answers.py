"""The result: as in the contract, reproducible, from any set of sensors."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from planted import ALL, ONE_WIRE, believed, drive, few_effects, planted_record

from examination.bags import in_sqlite3
from examination.blind.case_files import checked_answer
from sma_bench.diagnose import decision, diagnose, diagnosis
from sma_bench.diagnose.decision import learnt
from sma_bench.diagnose.result import NextExperiment
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.protocols import parse_protocol
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.results import card, json_text

pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")

LOW = {"kind": "rest", "duration": 5.0}
HIGH = {"kind": "ramp", "start": 2.0, "stop": 2.0, "duration": 5.0}


@pytest.fixture(scope="module")
def wire_rig():
    return believed().replace(ONE_WIRE)


def test_the_answer_obeys_the_contract(planted_diagnosis):
    answer = checked_answer(json.loads(json_text(planted_diagnosis.to_json())))
    assert (answer.verdict, answer.cause) == ("effect", ("side_heat_coupling",))
    assert answer.where.stage == "thermal"
    assert set(answer.shrinkage) == {"current", "temperature", "deflection"}
    candidates = planted_diagnosis.candidates
    probabilities = [c.probability for c in candidates]
    assert math.fsum(probabilities) == pytest.approx(1.0, abs=1e-9)
    assert probabilities == sorted(probabilities, reverse=True)
    assert len({c.name for c in candidates}) == len(probabilities)
    # The credible ones are the first and all that are probable enough.
    credible, least = planted_diagnosis.credible, planted_diagnosis.least_credible
    assert least == learnt().least and len(credible) >= 1
    assert all(p >= least for p in probabilities[1 : len(credible)])
    assert all(p < least for p in probabilities[len(credible) :])
    assert credible == tuple(c.name for c in candidates[: len(credible)])


def test_an_experiment_names_causes_as_the_candidates_beside_another_law(monkeypatch,
                                                                         tmp_path):
    def proposed(candidates, *_):
        return NextExperiment("protocol", "to see", tuple(c.name for c in candidates), worth=0.5)

    monkeypatch.setattr(diagnosis, "next_experiment", proposed)
    monkeypatch.setattr(decision, "law_of", lambda fitted: (10.0, 50.0, {}))
    with few_effects():
        found = diagnose([planted_record(tmp_path / "bag")], believed())
    separates = found.next_experiment.separates
    assert set(separates) <= {c.name for c in found.candidates}
    assert any("transformation_law" in name for name in separates)


def test_a_bench_that_would_not_move_as_stated_is_recalibrated(tmp_path):
    # With the table's heat transfer, which nobody states, no wire would get warm enough to move.
    lab, unstated = believed(), {"wire.heat_transfer_coefficient", "wire.surface_area"}
    truth, steps = lab.replace({"wire.heat_transfer_coefficient": 150.0}), [LOW]
    for side, level in (("front", 3.0), ("back", 3.0), ("front", 2.4)):
        steps += [{"kind": "step", "drive": side, "level": level, "duration": 8.0}, LOW, LOW]
    protocol = parse_protocol({"name": "steps", "steps": steps}, truth)
    record = planted_record(tmp_path / "bag", quantities=ALL[2:], bench=truth, protocol=protocol)
    stated = {name: lab[name] for name in lab.given - unstated}
    stds = {name: std for name, std in lab.given_uncertainty.items() if name in stated}
    with few_effects():
        found = diagnose([record], Parameters(stated, stds))
    assert found.verdict == "recalibration"
    residual = found.search.recalibrated.residual
    assert residual.std() < 0.002 * np.ptp(record["deflection"].values)


def test_a_wire_rig_without_a_deflection_is_diagnosed(wire_rig, tmp_path):
    # Lead resistance and wire resistance both lower the current; only the heat tells them apart.
    truth = wire_rig.replace({"effect.supply_drop.resistance": 0.3, "wire.resistance": 2.71})
    record = planted_record(tmp_path / "bag", quantities=ALL[:2], bench=truth)
    with few_effects():
        wire_diagnosis = diagnose([record], wire_rig)
    checked_answer(json.loads(json_text(wire_diagnosis.to_json())))
    assert wire_diagnosis.cause == ("supply_drop",)
    found = wire_diagnosis.improved["effect.supply_drop.resistance"]
    assert found == pytest.approx(0.3, abs=0.05)
    assert {c.signal for c in wire_diagnosis.where.table} == {"wire.current", "wire.temperature"}
    # The last part of the single record is held out.
    border = 0.6 * drive()[0][-1]
    (unseen,), (seen,) = wire_diagnosis.held_out, wire_diagnosis.fitted
    assert min(s.time[0] for s in unseen.signals) >= border - 0.2
    assert max(s.time[-1] for s in seen.signals) < border + 0.2
    assert set(wire_diagnosis.shrinkage) == {"current", "temperature"}


def test_a_gap_that_a_drift_of_the_thermometer_may_explain_says_how_large(wire_rig, tmp_path):
    drifting = wire_rig.replace({"effect.ambient_drift.rate": 0.1})
    strong = wire_rig.replace({"effect.supply_drop.resistance": 0.3})
    found = []
    with few_effects(("ambient_drift", "supply_drop")):
        for k, bench in enumerate((drifting, strong)):
            record = planted_record(tmp_path / str(k), quantities=ALL[:2], bench=bench)
            found.append(diagnose([record], wire_rig))
    (drift,) = found[0].drifts
    assert drift.signal == "wire.temperature" and 0.5 < drift.needed < 2.0  # the air warms by 2 K
    assert "drift" in dict(card(found[0]).rows)
    assert not found[1].drifts


def test_records_of_different_sensors_are_diagnosed_together(tmp_path):
    tip = planted_record(tmp_path / "tip", quantities=("deflection",), bench=believed())
    more = planted_record(tmp_path / "more", quantities=("current", "deflection"), bench=believed(),
                          turned=True)
    with few_effects(("residual_strain",)):
        result, again = (diagnose([tip], believed(), [more]) for _ in range(2))
        alone = diagnose([tip], believed())
    assert set(result.shrinkage) == {"current", "deflection"}
    assert result.verdict != "effect"
    assert json_text(result.to_json()) == json_text(again.to_json())
    assert alone.not_compared == ("current", "temperature")


def test_no_record_one_that_ends_early_and_a_hold_out_that_is_fitted_too_are_refused(tmp_path):
    with pytest.raises(InputError, match="no record"):
        diagnose([], believed())
    record = planted_record(tmp_path / "bag", quantities=("deflection",), bench=believed())
    with pytest.raises(InputError, match="bag, which is fitted too; a hold-out must be of a run"):
        diagnose([record], believed(), [record])
    tip, first = record["deflection"], slice(len(record["deflection"]) // 3)
    early = replace(tip, time=tip.time[first], values=tip.values[first], received=None)
    short = replace(record, signals={**record.signals, "deflection": early})
    with few_effects(("residual_strain",)), pytest.raises(InputError, match="too few readings"):
        diagnose([short], believed())
    # The same samples under another name, in another storage.
    write_record(tmp_path / "copy", record)
    in_sqlite3(tmp_path / "copy")
    copy = read_record(tmp_path / "copy")
    with pytest.raises(InputError, match=r"copy: holds the samples of .*bag, which is fitted too"):
        diagnose([record], believed(), [copy])
    with pytest.raises(InputError, match=r"copy: holds the samples of .*bag; give the run once"):
        diagnose([record, copy], believed())


def test_a_record_with_swapped_runs_is_reported(wire_rig, tmp_path):
    made = []
    for k, steps in enumerate(([LOW, HIGH, LOW], [HIGH, LOW, HIGH])):
        protocol = parse_protocol({"name": "rise", "steps": steps}, wire_rig)
        options = {"quantities": ALL[:2], "bench": wire_rig, "protocol": protocol}
        made.append(planted_record(tmp_path / f"bag_{k}", **options))
    signals = {**made[0].signals, "wire.temperature": made[1]["wire.temperature"]}
    with few_effects(()):
        result = diagnose([replace(made[0], signals=signals)], wire_rig)
    assert any("runs or channels swapped" in f.text for f in result.findings)

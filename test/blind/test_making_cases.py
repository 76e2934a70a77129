"""A set is made: the same bytes from the same seed, good bags, labels measured and sealed."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

from examination.blind.case_files import unseal
from examination.blind.cases import EFFECTS, NUISANCE_LIMIT, OUTSIDE, QUANTITIES, draw_cases
from examination.blind.command import main
from examination.blind.judgement import UnseenRecord
from examination.blind.make import digest, make
from examination.blind.rigs import RECORDS, Stage
from sma_bench.errors import InputError
from sma_bench.parameters import read_parameters
from sma_bench.records import check_record, read_record

SEED, N = 3007, 5
PATIENCE = 240.0  # s; a loaded machine compiles for a minute, and cases begun are finished
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind") / "set"
    return folder, make(folder, SEED, N)


@pytest.fixture(scope="module")
def labels(made):
    folder, manifest = made
    return unseal(folder / "labels.sealed", manifest["sha256"])


def test_layout_and_manifest(made):
    folder, manifest = made
    assert sorted(p.name for p in folder.iterdir()) == ["cases", "labels.sealed", "manifest.json"]
    assert json.loads((folder / "manifest.json").read_text()) == manifest
    assert manifest["cases"] == [f"{k:04d}" for k in range(1, N + 1)]
    assert (manifest["seed"], manifest["n"], manifest["split"]) == (SEED, N, "open")
    for name in manifest["cases"]:
        inside = sorted(p.name for p in (folder / "cases" / name).iterdir())
        assert inside == ["hold_out", "nominal.yaml", "record"]


@pytest.mark.slow
def test_same_seed_gives_the_same_bytes_on_two_processes(made, tmp_path):
    folder, _ = made
    make(tmp_path / "again", SEED, N, jobs=2)
    assert digest(tmp_path / "again") == digest(folder)
    make(tmp_path / "other", SEED + 1, 1)
    first = Path("cases", "0001")
    assert digest(tmp_path / "other" / first) != digest(folder / first)


def test_bags_are_good_records_of_the_contract(made, labels):
    folder, _ = made
    for label in labels:
        for name in RECORDS:
            record = read_record(folder / "cases" / label["id"] / name)
            assert [f for f in check_record(record) if f.severity == "error"] == []
            kinds = {signal.rpartition(".")[2] for signal in record.signals}
            assert kinds == {"voltage", *QUANTITIES[label["signals"]]}
            assert 95.0 < record.duration < 121.0
            assert 48.0 < len(record["deflection"]) / record.duration < 50.0
        nominal = read_parameters(folder / "cases" / label["id"] / "nominal.yaml")
        assert nominal.given_uncertainty["wire.resistance"] == pytest.approx(
            0.01 * nominal["wire.resistance"], rel=0.01
        )


def test_severity_is_the_gap_that_the_records_have(made, labels):
    """Measured on the bags: record less the noise-free record without the effect, over the noise
    of the record less the noise-free record with it."""
    folder, _ = made
    checked = 0
    for label in labels:
        stage = Stage.from_label(label)
        if label["severity"] < 1.5 or label["kind"] == "recalibration":
            continue
        for name in RECORDS:
            best = max(label["gap"][name], key=lambda s: label["gap"][name][s])
            record = read_record(folder / "cases" / label["id"] / name)
            # Times of a record count from its first stamp.
            time = record[best].time + (record.start_ns - label["starts"][name]) * 1e-9
            clean, without = (stage.read(label[f], name)[best] for f in ("features", "base"))
            grid = stage.drives[name].grid(0.02)
            noise, gap = (
                record[best].values - np.interp(time, grid, read) for read in (clean, without)
            )
            extra = np.sqrt(max(np.mean(gap**2) - np.mean(noise**2), 0.0))
            std = stage.sensors.std(best.rpartition(".")[2])
            assert extra / std == pytest.approx(label["gap"][name][best], rel=0.25, abs=0.3)
            checked += 1
    assert checked >= 2


def test_labels_tell_what_was_dealt_and_where_it_shows(labels):
    for label, case in zip(labels, draw_cases(SEED, N), strict=True):
        assert label["kind"] == case.card.kind
        assert tuple(label["effects"]) == case.card.effects
        assert label["noise"] == case.card.noise
        assert label["nuisance_gap"] <= NUISANCE_LIMIT
        if label["kind"] == "none":
            assert label["severity"] == 0.0 and label["where"] is None
            continue
        assert label["severity"] == max(max(label["gap"][r].values()) for r in RECORDS)
        assert label["where"]["signal"] in QUANTITIES[label["signals"]]
        assert label["where"]["phase"] in ("drive", "rest", "initial")
        assert sum(row["share"] for row in label["where"]["table"]) <= 1.0 + 1e-3


def test_nothing_but_the_sealed_file_names_an_effect(made):
    folder, _ = made
    for path in folder.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            for name in (*EFFECTS, *OUTSIDE, "severity", "recalibration"):
                assert name.encode() not in content, path


@pytest.mark.parametrize(
    "arguments, line",
    [
        (["--seed", "1", "--n", "0"], "number of cases 0, expected 1 to"),
        (["--seed", "-1"], "seed -1, expected"),
        (["--seed", "1", "--jobs", "0"], "jobs 0, expected"),
        (["--seed", "1", "--out", "{made}"], "exists already"),
        (["--seed", "1", "--out", "{made}/manifest.json/x"], "cannot be made"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(made, tmp_path, capsys, arguments, line):
    folder, _ = made
    before = digest(folder)
    given = ["--out", str(tmp_path / "new"), *(a.format(made=folder) for a in arguments)]
    assert main(["make", *given]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len([text for text in said if text.startswith("bench blind:")]) == 1
    assert line in said[-1]
    assert digest(folder) == before
    assert list(tmp_path.iterdir()) == []


def test_failure_halfway_leaves_nothing(tmp_path, monkeypatch):
    def full(*arguments):
        raise InputError("the disk is full")

    monkeypatch.setattr("examination.blind.make.write_record", full)
    with pytest.raises(InputError, match="full"):
        make(tmp_path / "set", SEED, 1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("how, jobs", [(signal.SIGINT, 2), (signal.SIGTERM, 1)])
def test_cancelled_make_leaves_nothing_that_looks_whole(tmp_path, how, jobs):
    # Of this seed the first two cases hide nothing, which are made soonest.
    command = [sys.executable, "-m", "examination.blind.command", "make"]
    process = subprocess.Popen(
        [*command, "--seed", "9", "--n", "12", "--jobs", str(jobs), "--out", str(tmp_path / "set")],
        cwd=ROOT, stderr=subprocess.PIPE, start_new_session=True, text=True,
    )  # fmt: skip
    deadline = monotonic() + PATIENCE
    while not list(tmp_path.glob(".set.*/set/cases/0*")) and monotonic() < deadline:
        sleep(0.05)
    assert process.poll() is None  # begun, and many cases before its end
    if how == signal.SIGINT:  # Ctrl-C reaches the whole group
        os.killpg(process.pid, how)
    else:
        process.send_signal(how)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert said.strip().splitlines()[-1] == "bench blind: interrupted"
    assert list(tmp_path.iterdir()) == []


def test_figures_refuse_an_existing_folder(tmp_path, capsys):
    assert main(["figures", "--out", str(tmp_path)]) == 2
    assert "exists already, expected a new folder" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "load", ["spring", *(pytest.param(n, marks=pytest.mark.slow) for n in ("force", "antagonist"))]
)
def test_rigs_with_another_load_have_their_own_effects_motion_and_beliefs(load, tmp_path):
    manifest = make(tmp_path / "set", SEED, 2, load=load)
    assert manifest["load"] == load
    for label in unseal(tmp_path / "set" / "labels.sealed", manifest["sha256"]):
        case = tmp_path / "set" / "cases" / label["id"]
        nominal, record = read_parameters(case / "nominal.yaml"), read_record(case / "record")
        assert label["load"] == nominal["load.kind"] == load
        assert all(load in {**EFFECTS, **OUTSIDE}[name].loads for name in label["effects"])
        motion = "deflection" if load == "antagonist" else "elongation"
        assert np.ptp(record[motion].values) > 2e-3
        assert set(record.channels) == set(nominal["bench.channels"])
        unseen = UnseenRecord(label)
        gaps = unseen.gaps(unseen.stage.truth)
        # The true numbers leave what the case hides and nothing else.
        assert gaps["deflection"] < 0.05 * np.ptp(unseen.readings["deflection"])
        places = [row["side"] for row in (label["where"] or {"table": []})["table"]]
        assert all(bool(side) == (load == "antagonist") for side in places)

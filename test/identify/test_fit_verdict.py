"""Whether the model fits the records comes before its numbers, wherever these are shown."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="fits of the whole model take minutes uncompiled")

from wire_records import ramp

import sma_bench
from sma_bench.cli import main
from sma_bench.records import Record
from sma_bench.tasks import batch
from sma_bench.tasks.batch import run_task

LAG = "sensor.temperature.lag"


def bent(record, size):
    """Temperatures that rise by more than a wire of one h and R would: `size` at the top."""
    signal = record["wire.temperature"]
    rise = signal.values - signal.values.min()
    changed = replace(signal, values=signal.values - size * rise**2 / np.ptp(rise) ** 2)
    return Record(record.path, 0, {**record.signals, signal.name: changed})


@pytest.fixture(scope="module")
def staircase():
    return sma_bench.measure(sma_bench.simulate("quick_staircase"))


@pytest.mark.parametrize(
    ("size", "verdict", "status"), [(0.0, "ok", 0), (3.0, "imperfect", 0), (60.0, "misfit", 3)]
)
def test_the_verdict_on_the_fit_comes_first_and_the_file_is_written_in_any_case(
    staircase, size, verdict, status, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    sma_bench.write_record("bag", bent(staircase, size).signals.values())
    sma_bench.write_parameters("my lab.yaml", sma_bench.load_parameters({"wire.resistance": 2.7}))
    words = ["identify", "bag", "--params", "my lab.yaml"]
    assert main([*words, "--out", "found.yaml", "--json", "found.json"]) == status
    printed = capsys.readouterr().out
    fit = json.loads(Path("found.json").read_text())["fit"]
    assert fit["current"]["verdict"] == "ok" and fit["temperature"]["verdict"] == verdict
    assert set(fit["temperature"]) == {"verdict", "rms", "noise", "unit"}
    assert 0.05 < fit["temperature"]["noise"] < 0.2  # K
    assert (fit["temperature"]["rms"] > 20 * fit["temperature"]["noise"]) == (verdict == "misfit")
    first, head = printed.splitlines()[0], Path("found.yaml").read_text().splitlines()[0]
    assert ("temperature" in first) == (verdict == "misfit")
    assert ("temperature" in head) == (verdict != "ok")
    assert sma_bench.load_parameters("found.yaml")["wire.resistance"]
    advice = " ".join(printed[printed.index("\nnext ") :].split("\n\n")[0].split())
    assert ("my lab.yaml" in advice) == (verdict == "misfit")
    assert ("found.yaml" in advice) == (verdict != "misfit")
    assert "--out" not in advice
    # The batch says and writes the same.
    monkeypatch.setattr(batch, "do_tasks", lambda tasks, *_: (
        (k, run_task(task)) for k, task in enumerate(tasks)
    ))  # fmt: skip
    words = ["batch", "identify", "bag", "--params", "my lab.yaml", "--out", "many"]
    assert main(words) == status
    line = capsys.readouterr().out.splitlines()[1].split()
    assert line[1] == ("misfit" if verdict == "misfit" else "done")
    alone, many = (Path(name).read_text().splitlines() for name in ("found.yaml", "many/bag.yaml"))
    apart = [pair for pair in zip(alone, many, strict=True) if pair[0] != pair[1]]
    assert all("Identified by" in line for pair in apart for line in pair) and len(apart) == 1


def test_a_lag_of_the_thermometer_has_a_line_of_its_own(staircase):
    # Two time constants in a row: what is stated of c_p says which is the wire's.
    stated = {"wire.specific_heat": 350.0, "wire.heat_transfer_coefficient": 410.0,
              "wire.resistance": 2.75}  # fmt: skip
    found = sma_bench.identify(ramp(lag=0.3), stated)
    lag = found.estimates[LAG]
    assert abs(lag.value - 0.3) < 3.0 * lag.std < 0.05
    assert found.fit["temperature"].verdict == "ok"
    assert LAG not in sma_bench.identify(ramp(), stated).estimates


def test_ramps_too_slow_for_a_lag_say_that_it_would_pass_for_specific_heat():
    slow = sma_bench.measure(sma_bench.simulate("triangle"))
    (e3,) = [e for e in sma_bench.identify(slow).experiments if e.name == "E3"]
    assert any("lag_std" in f.numbers and f.subject == "wire.specific_heat" for f in e3.findings)


def test_numbers_are_compared_with_what_the_file_states_and_with_nothing_else(staircase):
    stated = {"wire.resistance": 4.9, "uncertainty.wire.resistance": 0.1}
    found = sma_bench.identify(staircase, stated)
    entries = found.to_json()["parameters"]
    assert entries["wire.resistance"]["stated"] == {"value": 4.9, "std": 0.1}
    assert "stated" not in entries["wire.heat_transfer_coefficient"]
    (off,) = [line for line in str(found).splitlines() if line.startswith("off ")]
    assert "wire.resistance" in off and "heat_transfer" not in off
    right = sma_bench.identify(staircase, stated | {"wire.resistance": 2.72})
    assert not [line for line in str(right).splitlines() if line.startswith("off ")]


def test_of_a_result_a_prompt_shows_a_line_and_a_pipe_what_its_reader_takes(
    staircase, planted_diagnosis, capsys
):
    found = sma_bench.identify(staircase)
    for thing in (found, found.parameters, staircase, planted_diagnosis):
        assert len(repr(thing)) < 1000 and "\n" not in repr(thing)
    assert main(["parameters"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 100
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "sma_bench.cli", "parameters"]
    with os.fdopen(writing, "w") as pipe:
        ended = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 0 and ended.stderr == ""

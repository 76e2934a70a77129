"""The four terminals of docs/nodes.md: three nodes, and `call` that reaches them."""

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import yaml

from sma_bench.cli import main
from sma_bench.diagnose.result import diagnosis_from
from sma_bench.records import read_record
from sma_bench.results import card_text, json_text

pytestmark = pytest.mark.skipif(find_spec("rclpy") is None, reason="rclpy is not installed")

ROOT = Path(__file__).resolve().parents[2]
STEPS = [{"kind": "hold", "level": 2.0, "duration": 2.0}, {"kind": "rest", "duration": 5.0}]
PATIENCE = 60.0


def terminals():
    """The commands on the page, without the program's name."""
    blocks = re.findall(r"^```\n(.*?)^```", (ROOT / "docs" / "nodes.md").read_text(), re.M | re.S)
    (block,) = [block for block in blocks if "./bench call" in block]
    return [shlex.split(line)[1:] for line in block.splitlines()]


@pytest.mark.slow
def test_the_terminals_of_the_page_record_a_bench(tmp_path, capsys, ros_domain, monkeypatch):
    monkeypatch.setattr("sma_bench.commands.nodes._PRESENCE", 1.0)
    assert main(["call", "experiment/start"]) == 2
    # The first import of ROS's parser causes deprecation warnings.
    (error,) = [
        line for line in capsys.readouterr().err.splitlines() if "is deprecated" not in line
    ]
    assert "/bench/experiment/start: no such service found within 1 s" in error
    monkeypatch.setattr("sma_bench.commands.nodes._PRESENCE", PATIENCE)
    protocol = tmp_path / "short.yaml"
    protocol.write_text(yaml.safe_dump({"name": "short", "steps": STEPS}))
    *nodes, call = terminals()
    assert call == ["call", "experiment/start"]
    running = []
    try:
        for words in nodes:
            words = [w.replace("config/", f"{ROOT}/config/") for w in words]
            log = (tmp_path / f"{words[1]}.log").open("wb")
            streams = {"stdout": log, "stderr": subprocess.STDOUT}
            command = [sys.executable, "-m", "sma_bench.cli", *words]
            running.append(subprocess.Popen(command, cwd=tmp_path, **streams))
        recorder, experiment = running[1], tmp_path / "experiment.log"
        until(tmp_path / "recorder.log", "wire/temperature")
        answer = accepted([*call, "--set", f"protocol={protocol}", "--json"], capsys)
        # On a busy machine, readings may have been late before.
        assert re.match("short: 7 s|starts as soon as it can", json.loads(answer)["answer"])
        until(experiment, "running: short")
        assert main(call) == 2
        assert "already running short" in capsys.readouterr().err
        until(experiment, "done: short")
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(PATIENCE) == 0
        assert "messages" in (tmp_path / "recorder.log").read_text()
    finally:
        for process in running:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(PATIENCE)
    assert read_record(tmp_path / "my_record")["wire.voltage"].values.max() > 1.9


def accepted(call, capsys):
    """The output; repeated, because nodes discover each other late on a busy machine."""
    end = time.monotonic() + PATIENCE
    while status := main(call):
        error = capsys.readouterr().err
        assert status == 2 and re.search("nothing listens|was never received", error), error
        assert time.monotonic() < end, error
    return capsys.readouterr().out


def until(log, words):
    end = time.monotonic() + PATIENCE
    while words not in log.read_text():
        assert time.monotonic() < end, log.read_text()
        time.sleep(0.1)


def test_an_answer_that_is_a_result_is_shown_as_its_card(monkeypatch, capsys, tmp_path):
    shown = yaml.safe_load((ROOT / "test" / "report" / "results.yaml").read_text())
    result = diagnosis_from(shown["diagnosis"], "gap")
    client = MagicMock()
    client.return_value.__enter__.return_value.trigger.return_value = json_text(result.to_json())
    client.return_value.__exit__.return_value = False
    monkeypatch.setattr("sma_bench.ros.bench_client.BenchClient", client)
    assert main(["call", "diagnosis/diagnose", "--json", str(tmp_path / "gap.json")]) == 0
    assert capsys.readouterr().out.strip() == card_text(result, 100)
    assert json.loads((tmp_path / "gap.json").read_text())["answer"]["verdict"] == result.verdict

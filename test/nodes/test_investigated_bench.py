"""A run that sma-bench investigate asks of a bench's own nodes: recorded, and aborted at 0 V."""

import argparse
import json

import pytest

from sma_bench.commands.investigate import _bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.ros.processes import NodeProcesses

SPACE = "/investigated"


def planned(folder, lab, level, seconds):
    path = folder / f"{level}.yaml"
    step = {"kind": "step", "level": level, "duration": seconds}
    path.write_text(json.dumps({"name": f"step_{level}", "steps": [step]}))
    return path, load_protocol(path, lab)


def test_a_run_is_recorded_and_one_that_is_aborted_leaves_no_record(ros_domain, tmp_path):
    lab = Parameters.defaults().replace({"bench.maximum_temperature": 315.0})
    write_parameters(tmp_path / "lab.yaml", lab)
    run = _bench(argparse.Namespace(namespace=SPACE))
    with NodeProcesses(SPACE, tmp_path) as nodes:
        nodes.start("simulator", {}, (tmp_path / "lab.yaml",))
        nodes.start("experiment", {"protocol_root": str(tmp_path)}, (tmp_path / "lab.yaml",))
        run(*planned(tmp_path, lab, 2.0, 1.5), tmp_path / "record_1")
        volts = read_record(tmp_path / "record_1")["wire.voltage"].values
        assert volts.max() == pytest.approx(2.0, abs=0.05) and volts[-1] < 0.1
        with pytest.raises(InputError, match=r"aborted: .*temperature"):
            run(*planned(tmp_path, lab, 3.5, 20.0), tmp_path / "record_2")
    assert not (tmp_path / "record_2").exists()

"""Runs that an investigation asks of a bench's nodes: recorded, stopped at 0 V, gone on with."""

import argparse
import json
import signal

import pytest
from planted import believed

from sma_bench.commands.investigate import _bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.protocols import load_protocol
from sma_bench.records import read_record
from sma_bench.ros.processes import NodeProcesses
from sma_bench.tasks.investigation import NextRun

SPACE = "/investigated"
# Messages take most of the processor's time.
RATES = {"rate__power": 20.0, "rate__temperature": 20.0, "rate__mechanics": 20.0}


def planned(folder, lab, level, seconds, bag):
    path = folder / f"{level}.yaml"
    step = {"kind": "step", "level": level, "duration": seconds}
    path.write_text(json.dumps({"name": f"step_{level}", "steps": [step]}))
    return NextRun(path, load_protocol(path, lab), folder / bag)


@pytest.mark.usefixtures("nodes_forked")
def test_a_run_is_recorded_and_one_that_is_aborted_leaves_no_record(ros_domain, tmp_path):
    lab = Parameters.of_paper().replace({"bench.maximum_temperature": 315.0})
    write_parameters(tmp_path / "lab.yaml", lab)
    run = _bench(argparse.Namespace(namespace=SPACE))
    (tmp_path / "unfinished_record_1").mkdir()  # of one that was killed
    with NodeProcesses(SPACE, tmp_path) as nodes:
        nodes.start("simulator", {}, (tmp_path / "lab.yaml",))
        nodes.start("experiment", {"protocol_root": str(tmp_path)}, (tmp_path / "lab.yaml",))
        run(planned(tmp_path, lab, 2.0, 1.5, "record_1"))
        volts = read_record(tmp_path / "record_1")["wire.voltage"].values
        assert volts.max() == pytest.approx(2.0, abs=0.05) and volts[-1] < 0.1
        with pytest.raises(InputError, match=r"aborted: .*temperature"):
            run(planned(tmp_path, lab, 3.5, 20.0, "record_2"))
        with pytest.raises(InputError, match=r"aborted: .*expected idle or done; reset it first"):
            run(planned(tmp_path, lab, 2.0, 1.5, "record_2"))
    assert not (tmp_path / "record_2").exists()
    assert len(list(tmp_path.glob("unfinished_record_?_*"))) == 2


def test_the_node_waits_for_confirmation_goes_on_after_kill_9_and_stops_at_0_v(bench, tmp_path):
    write_parameters(tmp_path / "lab.yaml", believed())
    told, runs, results, power = bench.hear(
        "investigation/state", "experiment/state", "investigation/result", "front_1/power"
    )

    def begun():
        """A node that was asked to start, waited for confirmation and has it run."""
        told.clear()
        node = bench.start("investigation", tmp_path / "lab.yaml", use_sim_time=True,
                           folder=tmp_path / "gap", output_root=tmp_path)  # fmt: skip
        bench.until(lambda: told and told[-1].data == "idle")
        refused = bench.trigger("investigation/confirm")
        assert not refused.success and refused.message == "nothing to confirm: idle"
        assert bench.trigger("investigation/start").success
        bench.until(lambda: told[-1].data.startswith("waiting for confirmation: "))
        offer = json.loads(results[-1].data)["next"]
        assert told[-1].data.endswith(offer["protocol"]) and 0.0 < offer["volts"] < 10.0
        assert runs[-1].data == "idle" and power[-1].voltage < 0.1
        assert bench.trigger("investigation/confirm").success
        bench.until(lambda: power[-1].voltage > 0.5)
        assert not bench.trigger("investigation/start").success
        return node

    def stopped(reason):
        bench.until(lambda: runs[-1].data.startswith(f"aborted: {reason}"))
        bench.until(lambda: power[-1].voltage < 0.1)

    bench.start("simulator", tmp_path / "lab.yaml", speed=8.0, **RATES)
    bench.start("experiment", tmp_path / "lab.yaml", use_sim_time=True, require_recorder=True,
                protocol="composite_triangle", protocol_root=tmp_path)  # fmt: skip
    bench.until(lambda: runs and power)
    killed = begun()
    killed.end(signal.SIGKILL)
    stopped("the recorder")
    assert not (tmp_path / "gap" / "record_1").exists()
    bench.trigger("experiment/reset")
    node = begun()
    assert bench.trigger("investigation/stop").success
    bench.until(lambda: told[-1].data.startswith("stopped"))
    stopped("stopped on request")
    assert node.end() == 0 and "Traceback" not in node.output

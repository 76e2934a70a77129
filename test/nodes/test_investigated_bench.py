"""Runs that an investigation requests from a bench's nodes: recorded, stopped at 0 V, continued."""

import json
import signal

import pytest
from planted import believed

from sma_bench.commands.answers import run_bench
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.records import read_record
from sma_bench.ros.bench_client import BenchClient
from sma_bench.ros.processes import NodeProcesses

SPACE = "/investigated"
# Few messages, as these take most of the CPU time.
RATES = {"rate__power": 20.0, "rate__temperature": 20.0, "rate__mechanics": 20.0}


@pytest.mark.usefixtures("nodes_forked")
def test_a_run_is_recorded_and_one_that_is_aborted_leaves_no_record(ros_domain, tmp_path):
    lab = Parameters.of_paper().replace({"bench.maximum_temperature": 315.0})
    file = tmp_path / "lab.yaml"
    write_parameters(file, lab)

    def run(level, seconds, bag):
        path = tmp_path / f"{level}.yaml"
        step = {"kind": "step", "level": level, "duration": seconds}
        path.write_text(json.dumps({"name": f"step_{level}", "steps": [step]}))
        asked = {"protocol": f"step_{level}", "minutes": seconds / 60.0, "file": path}
        run_bench({**asked, "bag": tmp_path / bag}, SPACE)

    (tmp_path / "unfinished_record_1").mkdir()  # of one that was killed
    with NodeProcesses(SPACE, tmp_path) as nodes:
        nodes.start("simulator", {}, (file,))
        nodes.start("experiment", {"protocol_root": str(tmp_path)}, (file,))
        # The first start may compile the physics, and discovery takes its time.
        with BenchClient(SPACE, nodes.check) as client:
            client.wait("simulator", lambda: client.simulated_seconds > 4.0, 120.0)
        run(2.0, 2.0, "record_1")
        volts = read_record(tmp_path / "record_1")["wire.voltage"].values
        assert volts.max() == pytest.approx(2.0, abs=0.05) and volts[-1] < 0.1
        with pytest.raises(InputError, match=r"aborted: .*temperature"):
            run(3.5, 20.0, "record_2")
        with pytest.raises(InputError, match=r"aborted: .*expected idle or done; reset it first"):
            run(2.0, 2.0, "record_2")
    assert not (tmp_path / "record_2").exists()
    assert len(list(tmp_path.glob("unfinished_record_?_*"))) >= 2


@pytest.mark.slow
def test_the_node_waits_for_confirmation_goes_on_after_kill_9_and_stops_at_0_v(bench, tmp_path):
    lab = tmp_path / "lab.yaml"
    write_parameters(lab, believed())
    told, runs, results, power = bench.hear(
        "investigation/state", "experiment/state", "investigation/result", "front_1/power"
    )

    def begun():
        """A node that was started, waited for confirmation, got it and runs the protocol."""
        told.clear()
        files = {"folder": tmp_path / "gap", "output_root": tmp_path}
        node = bench.start("investigation", lab, use_sim_time=True, **files)
        bench.until(lambda: told and told[-1].data == "idle")
        assert bench.refused("investigation/confirm", "nothing to confirm: idle")
        assert bench.trigger("investigation/start").success
        # The diagnosis may be slow while other tests run.
        bench.until(lambda: told[-1].data.startswith("waiting for confirmation: "), 120.0)
        offer = json.loads(results[-1].data)["next"]
        assert told[-1].data.endswith(offer["protocol"]) and 0.0 < offer["volts"] < 10.0
        assert runs[-1].data == "idle" and power[-1].voltage < 0.1
        assert bench.trigger("investigation/confirm").success
        bench.until(lambda: power[-1].voltage > 0.5, 120.0)
        assert not bench.trigger("investigation/start").success
        return node

    def stopped(reason):
        bench.until(lambda: runs[-1].data.startswith(f"aborted: {reason}"))
        bench.until(lambda: power[-1].voltage < 0.1)

    bench.start("simulator", lab, speed=4.0, **RATES)
    protocol = {"protocol": "composite_triangle", "protocol_root": tmp_path}
    bench.start("experiment", lab, use_sim_time=True, require_recorder=True, **protocol)
    bench.until(lambda: runs and power)
    begun().end(signal.SIGKILL)
    stopped("the recorder")
    assert not (tmp_path / "gap" / "record_1").exists()
    bench.trigger("experiment/reset")
    node = begun()
    assert bench.trigger("investigation/stop").success
    bench.until(lambda: told[-1].data.startswith("stopped"))
    stopped("stopped on request")
    assert node.end() == 0 and "Traceback" not in node.output

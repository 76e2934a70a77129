"""Identification and diagnosis as services: answers, files, and nodes that stay responsive."""

import json
import os
import signal

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from planted import supply_drop_lab

from examination.blind.case_files import checked_answer
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics import simulate
from sma_bench.protocols import parse_protocol
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.tasks.jobs import Worker, output_inside, records_inside, require_own

RATE = 50.0


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A short staircase on the wire of Table I."""
    parameters = Parameters.defaults()
    stairs = {"kind": "staircase", "start": 0.0, "stop": 5.0, "increment": 0.5, "dwell": 30.0}
    time, voltage = parse_protocol({"steps": [stairs]}, parameters).sample(1.0 / RATE)
    result = simulate(parameters, time, voltage)
    noise = np.random.default_rng(1).normal(size=(3, time.size))
    columns = {
        "voltage": ("V", voltage[:, 0] + 0.002 * noise[2]),
        "current": ("A", result.current[:, 0] + 0.02 * noise[0]),
        "temperature": ("K", result.temperature[:, 0] + 0.08 * noise[1]),
    }
    path = tmp_path_factory.mktemp("records") / "stairs"
    write_record(path, [
        Signal(f"wire.{name}", unit, time, values) for name, (unit, values) in columns.items()
    ])  # fmt: skip
    return path


@pytest.fixture
def a_robot(tmp_path):
    """Where rosdep brought everything: without the packages of requirements-robot.txt."""
    for name in ("mcap", "msgspec", "pint", "zstandard"):
        text = f"raise ModuleNotFoundError('no {name}', name='{name}')\n"
        (tmp_path / f"without/{name}.py").parent.mkdir(exist_ok=True)
        (tmp_path / f"without/{name}.py").write_text(text)
    path = os.pathsep.join(filter(None, [str(tmp_path / "without"), os.environ.get("PYTHONPATH")]))
    return {"env": {**os.environ, "PYTHONPATH": path}}


@pytest.mark.parametrize("name", ["simulator", "serial_bridge", "ir_camera"])
def test_nodes_of_the_mission_start_with_what_rosdep_brings(bench, a_robot, name):
    node = bench.start(name, options=a_robot)
    bench.until(lambda: name in bench.node.get_node_names())
    assert node.end() == 0 and "Traceback" not in node.output


def test_request_is_answered_published_and_saved_and_the_next_one_is_refused_meanwhile(
    bench, bag, tmp_path, a_robot
):
    results, states = bench.hear("identification/result", "identification/state")
    out = tmp_path / "out"
    node = bench.start(
        "identification", options=a_robot, record_root=bag.parent, output_directory=out,
        output_root=tmp_path,
    )
    for record, said in (
        ("", "record: is empty"), ("no_such_bag", "no_such_bag"),
        ("../../etc", "lies outside record_root"),
    ):  # fmt: skip
        bench.set_parameter("identification", "record", [record])
        answer = bench.trigger("identification/identify")
        assert not answer.success and said in answer.message and "\n" not in answer.message
    bench.set_parameter("identification", "record", [bag.name])
    assert not bench.trigger("identification/cancel").success  # nothing runs
    unwanted = bench.trigger_later("identification/identify")
    bench.until(lambda: bench.trigger("identification/cancel").success)
    bench.until(unwanted.done)
    assert unwanted.result().message == "identification: cancelled on request"
    assert not out.exists()
    bench.until(lambda: states[-1].data == "idle")
    first = bench.trigger_later("identification/identify")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    second = bench.trigger("identification/identify")
    assert not second.success and second.message.startswith("busy")
    # The request at work keeps what it was asked; this is for the next one.
    (tmp_path / "file").touch()
    assert bench.set_parameter("identification", "output_directory", "file/out").successful
    bench.until(first.done)
    answer = first.result()
    assert answer.success, answer.message
    found = json.loads(answer.message)["parameters"]
    resistance = found["wire.resistance"]
    assert abs(resistance["value"] - 2.6987) < 3.0 * resistance["std"]
    bench.until(lambda: results)
    assert results[-1].data == answer.message == (out / "identified.json").read_text()
    saved = read_parameters(out / "identified.yaml")
    rounding = 0.06 * resistance["std"]  # a file has the digits that the error deserves
    assert saved["wire.resistance"] == pytest.approx(resistance["value"], abs=rounding)
    assert saved.std("wire.resistance") == pytest.approx(resistance["std"], abs=rounding)
    bad = bench.trigger("identification/identify")
    assert not bad.success and "file/out: cannot be made" in bad.message and "\n" not in bad.message
    assert bench.set_parameter("identification", "output_directory", str(out)).successful
    unheard = bench.trigger_later("identification/identify")
    bench.until(lambda: states[-1].data.startswith("busy"))
    assert node.end() == 0 and not unheard.done()
    assert "Traceback" not in node.output


def records(root, *names):
    return records_inside({"record_root": str(root), "record": names})


def output(root, path, suffix=""):
    return output_inside({"output_root": str(root), "report": path}, "report", suffix)


def test_only_records_and_results_inside_their_roots_are_taken(tmp_path, monkeypatch):
    root, outside = tmp_path / "root", tmp_path / "outside"
    for folder in (root / "bag", outside):
        folder.mkdir(parents=True)
    (root / "link").symlink_to(outside)
    assert records(root, "a", "") == [str(root / "a")]
    assert records("", "a") == ["a"] and records("/", str(outside)) == [str(outside)]
    for record in ("link", "../outside", str(outside)):
        with pytest.raises(InputError, match="lies outside record_root"):
            records(root, record)
    with pytest.raises(InputError, match="outside record_root .*where the node was started"):
        records("", str(outside))
    assert records(root, "bag") == [str(root / "bag")]
    (root / "bag" / "bag.mcap").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="record: .*bag lies outside record_root"):
        records(root, "bag")

    monkeypatch.chdir(tmp_path)
    assert output(root, "out/deep") == str(root / "out" / "deep") and output(root, "") == ""
    assert output("", "a.yaml", ".yaml") == "sma_bench_results/a.yaml"
    (tmp_path / "mine.yaml").write_text("# Misfit.\n# Improved by x\n")
    (tmp_path / "theirs.yaml").write_text("a: 1\n")
    assert output(tmp_path, "mine.yaml", ".yaml")
    for path, suffix, said in (
        ("../out", "", "report: .*lies outside output_root"),
        ("/etc/cron.d", "", "report: .*lies outside output_root"),
        ("a\0b", "", "report: .*lies outside output_root"), (".bashrc", "", "is hidden"),
        ("a/.git/hooks", "", "is hidden"), ("Makefile", ".yaml", "ends in .yaml"),
        ("theirs.yaml", ".yaml", "not a file that sma-bench has written"),
    ):
        with pytest.raises(InputError, match=said):
            output(tmp_path, path, suffix)
    with pytest.raises(InputError, match="lies outside output_root .*sma_bench_results"):
        output("", "../a.yaml", ".yaml")
    with pytest.raises(InputError, match="not a file that sma-bench has written"):
        require_own(tmp_path / "mine.yaml", tmp_path / "theirs.yaml", parameter="output_directory")


def too_large(settings, parameters, tell):
    return str(len(bytearray(1 << 46)))


def vanishes(settings, parameters, tell):
    tell(0.5, "half")
    os.kill(os.getpid(), signal.SIGKILL)


def told(settings, parameters, tell):
    return f"{settings['record']} {sorted(parameters.given)} {parameters.given_uncertainty}"


def test_a_task_has_what_was_given_and_its_failures_are_one_line():
    worker, heard = Worker("identification"), []
    settings, given = {"record": ("a",)}, Parameters({"wire.mass": 0.09e-3}, {"wire.mass": 1e-6})
    assert worker.run(told, settings, given) == "('a',) ['wire.mass'] {'wire.mass': 1e-06}"
    for task, why in ((too_large, "MemoryError"), (vanishes, "SIGKILL")):
        with pytest.raises(InputError, match=f"failed: .*{why}") as failed:
            worker.run(task, settings, given, lambda *said: heard.append(said))
        assert "\n" not in str(failed.value)
    assert heard == [(0.5, "half")]


pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Folder with a bag of a wire whose leads drop voltage, and the lab's parameters."""
    return supply_drop_lab(tmp_path_factory.mktemp("rig"))


def test_a_bag_is_diagnosed_its_gap_published_and_bad_requests_are_one_line(bench, rig, tmp_path):
    results, gaps, states = bench.hear("diagnosis/result", "diagnosis/gap", "diagnosis/state")
    improved = tmp_path / "improved.yaml"
    node = bench.start(
        "diagnosis", rig / "lab.yaml", record_root=rig, improved=improved, output_root=tmp_path
    )
    result = bench.set_parameter("diagnosis", "improved", "Makefile")
    assert not result.successful and "ends in .yaml" in result.reason
    for records, hold_out, said in (
        ([""], [""], "record: is empty"), (["bag"], ["../../etc"], "lies outside record_root"),
        (["bag"], ["no_such_bag"], "no_such_bag"),
    ):  # fmt: skip
        bench.set_parameter("diagnosis", "record", records)
        bench.set_parameter("diagnosis", "hold_out", hold_out)
        answer = bench.trigger("diagnosis/diagnose")
        assert not answer.success and said in answer.message and "\n" not in answer.message
    bench.set_parameter("diagnosis", "hold_out", [""])
    first = bench.trigger_later("diagnosis/diagnose")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    second = bench.trigger("diagnosis/diagnose")
    assert not second.success and second.message == "busy: another diagnosis is running"
    bench.until(first.done, patience=120.0)
    answer = first.result()
    assert answer.success, answer.message
    found = checked_answer(json.loads(answer.message))
    assert (found.verdict, found.cause) == ("effect", ("supply_drop",))
    bench.until(lambda: results and gaps)
    assert results[-1].data == answer.message
    whole, *quantities = gaps[-1].status
    assert whole.level == DiagnosticStatus.WARN
    assert whole.name == "diagnosis: sim-to-real gap"
    assert whole.message == "explained by supply_drop"
    assert {v.key: v.value for v in whole.values}["stage"] == "electrical"
    assert {s.name.rpartition(" ")[2] for s in quantities} == {"current", "temperature"}
    saved = read_parameters(improved)
    assert saved["effect.supply_drop.resistance"] == pytest.approx(0.3, abs=0.05)
    assert saved["bench.channels"] == ("wire",)
    unheard = bench.trigger_later("diagnosis/diagnose")
    bench.until(lambda: states[-1].data.startswith("busy"))
    assert node.end() == 0 and not unheard.done()
    assert "Traceback" not in node.output

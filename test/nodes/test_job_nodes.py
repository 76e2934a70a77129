"""Identification and diagnosis as services: answers, files, and nodes that stay responsive."""

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import small_tasks
from diagnostic_msgs.msg import DiagnosticStatus
from planted import supply_drop_lab

from examination.blind.case_files import checked_answer
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import protocol_record
from sma_bench.tasks.jobs import Worker, output_inside, records_inside, require_own

MISSION = """
import rclpy
from sma_bench.nodes.start import node_class
rclpy.init(args=["--ros-args", "-r", "__ns:=/bench"])
for name in ("simulator", "serial_bridge", "ir_camera"):
    rclpy.spin_once(node_class(name)(), timeout_sec=1.0)
"""


@pytest.fixture
def a_robot(tmp_path):
    """An installation by rosdep only, without the packages of requirements-robot.txt."""
    without = tmp_path / "without"
    without.mkdir()
    for name in ("mcap", "msgspec", "pint", "zstandard"):
        text = f"raise ModuleNotFoundError('no {name}', name='{name}')\n"
        (without / f"{name}.py").write_text(text)
    path = os.pathsep.join(filter(None, [str(without), os.environ.get("PYTHONPATH")]))
    return {"env": {**os.environ, "PYTHONPATH": path}}


@pytest.mark.usefixtures("ros_domain")
def test_nodes_of_the_mission_begin_with_what_rosdep_brings(a_robot):
    subprocess.run([sys.executable, "-c", MISSION], check=True, **a_robot)


def test_request_is_answered_published_and_saved_and_the_next_one_is_refused_meanwhile(
    bench, tmp_path, a_robot
):
    truth = Parameters.of_paper()["wire.resistance"]
    made = protocol_record("quick_staircase", Parameters.of_paper())
    write_record(tmp_path / "stairs", list(made.signals.values()))
    results, states = bench.hear("identification/result", "identification/state")
    out, identify = tmp_path / "out", "identification/identify"
    node = bench.start("identification", options=a_robot, record_root=tmp_path,
                       output_directory=out, output_root=tmp_path)  # fmt: skip

    def set_parameter(name, value):
        return bench.set_parameter("identification", name, value).successful

    for record, said in (
        ("", "record: is empty"), ("no_such_bag", "no_such_bag"),
        ("../../etc", "lies outside record_root"),
    ):  # fmt: skip
        set_parameter("record", [record])
        assert bench.refused(identify, said)
    # Cancelled, while another request is refused as busy.
    set_parameter("record", ["stairs"])
    assert not bench.trigger("identification/cancel").success  # nothing runs
    unwanted = bench.trigger_later(identify)
    bench.until(lambda: states[-1].data.startswith("busy"))
    assert bench.refused(identify, "busy: another identification is running")
    bench.until(lambda: bench.trigger("identification/cancel").success)
    bench.until(unwanted.done)
    assert unwanted.result().message == "identification: cancelled on request"
    assert not out.exists()
    bench.until(lambda: states[-1].data == "idle")
    first = bench.trigger_later(identify)
    bench.until(lambda: states[-1].data.startswith("busy"))
    # The running request keeps its parameters; these apply to the next one.
    (tmp_path / "file").touch()
    assert set_parameter("output_directory", "file/out")
    bench.until(first.done, patience=120.0)
    answer = first.result()
    assert answer.success, answer.message
    resistance = json.loads(answer.message)["parameters"]["wire.resistance"]
    assert abs(resistance["value"] - truth) < 3.0 * resistance["std"]
    bench.until(lambda: results)
    assert results[-1].data == answer.message == (out / "identified.json").read_text()
    saved = read_parameters(out / "identified.yaml")
    rounding = 0.06 * resistance["std"]  # a file has the digits that the error deserves
    assert saved["wire.resistance"] == pytest.approx(resistance["value"], abs=rounding)
    assert saved.std("wire.resistance") == pytest.approx(resistance["std"], abs=rounding)
    # If its node ends, a request gets no answer.
    unheard = bench.trigger_later(identify)
    bench.until(lambda: states[-1].data.startswith("busy"))
    assert node.end() == 0 and not unheard.done()
    assert "Traceback" not in node.output


def test_only_records_and_results_inside_their_roots_are_taken(tmp_path, monkeypatch):
    def records(root, *names):
        return records_inside({"record_root": str(root), "record": names})

    def output(root, path, suffix=".yaml"):
        return output_inside({"output_root": str(root), "report": path}, "report", suffix)

    root, outside = tmp_path / "root", tmp_path / "outside"
    for folder in (root / "bag", outside):
        folder.mkdir(parents=True)
    (root / "link").symlink_to(outside)
    assert records(root, "a", "") == [str(root / "a")] and records("", "a") == ["a"]
    assert records("/", str(outside)) == [str(outside)]
    assert records(root, "bag") == [str(root / "bag")]
    (root / "bag" / "bag.mcap").symlink_to("/etc/passwd")
    for folder, record, said in (
        (root, "link", "lies outside record_root"), (root, "../outside", "outside record_root"),
        (root, str(outside), "lies outside record_root"),
        ("", str(outside), "outside record_root .*where the node was started"),
        (root, "bag", "record: .*bag lies outside record_root"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            records(folder, record)

    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("# Misfit.\n# Improved by x\n")
    (tmp_path / "theirs.yaml").write_text("a: 1\n")
    assert output(root, "out/deep", "") == str(root / "out" / "deep") and output(root, "") == ""
    assert output("", "a.yaml") == "sma_bench_results/a.yaml"
    assert output(tmp_path, "mine.yaml")
    for folder, path, said in (
        (tmp_path, "../a.yaml", "report: .*lies outside output_root"),
        (tmp_path, "/etc/cron.yaml", "report: .*lies outside output_root"),
        (tmp_path, "a\0b.yaml", "report: .*lies outside output_root"),
        (tmp_path, ".bashrc", "is hidden"), (tmp_path, "a/.git/hooks", "is hidden"),
        (tmp_path, "Makefile", "ends in .yaml"),
        (tmp_path, "theirs.yaml", "not a file that sma-bench has written"),
        ("", "../a.yaml", "lies outside output_root .*sma_bench_results"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            output(folder, path)
    with pytest.raises(InputError, match="not a file that sma-bench has written"):
        require_own(tmp_path / "mine.yaml", tmp_path / "theirs.yaml", parameter="output_directory")


def test_a_task_has_what_was_given_and_its_failures_are_one_line():
    worker, heard = Worker("identification"), []
    settings, given = {"record": ("a",)}, Parameters({"wire.mass": 0.09e-3}, {"wire.mass": 1e-6})
    for task, why in ((small_tasks.too_large, "MemoryError"), (small_tasks.vanishes, "SIGKILL")):
        with pytest.raises(InputError, match=f"^[^\n]*failed: [^\n]*{why}[^\n]*$"):
            worker.run(task, settings, given, lambda *said: heard.append(said))
    assert heard == [(0.5, f"{settings} {given.given} {{'wire.mass': 1e-06}}")]


def test_the_one_task_of_a_node_uses_as_many_threads_as_a_command():
    found = Worker("diagnosis").run(small_tasks.threads, {}, Parameters.defaults())
    assert int(found) > 1


def test_work_has_usual_priority_though_its_node_has_a_higher_one():
    """As for a node that shares its process with one that drives."""

    def ask():
        try:
            os.sched_setscheduler(threading.get_native_id(), os.SCHED_RR, os.sched_param(1))
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), -10)
        except OSError:
            return "not allowed"
        return Worker("diagnosis").run(small_tasks.urgency, {}, Parameters.defaults())

    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(ask).result()
    if found == "not allowed":
        pytest.skip("this user may make nothing urgent")
    assert found == "0 0"


def test_a_bag_is_diagnosed_its_gap_published_and_bad_requests_are_one_line(bench, tmp_path):
    pytest.importorskip("numba", reason="diagnoses take minutes uncompiled")
    rig = supply_drop_lab(tmp_path)
    results, gaps, states = bench.hear("diagnosis/result", "diagnosis/gap", "diagnosis/state")
    improved, diagnose = tmp_path / "improved.yaml", "diagnosis/diagnose"
    bench.start(
        "diagnosis", rig / "lab.yaml", record_root=rig, improved=improved, output_root=tmp_path
    )
    result = bench.set_parameter("diagnosis", "improved", "Makefile")
    assert not result.successful and "ends in .yaml" in result.reason
    bench.set_parameter("diagnosis", "record", ["bag"])
    for held_out, said in (("../../etc", "outside record_root"), ("no_such_bag", "no_such_bag")):
        bench.set_parameter("diagnosis", "hold_out", [held_out])
        assert bench.refused(diagnose, said)
    bench.set_parameter("diagnosis", "hold_out", [""])
    first = bench.trigger_later(diagnose)
    bench.until(lambda: states[-1].data.startswith("busy"))
    assert bench.refused(diagnose, "busy: another diagnosis is running")
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

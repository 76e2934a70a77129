"""The identification service as a process: an answer, files, and a node that stays responsive."""

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from std_msgs.msg import String

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.physics import simulate
from sma_bench.protocols import parse_protocol
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
    signals = {
        "wire.voltage": (time, voltage[:, 0] + 0.002 * noise[2]),
        "wire.current": (time, result.current[:, 0] + 0.02 * noise[0]),
        "wire.temperature": (time, result.temperature[:, 0] + 0.08 * noise[1]),
    }
    path = tmp_path_factory.mktemp("records") / "stairs"
    write(path, signals)
    return path


def write(path, signals):
    from sma_bench.records import Signal

    units = {"voltage": "V", "current": "A", "temperature": "K"}
    write_record(
        path,
        [
            Signal(name, units[name.split(".")[1]], time, values, None, "")
            for name, (time, values) in signals.items()
        ],
    )


def processor_seconds(node):
    stat = Path(f"/proc/{node.process.pid}/stat").read_text()
    fields = stat.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def test_request_is_answered_published_and_saved_and_the_next_one_is_refused_meanwhile(
    bench, bag, tmp_path
):
    results = bench.latched("identification/result", String)
    states = bench.latched("identification/state", String)
    out = tmp_path / "out"
    node = bench.start(
        "identification", record_root=bag.parent, record=f"[{bag.name}]", output_directory=out,
        output_root=tmp_path,
    )
    assert not bench.trigger("identification/cancel").success  # nothing runs
    unwanted = bench.trigger_later("identification/identify")
    bench.until(lambda: bench.trigger("identification/cancel").success)
    bench.until(unwanted.done)
    assert unwanted.result().message == "identification: cancelled on request"
    assert not out.exists()
    bench.until(lambda: states[-1].data == "idle")
    first = bench.trigger_later("identification/identify")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    before = processor_seconds(node)
    second = bench.trigger("identification/identify")
    assert not second.success and second.message.startswith("busy")
    # The request at work keeps what it was asked; this is for the next one.
    (tmp_path / "file").touch()
    assert bench.set_parameter("identification", "output_directory", "file/out").successful
    bench.until(first.done)
    assert processor_seconds(node) - before < 1.0
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
    assert node.end() == 0


def test_bad_requests_are_answered_in_one_line_and_the_node_ends_while_it_works(
    bench, bag, tmp_path
):
    node = bench.start(
        "identification", record_root=bag.parent, output_directory=tmp_path, output_root=tmp_path
    )
    answer = bench.trigger("identification/identify")
    assert not answer.success and answer.message.startswith("record: is empty")
    bench.set_parameter("identification", "record", ["no_such_bag"])
    answer = bench.trigger("identification/identify")
    assert not answer.success and "no_such_bag" in answer.message and "\n" not in answer.message
    bench.set_parameter("identification", "record", ["../../etc"])
    answer = bench.trigger("identification/identify")
    assert not answer.success and "lies outside record_root" in answer.message
    bench.set_parameter("identification", "record", [bag.name])
    states = bench.latched("identification/state", String)
    bench.trigger_later("identification/identify")
    bench.until(lambda: states and states[-1].data.startswith("busy"))
    assert node.end() == 0
    assert "Traceback" not in node.output


def records(root, *names):
    return records_inside({"record_root": str(root), "record": names})


def output(root, path, suffix=""):
    return output_inside({"output_root": str(root), "report": path}, "report", suffix)


def test_records_are_found_below_the_root_and_links_out_of_it_are_refused(tmp_path):
    root, outside = tmp_path / "root", tmp_path / "outside"
    root.mkdir()
    outside.mkdir()
    (root / "link").symlink_to(outside)
    assert records(root, "a", "") == [str(root / "a")]
    assert records("", "a") == ["a"]
    assert records("/", str(outside)) == [str(outside)]
    for record in ("link", "../outside", str(outside)):
        with pytest.raises(InputError, match="lies outside record_root"):
            records(root, record)
    with pytest.raises(InputError, match="outside record_root .*where the node was started"):
        records("", str(outside))


def test_links_inside_a_bag_and_results_outside_the_root_are_refused(tmp_path):
    root = tmp_path / "root"
    (root / "bag").mkdir(parents=True)
    assert records(root, "bag") == [str(root / "bag")]
    (root / "bag" / "bag.mcap").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="record: .*bag lies outside record_root"):
        records(root, "bag")
    assert output(root, "out/deep") == str(root / "out" / "deep")
    assert output(root, "") == ""
    for path in ("../out", "/etc/cron.d", "a\0b"):
        with pytest.raises(InputError, match="report: .*lies outside output_root"):
            output(root, path)


def test_results_have_a_folder_of_their_own_and_replace_nothing_foreign(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert output("", "a.yaml", ".yaml") == "sma_bench_results/a.yaml"
    with pytest.raises(InputError, match="lies outside output_root .*sma_bench_results"):
        output("", "../a.yaml", ".yaml")
    for hidden in (".bashrc", ".config/a.yaml", "a/.git/hooks"):
        with pytest.raises(InputError, match="is hidden"):
            output(tmp_path, hidden)
    with pytest.raises(InputError, match="ends in .yaml"):
        output(tmp_path, "Makefile", ".yaml")
    for name, content in (("mine.yaml", "# Misfit.\n# Improved by x\n"), ("theirs.yaml", "a: 1\n")):
        (tmp_path / name).write_text(content)
    assert output(tmp_path, "mine.yaml", ".yaml")
    with pytest.raises(InputError, match="not a file that sma-bench has written"):
        output(tmp_path, "theirs.yaml", ".yaml")
    with pytest.raises(InputError, match="not a file that sma-bench has written"):
        require_own(tmp_path / "mine.yaml", tmp_path / "theirs.yaml", parameter="output_directory")


def too_large(settings, parameters, tell):
    return str(len(bytearray(1 << 46)))


def breaks(settings, parameters, tell):
    return f"{1 / 0}"


def vanishes(settings, parameters, tell):
    tell(0.5, "half")
    os.kill(os.getpid(), signal.SIGKILL)


def told(settings, parameters, tell):
    return f"{settings['record']} {sorted(parameters.given)} {parameters.given_uncertainty}"


def test_a_task_has_what_was_given_and_its_failures_are_one_line():
    worker, heard = Worker("identification"), []
    settings, given = {"record": ("a",)}, Parameters({"wire.mass": 0.09e-3}, {"wire.mass": 1e-6})
    assert worker.run(told, settings, given) == "('a',) ['wire.mass'] {'wire.mass': 1e-06}"
    for task, why in ((too_large, "MemoryError"), (breaks, "ZeroDivision"), (vanishes, "SIGKILL")):
        with pytest.raises(InputError, match=f"failed: .*{why}") as failed:
            worker.run(task, settings, given, lambda *said: heard.append(said))
        assert "\n" not in str(failed.value)
    assert heard == [(0.5, "half")]

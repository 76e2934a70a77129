"""A batch of records: order, failures of one record, interrupts, a cluster."""

import contextlib
import gc
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest
from planted import few_effects

from sma_bench.commands.answers import file_names, run_batch
from sma_bench.commands.options import run_command
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import protocol_record
from sma_bench.tasks.batch import DIAGNOSE, IDENTIFY, Task, do_tasks, run_task

psutil = pytest.importorskip("psutil")

_MANY = 60  # records that nobody has done before he is interrupted
_LONG = 120.0  # s, on a busy machine


@pytest.fixture(scope="session")
def bags(tmp_path_factory):
    """Two synthetic bags of wires with different resistance."""
    folder = tmp_path_factory.mktemp("bags")
    for ohm in (2.5, 2.9):
        parameters = Parameters.of_paper().replace({"wire.resistance": ohm})
        record = protocol_record("quick_staircase", parameters)
        write_record(folder / f"wire_{ohm}", list(record.signals.values()))
    return folder


def sma_bench(*words):
    command = [sys.executable, "-P", "-m", "sma_bench.cli", *map(str, words)]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, **streams, start_new_session=True)


@pytest.mark.slow
def test_results_come_in_input_order_and_a_bad_record_harms_no_other(
    bags, tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "not_a_bag").write_text("nothing")
    given = [bags / "wire_2.9", tmp_path / "not_a_bag", bags / "wire_2.5"]
    words = ["--jobs", 2, "--out", tmp_path / "out", "--json", tmp_path / "all.json"]
    assert run_command(run_batch, "batch", list(map(str, ["identify", *given, *words]))) == 2
    done = json.loads((tmp_path / "all.json").read_text())["records"]
    assert [entry["record"] for entry in done] == list(map(str, given))
    first, failed, last = done
    assert failed["result"] is None and "neither a bag" in failed["error"]
    ohm = [e["result"]["parameters"]["wire.resistance"]["value"] for e in (first, last)]
    assert ohm == pytest.approx([2.9, 2.5], rel=0.02)
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == ["wire_2.5.json", "wire_2.5.yaml", "wire_2.9.json", "wire_2.9.yaml"]
    alone = read_parameters(tmp_path / "out" / "wire_2.5.yaml")
    assert alone["wire.resistance"] == pytest.approx(2.5, rel=0.02)
    out = capsys.readouterr().out
    assert out.index("wire_2.9") < out.index("not_a_bag") < out.index("wire_2.5")
    assert "2 of 3 records done" in out
    assert re.search(r"wire.resistance +2 +2\.70 ± 0\.28 ± 0\.", out)  # mean, scatter, error of one
    # Files of records with one name do not meet.
    assert file_names(["/a/bag", "/b/other"]) == ["bag", "other"]
    assert file_names(["/a/bag", "/b/bag", "/c/1_bag"]) == ["1_bag", "2_bag", "3_1_bag"]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_the_end_of_a_batch_ends_all_processes_and_keeps_finished_results(bags, tmp_path, number):
    done = tmp_path / "out" / "1_wire_2.5.yaml"
    records = [bags / "wire_2.5", *[bags / "wire_2.9"] * (_MANY - 1)]
    process = sma_bench("batch", "identify", *records, "--out", done.parent, "--jobs", 2)
    end = time.monotonic() + _LONG
    while not done.exists() and process.poll() is None:
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.05)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    # Ctrl-C reaches all processes of a terminal.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    stdout, stderr = process.communicate(timeout=_LONG)
    assert psutil.wait_procs(workers, 20.0)[1] == []
    assert json.loads(done.with_suffix(".json").read_text())["parameters"]
    if number == signal.SIGKILL:
        return
    assert process.returncode == 130
    assert stderr.strip().endswith("sma-bench: interrupted")
    assert "Traceback" not in stderr
    done = re.search(rf"(\d+) of {_MANY} records done", stdout)
    assert done and 1 <= int(done[1]) < _MANY
    assert stdout.count("not done: interrupted") == _MANY - int(done[1])


class Deadly(str):
    """A kind of task that ends its process: asking for it does."""

    def __eq__(self, other):
        os.kill(os.getpid(), signal.SIGKILL)

    def __reduce__(self):
        return Deadly, (str(self),)


@pytest.mark.slow
def test_a_killed_process_costs_only_the_record_that_kills_it(bags):
    path, paper = str(bags / "wire_2.5"), Parameters.of_paper()
    done = dict(do_tasks([Task(kind, path, paper) for kind in (Deadly(IDENTIFY), IDENTIFY)], 2))
    assert done[0].error == f"{path}: its process was killed (out of memory?)"
    assert not done[1].error


def test_a_diagnosis_of_a_batch_has_its_verdict_and_its_parameters(bags):
    with few_effects(("supply_drop",)):
        done = run_task(Task(DIAGNOSE, str(bags / "wire_2.9"), Parameters.of_paper()))
    assert done.result["verdict"] and done.yaml.startswith("# Improved by sma-bench batch")


@pytest.mark.parametrize("answer", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xff" * 64, b""])
def test_an_address_without_a_scheduler_is_refused_in_one_line_within_seconds(answer, capfd):
    """Something else answers there, or nothing."""
    pytest.importorskip("distributed")
    held = []

    def serve():
        with contextlib.suppress(OSError):
            while True:
                held.append(server.accept()[0])
                held[-1].sendall(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        begin = time.monotonic()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=f"^dask scheduler {address}: [^\n]+$"):
            list(do_tasks([], 1, address))
        assert time.monotonic() - begin < 5.0
    gc.collect()  # a client that gave up would wait for eight seconds more, and say so
    assert capfd.readouterr().err == "" and time.monotonic() - begin < 8.0
    for connection in held:
        connection.close()


@pytest.mark.slow
def test_a_cluster_gives_the_same_as_this_process_until_it_is_lost(bags, tmp_path):
    distributed = pytest.importorskip("distributed")
    for address in ("nowhere", "inproc://127.0.0.1/1/1", "tcp://127.0.0.1:1"):
        with pytest.raises(InputError, match=f"^[^\n]*{address}[^\n]*$"):
            list(do_tasks([], 1, address))
    paths = [str(bags / "wire_2.5"), str(tmp_path / "missing"), str(bags / "wire_2.9")]
    tasks = [Task(IDENTIFY, path, Parameters.of_paper()) for path in paths]
    options = {"threads_per_worker": 1, "dashboard_address": None, "protocol": "tcp"}
    options |= {"host": "127.0.0.1", "local_directory": str(tmp_path), "processes": True}
    with distributed.LocalCluster(n_workers=0, **options) as cluster:
        address = cluster.scheduler_address
        with pytest.raises(InputError, match="has no workers"):
            list(do_tasks([], 1, address))
        cluster.scale(2)
        cluster.wait_for_workers(2, timeout=_LONG)
        spread = dict(do_tasks(tasks, 1, address))
        work = do_tasks(tasks * _MANY, 1, address)
        next(work)
        cluster.close()
        with pytest.raises(InputError, match=f"^dask scheduler {address}: [^\n]+$"):
            list(work)
    here = list(map(run_task, tasks))
    assert sorted(spread) == [0, 1, 2]
    assert spread[1].error and spread[1].error == here[1].error
    for k in (0, 2):
        assert spread[k].result["parameters"] == here[k].result["parameters"]
        assert spread[k].result["parameters"]["wire.resistance"]["n"] > 0

"""What a maintainer of robots asks of the package, a row each, played with ROS's own tools.

    python3 examination/acceptance/rows.py [ROW ...]

Runs where `ros2`, `launch` and colcon are found (a sourced Jazzy): builds this checkout in a new
workspace, plays each row with real processes and prints what it found. Ends with 1 where one fails.
Every row has tests of its own in test/, which need none of these tools.
"""

import http.client
import json
import re
import shlex
import shutil
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

if missing := [tool for tool in ("ros2", "colcon") if shutil.which(tool) is None]:
    raise SystemExit(f"{', '.join(missing)} not found: source a ROS 2 Jazzy setup file")

import pytest
from ros2_tools import CHECKOUT, ROOT, Stage, alive, until

sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "test" / "tools"))

from unfolding_tables import unfolding_tables

from examination.pieces import print_table
from sma_bench.nodes.start import NODES

OURS = ("ros2", "run", "sma_bench")
STRING, POWER = "std_msgs/msg/String", "sensor_msgs/msg/BatteryState"
QUICK = {"protocol": "quick_ramp", "autostart": "true", "nodes": "none"}
IN_TIME = 3.0  # s, for all nodes of a launch after Ctrl-C
DELAY = """\
import sys, numpy as np, sma_bench
r = sma_bench.load(sys.argv[1])
u, c = r["wire.voltage"], r["voltage_command"]
volts = c.values.reshape(len(c.time), -1)[:, 0]
def error(delay):
    rows = np.searchsorted(c.time, u.time - delay, side="right") - 1
    return np.mean((u.values - np.where(rows < 0, 0.0, volts[rows])) ** 2)
delays = np.arange(-0.2, 0.2, 0.001)
errors = [error(d) for d in delays]  # alike from one reading to the next: the latest
print(delays[np.flatnonzero(errors <= np.min(errors) * 1.001)[-1]])
late = sma_bench.identify(r, sys.argv[2], ["E3"]).experiments[0].details["delay"]
print(1e3 * late.value, 1e3 * late.std)
"""
GARBAGE = b"HTTP/1.1 400 Bad Request\r\n\r\n"
OTHER_NODE = """\
serial_bridge:
  ros__parameters:
    bench: {maximum_voltage: 3.0}
"""
TWICE = """\
time: {t: s}
signals:
- {signal: wire.voltage, column: u, unit: V, clock: t}
- {signal: wire.voltage, column: v, unit: V, clock: t}
"""


def is_a_line(told: str) -> bool:
    """Whether a command said one line, beside how long it is at it already, and ros2 run's own."""
    own = [line for line in told.splitlines() if not re.search(r" s gone|^\[ros2run\]", line)]
    return len(own) == 1


def no_reading_before_its_cause(stage: Stage) -> str:
    bag = stage.folder / "quick"
    bench = stage.launch(namespace="quick", record="true", output=bag, **QUICK)
    until(lambda: re.search("done: quick_ramp|aborted", bench.output), "it goes on")
    assert "aborted" not in bench.output, bench.output
    bench.ctrl_c()
    bench.ends_cleanly()
    told = stage.run(sys.executable, "-c", DELAY, str(bag), str(ROOT / "config" / "wire_rig.yaml"))
    delay, late, std = map(float, told.split()[-3:])
    assert 0.0 <= delay < 0.1 and abs(late) < 2.0 * std < 15.0, told
    told = stage.run(*OURS, "sma-bench", "info", str(bag))
    assert "clock" not in told.lower(), told
    late = f"{late:.1f} +- {std:.1f} ms"
    return f"voltage {1e3 * delay:.0f} ms after its command; delay by E3 {late}; no second clock"


def every_node_ends(stage: Stage, times: int = 6) -> str:
    start = "ros2", "daemon", "start"
    until(lambda: re.search("started|running", stage.run(*start, status=None)), "no daemon")
    slowest, stopped, kinds = 0.0, 0, {"camera": "true", "twin": "true", "record": "true"}
    for k in range(times):
        name = f"ends_{k}"
        bench = stage.launch("composite_bench", namespace=name, output=stage.folder / name,
                             **kinds, nodes="identification,diagnosis")  # fmt: skip
        bench.says("process started")
        if k % 2:
            until(lambda: bench.output.count("]: ready") >= 8, "not all ready")  # noqa: B023
            until(lambda: name in stage.run("ros2", "node", "list"), "not listed")  # noqa: B023
        else:
            time.sleep(0.7 * k)
        nodes = bench.nodes()
        begin = time.monotonic()
        bench.ctrl_c()
        until(lambda: not alive(nodes), "left over", 2.0 * IN_TIME)  # noqa: B023
        slowest, stopped = max(slowest, time.monotonic() - begin), stopped + len(nodes)
        bench.ends()

        def ghosts() -> list[str]:
            return re.findall(rf"/{name}/\w+", stage.run("ros2", "node", "list"))  # noqa: B023

        said = bench.output[-300:]
        until(lambda: not ghosts(), lambda: f"{ghosts()}: {said}", IN_TIME)  # noqa: B023
    assert slowest < IN_TIME, slowest
    return f"{stopped} processes, all gone within {slowest:.2f} s, no ghost in ros2 node list"


def a_start_beside_four_benches(stage: Stage) -> str:
    for k in range(4):
        stage.launch(namespace=f"beside_{k}", nodes="none")
    bench = stage.launch("composite_bench", namespace="fifth", autostart="true", nodes="none")
    bench.says("running: composite_triangle")
    time.sleep(10.0)
    assert "aborted" not in bench.output, bench.output[-600:]
    return "composite autostart beside four benches that start: runs, nothing aborted"


def colcon_test(stage: Stage) -> str:
    some = ("test/parameters", "test/protocols", "test/security/test_border.py", "test/commands")
    given = ("--pytest-args", *some, "-m", "not slow", "-q")
    stage.run("colcon", "test", *CHECKOUT, *given, status=None)
    told = stage.run("colcon", "test-result", "--verbose")
    (count,) = re.findall(r"Summary: (\d+) tests, 0 errors, 0 failures", told)
    return f"{count} tests, none failed, with launch and ros2cli installed"


def what_can_be_set(stage: Stage) -> str:
    bench = stage.launch(namespace="set", twin="true", record="true", output=stage.folder / "set")
    names = ("simulator", "experiment", "recorder", "twin", "identification")
    until(lambda: bench.output.count("]: ready") >= len(names), "not all ready")
    assert bench.output.count("]: ready") == len(names)
    for name in names:
        file = stage.folder / f"{name}.yaml"
        file.write_text(stage.run("ros2", "param", "dump", f"/set/{name}"))
        told = stage.run("ros2", "param", "load", f"/set/{name}", str(file))
        failed = [line for line in told.splitlines() if "fail" in line and "read" not in line]
        assert not failed, failed[:3]
    before = {*stage.folder.iterdir()}
    told = stage.run("ros2", "launch", "sma_bench", "wire_bench.launch.py", "protocol:=bogus",
                     status=1)  # fmt: skip
    assert "bogus: not one of" in told
    assert not {path for path in {*stage.folder.iterdir()} - before if path.is_dir()}
    told = stage.run(*OURS, "ir_camera", "--ros-args", "-p", "wires:=4", status=2)
    assert "wires" in told and "Traceback" not in told
    return "dump and load of 5 nodes taken, protocol:=bogus and wires:= refused, ready said once"


def a_package_as_ros2_sees_it(stage: Stage) -> str:
    told = stage.run("ros2", "pkg", "executables", "sma_bench").split()[1::2]
    assert {*NODES, "sma-bench"} <= {*told}, told
    described = stage.run("ros2", "pkg", "xml", "sma_bench")
    assert "<license" in described, described
    share = stage.folder / "install" / "sma_bench" / "share" / "sma_bench"
    layouts = [path.name for path in (share / "config" / "layouts").iterdir()]
    assert "rviz_composite.rviz" in layouts, layouts
    return f"{len(told)} executables, package.xml, {len(layouts)} layouts in the share folder"


def rates(stage: Stage) -> str:
    found = []
    for name in ("left", "right"):
        stage.launch(namespace=name, nodes="none").says("simulating")
    hearing = [stage.start("ros2", "topic", "hz", f"/{name}/wire/power")
               for name in ("left", "right")]  # fmt: skip
    for ear in hearing:
        until(lambda: ear.output.count("average rate") >= 8, "no rate")  # noqa: B023
        found.append(float(re.findall(r"average rate: ([\d.]+)", ear.output)[-1]))
    assert all(abs(rate - 100.0) < 2.0 for rate in found), found
    return f"wire/power of two benches at {found[0]:.1f} and {found[1]:.1f} Hz of 100"


def one_parameter_does_not_end_a_drive(stage: Stage) -> str:
    bench, commands = stage.driven("hostile")
    for name, value in (("protocol", "hold at 1 V" * 40), ("protocol", "x" * 300),
                        ("protocol", "/dev/zero"), ("wire.resistance", "1.0e300")):  # fmt: skip
        told = stage.run("ros2", "param", "set", "/hostile/experiment", name, value, status=None)
        assert "failed" in told.lower() and is_a_line(told), told
    seen = len(commands)
    until(lambda: len(commands) > seen + 40, "no commands any more")
    assert commands[-1].data[0] == 3.0 and bench.poll() is None, bench.output
    told = stage.run(*OURS, "sma-bench", "simulate", "--protocol", "hold at 1 V" * 40, "--out",
                     "none", status=2)  # fmt: skip
    assert is_a_line(told), told
    return "4 hostile values refused in a line each, the run goes on at 3 V; --protocol too"


def a_stop_is_confirmed_by_stamps(stage: Stage) -> str:
    pub = ("ros2", "topic", "pub", "-r", "20", "/stale/wire/power", POWER)
    stage.start(*pub, "{header: {stamp: {sec: 1700000000}}, voltage: 0.0, location: wire}")
    page = stage.start(*OURS, "sma-bench", "dashboard", "--namespace", "stale", "--port", "0")
    page.says("http://")
    parts = urlsplit(re.findall(r"http://\S+", page.output)[0])

    def ask(method: str, what: str, **headers: str) -> tuple[int, str]:
        connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=30.0)
        connection.request(method, parts.path + what, headers=headers)
        with connection.getresponse() as response:
            return response.status, response.read().decode()

    def stop() -> dict[str, Any]:
        return json.loads(ask("POST", "stop")[1])

    until(lambda: "Nothing to stop" not in stop()["said"], "it hears no voltage")
    answer = stop()
    assert not answer["stopped"], answer
    status, _ = ask("GET", "", Origin="http://[")
    assert status == 403
    return f"messages of 2023: {answer['said']!r}; Origin http://[ gets {status}"


def tables_that_unfold(stage: Stage) -> str:
    sizes = []
    for table in unfolding_tables(stage.folder):
        told = stage.run("bash", "-c", 'ulimit -v 4000000 && exec "$@"', "info", *OURS, "sma-bench",
                         "info", str(table), status=2)  # fmt: skip
        assert is_a_line(told), told
        sizes.append(f"{table.name} of {table.stat().st_size / 1e3:.0f} kB")
    return f"a line of info within 4 GB: {', '.join(sizes)}"


def borders(stage: Stage) -> str:
    tool = (*OURS, "sma-bench")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with suppress(OSError):
                while True:
                    server.accept()[0].sendall(GARBAGE)

        threading.Thread(target=answer, daemon=True).start()
        begin = time.monotonic()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        told = stage.run(*tool, "batch", "identify", "none", "--dask", address, status=2)
        took = time.monotonic() - begin
    assert is_a_line(told), told
    table, lab = stage.folder / "t.csv", stage.folder / "twice.yaml"
    table.write_text("t,u,v\n0,1,2\n1,2,3\n")
    lab.write_text(TWICE)
    told = stage.run(*tool, "import", str(table), "--map", str(lab), "--out", "t", status=2)
    assert "expected one column" in told, told
    words = [*tool, "simulate", "--protocol", "ramp", "--out", str(stage.folder / "both")]
    two = [stage.start(*words) for _ in range(2)]
    until(lambda: all(one.poll() is not None for one in two), "they go on")
    assert sorted(one.returncode for one in two) == [0, 2], [one.output for one in two]
    return f"--dask at garbage: a line, {took:.0f} s; a signal twice, two writers: a line each"


def a_parameter_file_is_obeyed_or_refused(stage: Stage) -> str:
    file = stage.folder / "other.yaml"
    file.write_text(OTHER_NODE)
    given = ("--ros-args", "-r", "__ns:=/bench", "--params-file", str(file))
    told = stage.run(*OURS, "serial_bridge", *given, status=2)
    assert "Traceback" not in told and "other.yaml" in told, told
    told = stage.run("ros2", "launch", "sma_bench", "wire_bench.launch.py", f"params:={file}",
                     status=1)  # fmt: skip
    assert "other.yaml" in told
    heard = stage.hear("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
    bench = stage.launch(namespace="limits", nodes="none")
    wanted = "/limits/experiment: limits"

    def shown() -> list[str]:
        return [s.message for m in list(heard) for s in m.status if s.name == wanted]

    until(shown, "no limits in the diagnostics")
    assert "maximum_voltage 10 (" in shown()[0]
    bench.says(f"limits: {shown()[0]}")
    return f"a section of another node refused by node and launch; {shown()[0][:60]}..."


def checked(check: str, *options: str) -> Callable[[Stage], str]:
    """A row that is a small check of examination/check: the heads of its tables, and sums."""

    def play(stage: Stage) -> str:
        command = shlex.join((sys.executable, "-m", "examination.check", check, *options))
        told = stage.run("bash", "-c", f"cd {shlex.quote(str(ROOT))} && {command}")
        sums = re.findall(r"(?m)^(?:power fails|synthetic|mutations|host:|firmware:|all  ).*", told)
        return "; ".join(" ".join(line.split()) for line in sums)

    return play


ROWS: dict[str, tuple[str, Callable[[Stage], str]]] = {
    "1": ("a reading is never stamped before its cause", no_reading_before_its_cause),
    "2": ("every node ends, none stays as a ghost", every_node_ends),
    "3": ("a start under load", a_start_beside_four_benches),
    "4": ("colcon test where launch is installed", colcon_test),
    "5": ("what can be set, what is refused", what_can_be_set),
    "6": ("the package as ros2 pkg sees it", a_package_as_ros2_sees_it),
    "7": ("rates", rates),
    "8": ("no parameter ends a node that drives", one_parameter_does_not_end_a_drive),
    "9": ("a stop is confirmed by stamps", a_stop_is_confirmed_by_stamps),
    "10": ("small tables that unfold to gigabytes", tables_that_unfold),
    "11": ("borders", borders),
    "12": ("a parameter file is obeyed or refused", a_parameter_file_is_obeyed_or_refused),
    "13": ("no power cut leaves a wrong reason", checked("power_cuts", "--cuts", "60")),
    "14": ("no false cut", checked("soak", "--only", "host", "firmware", "--hours", "4")),
    "15": ("the safety tests can fail", checked("mutations", "--number", "6", "--tests-only"))}


def main(wanted: list[str]) -> int:
    lines, failed = [], 0
    with tempfile.TemporaryDirectory(prefix="sma_bench_acceptance_") as folder:
        stage = Stage(Path(folder))
        for number in wanted or ROWS:
            what, play = ROWS[number]
            begin, word = time.monotonic(), "ok"
            try:
                found = play(stage)
            except (Exception, pytest.fail.Exception) as error:
                word, found = "FAIL", " ".join(f"{type(error).__name__}: {error}".split())[-400:]
            finally:
                stage.clear()
            failed += word == "FAIL"
            lines.append((number, what, word, f"{time.monotonic() - begin:.0f}", found))
            print(*lines[-1], flush=True)
        stage.run("ros2", "daemon", "stop", status=None)
    print()
    print_table(("row", "what", "", ">s", "found"), lines)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

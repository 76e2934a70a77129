"""Progress: shares, time left, one line on a terminal, sparse ones elsewhere, never on stdout."""

import contextlib
import os
import pty
import re
import subprocess
import sys

import pytest
from rich.cells import cell_len

from sma_bench.commands.terminal import WorkState

WORK = """
import sys, time
from sma_bench.commands import terminal
terminal.FIRST_SHOWN, terminal.FIRST_LINE, terminal.NEXT_LINE = 0.1, 0.3, 0.3
with terminal.progress("work") as report:
    for k in range(10):
        report(k / 10, "数据 of a long name that no terminal of forty columns can show whole")
        time.sleep(0.1)
print("result")
"""


@pytest.mark.parametrize("whole", [50, 400])
def test_the_time_left_follows_the_machine_and_never_stands_still(whole):
    now, left = [100.0], []
    state = WorkState(lambda: now[0])
    for second in range(1, whole):
        now[0] += 1.0
        if second % 5 == 0:
            state.report(second / whole)
        left.append((second, state.left))
    soon = [(second, said) for second, said in left if second >= 0.1 * whole][:-5]
    assert all(said == pytest.approx(whole - second, rel=0.3) for second, said in soon)
    quarter = whole // 4
    falls = [a[1] - b[1] for a, b in zip(soon, soon[quarter:], strict=False)]
    assert min(falls) > quarter / 2


def test_without_a_terminal_progress_is_lines_on_standard_error():
    command = [sys.executable, "-c", WORK]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout == "result\n"
    lines = process.stderr.splitlines()
    assert 1 <= len(lines) <= 4
    assert all(re.match(r"sma-bench: work: \d+%, .*\(数据 of", line) for line in lines)


def test_on_a_terminal_progress_is_a_line_that_fits_and_disappears():
    ours, its = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "40"}
    command, seen = [sys.executable, "-c", WORK], b""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=its, env=environment)
    os.close(its)
    with contextlib.suppress(OSError):  # the other end is closed
        while chunk := os.read(ours, 4096):
            seen += chunk
    os.close(ours)
    assert process.wait(10.0) == 0 and process.stdout.read() == b"result\n"
    screen = seen.decode()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", re.sub(r"\x1b\[[0-9;]*m", "", screen))
    frames = [frame for frame in re.split(r"[\r\n]+", plain) if frame.strip()]
    assert any("…" in frame and re.search(r"\d+%, \d+ s left", frame) for frame in frames)
    assert max(cell_len(frame) for frame in frames) <= 40
    assert screen.rstrip().endswith("\x1b[2K")  # the last output clears the line

"""Progress: one line on a terminal, which fits and vanishes; nothing elsewhere, nor on stdout."""

import contextlib
import os
import pty
import re
import subprocess
import sys

from rich.cells import cell_len

WORK = """
import time
from sma_bench.commands import terminal
with terminal.progress("work") as report:
    for k in (0, 3, 1, 5, 9):
        report(k / 10, "数据 of a long name that no such narrow terminal can show whole" * (k < 9))
        time.sleep(0.3)
print("result")
"""


def test_a_terminal_gets_a_line_that_fits_and_vanishes_and_a_file_gets_none():
    command, seen = [sys.executable, "-c", WORK], b""
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("result\n", "")
    ours, its = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "60"}
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
    shares = [int(re.search(r"(\d+)%", frame)[1]) for frame in frames]
    assert shares == sorted(shares) and shares[-1] == 90
    assert any(re.search(r"\d+:\d+:\d+ left \(数.*…", frame) for frame in frames)
    assert max(cell_len(frame) for frame in frames) <= 60
    assert screen.rstrip().endswith("\x1b[2K")  # the last that is done is to wipe the line

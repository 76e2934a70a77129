"""Hostile bytes against the firmware's logic: two million inputs, under sanitizers.

The firmware's own C files, compiled for this computer with the address and undefined behaviour
sanitizers (test/firmware/host/fuzz.c). After every input: nothing is driven without arming; armed,
no duty exceeds its limit, the stop byte stops, and silence ends it. A crash, a broken rule or a
part that takes longer than its time ends with 1. A few minutes.

    ./bench check fuzz [--inputs 2000000] [--seed 1]
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "firmware"))

from host_firmware import build_program

from examination.pieces import options_of

PART = 100_000
LONGEST = 600.0  # s of a part, which takes some ten: it hangs
AT_ONCE = 2


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("fuzz", __doc__, argv, inputs=(2_000_000, "of hostile bytes"),
                         seed=(1, "of the first part"))  # fmt: skip
    if shutil.which("cc") is None:
        print("check fuzz: no C compiler (cc) here", file=sys.stderr)
        return 2
    parts = [(min(PART, options.inputs - begin), options.seed + k)
             for k, begin in enumerate(range(0, options.inputs, PART))]  # fmt: skip
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(AT_ONCE) as workers:
        program = build_program("fuzz.c", Path(folder))
        outcomes = list(workers.map(lambda part: fuzzed(program, *part), parts))
    problems = [problem for _, problem in outcomes if problem]
    tried, drove_on, stopped = map(sum, zip(*(counts for counts, _ in outcomes), strict=True))
    print(f"{tried:,} inputs, {drove_on:,} of them heard while driving and driven on as they may, "
          f"{stopped:,} ended stopped; {len(problems)} of {len(parts)} parts failed; "
          f"{time.monotonic() - started:.0f} s")
    for problem in problems:
        print(problem)
    return 1 if problems else 0


def fuzzed(program: Path, inputs: int, seed: int) -> tuple[tuple[int, int, int], str]:
    """(inputs, drove on, stopped) of one part, and what went wrong, "" for nothing."""
    try:
        ended = subprocess.run([program, str(inputs), str(seed)], capture_output=True, text=True,
                               timeout=LONGEST, check=False)  # fmt: skip
    except subprocess.TimeoutExpired:
        return (0, 0, 0), f"seed {seed}: hangs"
    if ended.returncode:
        return (0, 0, 0), f"seed {seed}: {(ended.stderr.strip() or 'crashed').splitlines()[0]}"
    tried, drove_on, stopped = map(int, re.findall(r"\d+", ended.stdout))
    return (tried, drove_on, stopped), ""

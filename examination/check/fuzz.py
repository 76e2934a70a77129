"""Hostile bytes against the firmware's logic: two million inputs, under sanitizers.

The firmware's own C files, compiled for this computer with the address and undefined behaviour
sanitizers (test/firmware/host/fuzz.c, with these rules: nothing is driven without arming, no duty
exceeds its limit, the stop byte and silence end it). A few minutes; exits with 1 if a part fails.

    ./bench check fuzz [--inputs 2000000] [--seed 1]
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "firmware"))

from host_firmware import build_program

from examination.pieces import AT_ONCE, in_pieces, options_of

PART = 100_000
LONGEST = 600.0  # s: a part normally takes 10 s; after this it counts as hanging


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("fuzz", __doc__, argv, inputs=(2_000_000, "of hostile bytes"),
                         seed=(1, "of the first part"), **AT_ONCE)
    if shutil.which("cc") is None:
        print("check fuzz: no C compiler (cc) here", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        program = str(build_program("fuzz.c", Path(folder)))
        parts = [(program, min(PART, options.inputs - begin), options.seed + k)
                 for k, begin in enumerate(range(0, options.inputs, PART))]
        counts, said = zip(*in_pieces(fuzzed, parts, options), strict=True)
    tried, drove_on, stopped = map(sum, zip(*counts, strict=True))
    problems = [text for text in said if text]
    print(f"{tried:,} inputs, {drove_on:,} of them while driving and allowed to go on, "
          f"{stopped:,} ended stopped; {len(problems)} of {len(parts)} parts failed", *problems,
          sep="\n")
    return 1 if problems else 0


def fuzzed(program: str | Path, inputs: int, seed: int) -> tuple[tuple[int, ...], str]:
    """(inputs, drove on, stopped) of one part, and the error, "" for none."""
    words = [program, str(inputs), str(seed)]
    try:
        ended = subprocess.run(words, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return (0, 0, 0), f"seed {seed}: hangs"
    if ended.returncode:
        said = (ended.stderr.strip() or "crashed").splitlines()[0]
        return (0, 0, 0), f"seed {seed}: {said}"
    return tuple(map(int, re.findall(r"\d+", ended.stdout))), ""

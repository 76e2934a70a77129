"""Whole commands as processes: help, identification, diagnosis; cold (nothing compiled) and warm.

A figure has the time on the wall and the processor's; the limits are held against the second, which
is the first on a machine that does nothing else.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import sma_bench
from examination.perf.measuring import Figure
from examination.perf.records import ROOT, diagnosis_case, staircase_bag

COMPILING = 22.0  # s, what it took before the diagnosis was made faster


def commands(tiny: bool = False) -> Iterator[Figure]:
    """Help, identification of a short and of a 30-minute bag, diagnosis, a cold start."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        short = staircase_bag(folder / "short", 30.0 if tiny else 60.0)
        commands = {
            "--help": ["--help"],
            "identify --help": ["identify", "--help"],
            "identify a minute's bag": ["identify", str(short)],
        }
        most = dict(zip(commands, (1.0, 1.0, 2.0), strict=True))
        if not tiny:
            gap, paper = map(str, diagnosis_case(folder))
            long = staircase_bag(folder / "long", 1800.0)
            commands["identify a 30-minute bag"] = ["identify", str(long)]
            commands["diagnose a composite bag"] = ["diagnose", gap, "--params", paper]
        for case, words in commands.items():
            runs = [run(words) for _ in range(1 if tiny else 4)][-3:]
            wall, warm = np.median(runs, axis=0)
            yield Figure(case, "warm: processor", warm, "s", most=most.get(case, np.inf))
            yield Figure(case, "warm: on the wall", wall, "s")
            if not tiny and "--help" not in words:
                wall, cold = _cold(folder / "cold", words)
                yield Figure(case, "cold: processor", cold, "s")
                yield Figure(case, "cold: on the wall", wall, "s")
        if not tiny:
            yield Figure(case, "compiling: processor", cold - warm, "s", most=COMPILING)


def run(words: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """Seconds on the wall and of the processor for `sma-bench words`, children included.

    Raises RuntimeError if it fails.
    """
    command = [sys.executable, "-P", "-m", "sma_bench.cli", *words]
    variables = {**os.environ, **(environment or {})}
    begin, before = time.perf_counter(), os.times()
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=variables)
    wall, after = time.perf_counter() - begin, os.times()
    if process.returncode:
        raise RuntimeError(f"{' '.join(words)}: {process.stderr.strip()}")
    used = after.children_user - before.children_user
    return wall, used + after.children_system - before.children_system


def _cold(copy: Path, words: Sequence[str]) -> tuple[float, float]:
    """From a copy of the package in which nothing has been compiled yet."""
    shutil.rmtree(copy, ignore_errors=True)
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(sma_bench.__file__).parent, copy / "sma_bench", ignore=ignored)
    for shared in ("package.xml", "config"):
        (copy / shared).symlink_to(ROOT / shared)
    return run(words, {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache")})

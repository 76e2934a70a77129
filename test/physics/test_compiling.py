"""Machine code: compiled once after an installation, by one process."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sma_bench import compiled

pytest.importorskip("numba")

ONCE = """
import numpy as np
from sma_bench import compiled
from sma_bench.estimation import noise_model as noise

function, waits = noise._add_powers, []
compiled.when_compiling(lambda: waits.append(1))
before = compiled.is_compiled(function)
for count in (5.0, 6.0):
    function(np.arange(count), *(np.array([0.5]) for _ in range(4)), np.zeros(1))
print(before, compiled.is_compiled(function), len(waits), sum(function.stats.cache_misses.values()))
"""


@pytest.fixture
def run(tmp_path):
    """Start a program with a package that has no machine code yet."""
    source = Path(compiled.__file__).parent
    leave = shutil.ignore_patterns("__pycache__", "*.html")
    shutil.copytree(source, tmp_path / "sma_bench", ignore=leave)
    (tmp_path / "package.xml").symlink_to(source.parent / "package.xml")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    return lambda: subprocess.Popen([sys.executable, "-P", "-c", ONCE], stdout=subprocess.PIPE,
                                    text=True, env=environment)  # fmt: skip


def test_one_of_two_processes_compiles_a_function_and_the_waiting_one_reports_it_once(
    run, tmp_path
):
    running = [run() for _ in range(2)]
    printed = [process.communicate()[0].split() for process in running]
    assert sorted(misses for *_, misses in printed) == ["0", "1"]
    for before, after, waits, _ in printed:
        assert after == "True" and waits == ("0" if before == "True" else "1")
    assert run().communicate()[0].split() == ["True", "True", "0", "0"]
    # Numba detects a change of a function's own file; the package's digest, one of a neighbour's.
    with (tmp_path / "sma_bench" / "estimation" / "solver.py").open("a") as source:
        source.write("# changed\n")
    assert run().communicate()[0].split() == ["False", "True", "1", "1"]

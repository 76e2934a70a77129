"""Machine code: made once after an installation, by one process, to the numbers of plain Python."""

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

function, told = noise._add_powers, []
compiled.when_compiling(lambda: told.append("waits"))
before = compiled.is_compiled(function)
for count in (5.0, 6.0):
    function(np.arange(count), *(np.array([0.5]) for _ in range(4)), np.zeros(1))
print(before, compiled.is_compiled(function), len(told), sum(function.stats.cache_misses.values()))
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


def test_of_processes_that_need_a_function_one_compiles_and_each_that_waits_says_so_once(
    run, tmp_path
):
    running = [run() for _ in range(2)]
    said = [process.communicate()[0].split() for process in running]
    assert sorted(misses for *_, misses in said) == ["0", "1"]
    for before, after, told, _ in said:
        assert after == "True" and told == ("0" if before == "True" else "1")
    assert run().communicate()[0].split() == ["True", "True", "0", "0"]
    # Numba notices a change of a function's own file; of a neighbour's, the room's digest does.
    with (tmp_path / "sma_bench" / "estimation" / "solver.py").open("a") as source:
        source.write("# changed\n")
    assert run().communicate()[0].split() == ["False", "True", "1", "1"]

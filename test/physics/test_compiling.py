"""What is said while functions are compiled, once after an installation."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sma_bench import compiled
from sma_bench.physics import core

numba = pytest.importorskip("numba")


def test_whether_there_is_machine_code_yet(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "_cache_folder", lambda room: tmp_path / room.name)
    assert not compiled.is_compiled(core.run)
    (tmp_path / "physics").mkdir()
    (tmp_path / "physics" / "core.solve_side-228.py311.nbi").touch()
    assert not compiled.is_compiled(core.run)
    (tmp_path / "physics" / "core.run-308.py311.nbi").touch()
    assert compiled.is_compiled(core.run)


def test_nothing_has_to_be_waited_for_without_numba(monkeypatch):
    monkeypatch.setattr(compiled, "numba", None)
    assert compiled.is_compiled(core.run)
    compiled.when_compiling(lambda: pytest.fail("nothing is ever compiled"))


def test_a_function_that_is_compiled_is_told_of_once():
    told = []
    listener = compiled.when_compiling(lambda: told.append("compiling"))
    twice = numba.njit(lambda x: 2.0 * x)
    try:
        assert (twice(1.5), twice(2.0)) == (3.0, 4.0)
    finally:
        numba.core.event.unregister("numba:compile", listener)
    assert told == ["compiling"]


FRESH = """
import time
import numpy as np
from sma_bench import compiled
from sma_bench.estimation import noise_model as noise

told = []
compiled.run_plain_meanwhile(told.append)
function = noise._add_powers
call = compiled.Meanwhile(function)

def powers():
    found = np.zeros(1)
    call(np.arange(5.0), *(np.array([0.5]) for _ in range(4)), found)
    return found[0]

first = powers()
assert not function.overloads, "the first call waited for the compiler"
end = time.monotonic() + 120.0
while told[-1] != "compiled" and time.monotonic() < end:
    time.sleep(0.02)
# Another process has compiled, and this one has read it.
print(len(told), compiled.is_compiled(function), sum(function.stats.cache_hits.values()) > 0)
print(first == powers())
"""


@pytest.fixture
def fresh(tmp_path):
    """Environment of a package that has no machine code yet."""
    source = Path(compiled.__file__).parent
    shutil.copytree(
        source, tmp_path / "sma_bench", ignore=shutil.ignore_patterns("__pycache__", "*.html")
    )
    (tmp_path / "package.xml").symlink_to(source.parent / "package.xml")
    return {**compiled.os.environ, "PYTHONPATH": str(tmp_path)}


def test_a_fresh_install_computes_at_once_while_another_process_compiles(fresh):
    done = subprocess.run(
        [sys.executable, "-P", "-c", FRESH], capture_output=True, text=True, check=False, env=fresh
    )
    assert done.stdout.splitlines() == ["2 True True", "True"], done.stderr


AT_ONCE = """
import numpy as np
from sma_bench.estimation import noise_model as noise

function = noise._add_powers
function(np.arange(5.0), *(np.array([0.5]) for _ in range(4)), np.zeros(1))
print(sum(function.stats.cache_misses.values()))
"""


def test_of_processes_that_need_a_function_at_once_one_compiles(fresh):
    running = [
        subprocess.Popen([sys.executable, "-P", "-c", AT_ONCE], stdout=subprocess.PIPE, env=fresh)
        for _ in range(2)
    ]
    assert sum(int(process.communicate()[0]) for process in running) == 1


def test_plain_python_and_machine_code_give_the_same_numbers(monkeypatch):
    from sma_bench.parameters import Parameters
    from sma_bench.physics import kernel, simulate

    time = 0.05 * np.arange(400)
    volts = 8.0 * np.abs(np.sin(0.3 * time))
    fast = simulate(Parameters.of_paper(), time, volts)
    monkeypatch.setattr(kernel, "RUN", compiled.plain(core.run))
    slow = simulate(Parameters.of_paper(), time, volts)
    assert np.ptp(fast.martensite_fraction) > 0.3  # the wire transforms
    for name in ("temperature", "martensite_fraction", "stress"):
        np.testing.assert_allclose(getattr(slow, name), getattr(fast, name), rtol=1e-9, atol=1e-12)

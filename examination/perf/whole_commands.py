"""Whole commands as processes: help, identification, diagnosis; cold (nothing compiled) and warm.

A figure has the time on the wall and the processor's; the aims are held against the second, which
is the first on a machine that does nothing else.
"""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numba
import numpy as np

import sma_bench
from examination.perf import stiff_rivals
from examination.perf.figures import Figure, at_most
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.physics import simulate
from sma_bench.records import Signal
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import protocol_record

ROOT = Path(__file__).resolve().parents[2]
_COMPILING = 22.0  # s, what it took before the diagnosis was made faster
_RATE = "void(f8[:], f8[:], f8[:], f8[:,:], f8[:], i8[:], f8[:])"
_LEVELS = (1.0, 5.5)  # V
_NOISE = {"wire.voltage": 2e-3, "wire.current": 0.02, "wire.temperature": 0.1}


def measure(tiny: bool = False) -> list[Figure]:
    """Help, identification of a short and of a 30-minute bag, diagnosis, a cold start."""
    outcomes: list[Figure] = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        short, long = folder / "short", folder / "long"
        write_record(short, staircase_signals(30.0 if tiny else 60.0))
        commands: dict[str, tuple[Sequence[str], float | None]] = {
            "--help": (["--help"], 1.0),
            "identify --help": (["identify", "--help"], 1.0),
            "identify a minute's bag": (["identify", str(short)], 2.0),
        }
        if not tiny:
            write_record(long, staircase_signals(1800.0))
            gap, paper = diagnosis_case(folder)
            commands["identify a 30-minute bag"] = (["identify", str(long)], None)
            commands["diagnose a composite bag"] = (
                ["diagnose", str(gap), "--params", str(paper)], None,
            )
        for case, (words, aim) in commands.items():
            runs = [run(words) for _ in range(1 if tiny else 4)][-3:]
            wall, cpu = np.median(runs, axis=0)
            outcomes.append(
                Figure(case, "warm: processor", float(cpu), "s", at_most(aim) if aim else None)
            )
            outcomes.append(Figure(case, "warm: on the wall", float(wall), "s"))
        if not tiny:
            cold = _cold(folder, {case: commands[case][0] for case in list(commands)[2:]})
            outcomes += [*cold, *_price_of_compiling(outcomes + cold)]
    return outcomes


def _price_of_compiling(outcomes: Sequence[Figure]) -> list[Figure]:
    """What a fresh installation pays once: seconds, and in a unit that any machine has."""
    case = "diagnose a composite bag"
    spent = {f.measure: f.value for f in outcomes if f.case == case}
    more = spent["cold: processor"] - spent["warm: processor"]
    for _ in range(2):  # the first loads or compiles what it calls as well
        begin = time.process_time()
        numba.njit(error_model="numpy")(stiff_rivals.rate.py_func).compile(_RATE)
        unit = time.process_time() - begin
    return [
        Figure(case, "compiling: processor", more, "s", at_most(_COMPILING)),
        Figure(case, "compiling: of what the rivals' right side takes", more / unit, "x"),
    ]


def staircase_signals(duration: float, rate: float = 100.0) -> list[Signal]:
    """Synthetic: a wire led up and down a staircase of voltages, with the noise of sensors."""
    time_ = np.arange(int(duration * rate)) / rate
    steps = np.linspace(*_LEVELS, 6)
    levels = np.concatenate([steps, steps[::-1], [0.0]])
    voltage = levels[(time_ / 5.0).astype(int) % levels.size]
    wire = simulate(Parameters.defaults(), time_, voltage)
    true = {
        "wire.voltage": ("V", voltage),
        "wire.current": ("A", wire.current[:, 0]),
        "wire.temperature": ("K", wire.temperature_reading[:, 0]),
    }
    rng = np.random.default_rng(0)
    return [
        Signal(name, unit, time_, values + rng.normal(0.0, _NOISE[name], time_.size))
        for name, (unit, values) in true.items()
    ]


def diagnosis_case(folder: Path) -> tuple[Path, Path]:
    """A synthetic composite bag with an effect that its parameter file does not know."""
    paper = read_parameters(ROOT / "config" / "composite_rig.yaml")
    hidden = paper.replace({"effect.side_heat_coupling.conductance": 0.03})
    record = protocol_record("composite_diagnosis_steps", hidden)
    bag, file = folder / "gap", folder / "paper.yaml"
    write_record(bag, list(record.signals.values()))
    write_parameters(file, paper)
    return bag, file


def run(words: Sequence[str], environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """Seconds on the wall and of the processor for `sma-bench words`, children included.

    Raises RuntimeError if it fails.
    """
    command = [sys.executable, "-P", "-m", "sma_bench.cli", *words]
    begin, before = time.perf_counter(), os.times()
    process = subprocess.run(
        command, capture_output=True, text=True, check=False,
        env={**os.environ, **(environment or {})},
    )
    wall, after = time.perf_counter() - begin, os.times()
    if process.returncode:
        raise RuntimeError(f"{' '.join(words)}: {process.stderr.strip()}")
    used = after.children_user - before.children_user
    return wall, used + after.children_system - before.children_system


def _cold(folder: Path, commands: Mapping[str, Sequence[str]]) -> list[Figure]:
    """From a copy of the package in which nothing has been compiled yet."""
    copy = folder / "cold"
    outcomes: list[Figure] = []
    for case, words in commands.items():
        shutil.rmtree(copy, ignore_errors=True)
        shutil.copytree(
            Path(sma_bench.__file__).parent, copy / "sma_bench",
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        for shared in ("package.xml", "config"):
            (copy / shared).symlink_to(ROOT / shared)
        wall, cpu = run(words, {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "cache")})
        outcomes.append(Figure(case, "cold: processor", cpu, "s"))
        outcomes.append(Figure(case, "cold: on the wall", wall, "s"))
    return outcomes

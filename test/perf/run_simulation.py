"""How long the compiled simulation takes, beside a stiff solver of scipy on the same problem.

The solver's right-hand side is plain Python and it restarts at each of the 1200 samples, so its
time says what one would wait with scipy, not how good LSODA is. At rtol 1e-7 it is itself off by
the millionth that is asked for; at 1e-10 it is the reference.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import Boundary, Simulation, simulate

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "physics"))

from stiff_solver import Wires, solve, triangle  # noqa: E402

HOUR = 3_600_001
SOLVER_TOLERANCES = (1e-10, 1e-7)
COMPOSITE = {
    "bench.channels": ("front_1", "front_2", "back_1", "back_2"),
    "bench.channel_sides": ("front", "front", "back", "back"),
}

FIRST_CALL = """
import time
import numpy as np
from sma_bench.parameters import Parameters
from sma_bench.physics import simulate
start = time.perf_counter()
simulate(Parameters.defaults(), np.arange(3.0), np.zeros((3, 1)))
print(time.perf_counter() - start)
"""


def measure(minutes: float = 10.0) -> dict[str, float]:
    """Seconds of compiling and simulating, and of the solver on a triangle of `minutes`."""
    numbers = {**_first_calls(), **_hours(), **_against_solver(minutes)}
    for name, value in numbers.items():
        print(f"  {name:58s} {value:12.4g}")
    return numbers


def _first_calls() -> dict[str, float]:
    with TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        return {
            f"first simulation of a process, {how} [s]": float(
                subprocess.run(
                    [sys.executable, "-c", FIRST_CALL],
                    check=True, capture_output=True, text=True, env=environment,
                ).stdout
            )
            for how in ("compiling", "from cache")
        }


def _hours() -> dict[str, float]:
    wire = Parameters.defaults()
    composite = wire.replace(COMPOSITE)
    clock = np.arange(HOUR) * 1e-3
    wave = triangle(clock, 6.25, 60.0)
    four = np.stack([wave, 0.95 * wave, 6.25 - wave, wave], axis=1)
    runs: dict[str, Callable[[], Simulation]] = {
        "one clamped wire": lambda: simulate(wire, clock, wave),
        "one wire at held stress": lambda: simulate(
            wire, clock, wave, boundary=Boundary.held_stress(100e6)
        ),
        "one clamped wire, latent heat": lambda: simulate(
            wire.replace({"effect.latent_heat.heat": 12e3}), clock, wave
        ),
        "four wires, composite": lambda: simulate(composite, clock, four),
    }
    return {f"hour at 1 kHz, {name} [s]": _best(run)[0] for name, run in runs.items()}


def _against_solver(minutes: float) -> dict[str, float]:
    wire = Parameters.defaults()
    clock = np.arange(0.0, 60.0 * minutes + 0.1, 0.5)
    wave = triangle(clock, 6.25, 60.0)[:, np.newaxis]
    ours, run = _best(lambda: simulate(wire, clock, wave))
    title = f"{minutes:g} minute triangle at 2 Hz"
    numbers = {f"{title}, compiled [s]": ours}
    for tolerance in SOLVER_TOLERANCES:
        start = time.perf_counter()
        reference = solve(Wires(wire, np.array([0]), None), clock, wave, "LSODA", tolerance)
        seconds = time.perf_counter() - start
        label = f"{title}, LSODA rtol {tolerance:g}"
        numbers[f"{label} [s]"] = seconds
        numbers[f"{label}, difference of xi, relative"] = _difference(
            run.martensite_fraction, reference["martensite_fraction"]
        )
        numbers[f"{label}, difference of sigma, relative"] = _difference(
            run.stress, reference["stress"]
        )
        numbers[f"{label}, times slower"] = seconds / ours
    return numbers


def _difference(values: np.ndarray, reference: np.ndarray) -> float:
    return float(np.abs(values - reference).max() / np.ptp(reference))


def _best(run: Callable[[], Simulation], times: int = 3) -> tuple[float, Simulation]:
    seconds = []
    for _ in range(times):
        start = time.perf_counter()
        result = run()
        seconds.append(time.perf_counter() - start)
    return min(seconds), result


if __name__ == "__main__":
    measure()

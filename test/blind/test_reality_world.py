"""Worlds: what they accept, their labels, repeatability, and independence from the model."""

import ast
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from reality_rig import COMPOSITE, drive

from examination.blind import reality
from examination.blind.reality import FEATURES, World, happen
from sma_bench import compiled
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

ROOT = Path(__file__).resolve().parents[2]
ALLOWED = ("sma_bench.errors", "sma_bench.compiled", "sma_bench.parameters",
           "sma_bench.parameters.parameters", "sma_bench.parameters.audit")  # fmt: skip

EVERYTHING = {
    "resistance_austenite_change": -0.1, "resistance_temperature_coefficient": 3e-4,
    "supply_resistance": 0.1, "current_limit": 0.74, "contact_growth": 0.05,
    "latent_heat": 8e3, "convection_by_correlation": 1.0, "silicone_heat_capacity": 0.02,
    "side_conductance": 1e-3, "ambient_rate": 0.003, "ambient_wave": 0.5, "draught": 0.2,
    "grain_spread": 2.0, "kinetics_smoothness": 0.5, "return_point_memory": 0.5,
    "transition_drift": 3.0, "plastic_strain": 1e-3, "stress_influence_factor_austenite": 1.1,
    "stress_influence_factor_martensite": 0.9, "r_phase": 0.1, "transformation_lag": 0.1,
    "unrecovered_strain": 0.1, "matrix_relaxation": 0.2, "opposing": 0.2,
    "stiffness_asymmetry": 0.2, "slack": 1e-3, "friction": 5e-4, "stiffening": 100.0,
    "clamp_slip": 1e-3, "clamp_slip_time": 15.0,
}  # fmt: skip


def test_reality_imports_nothing_that_simulates() -> None:
    for path in Path(reality.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, path
                names = [node.module or ""]
            else:
                continue
            for name in names:
                inside = name.startswith("examination.blind.reality")
                assert inside or not name.startswith("sma_bench") or name in ALLOWED, path


def test_everything_at_once_runs_and_still_bends_both_ways() -> None:
    outcome = happen(World(COMPOSITE, EVERYTHING), *drive("triangles"))
    assert {f.name for f in FEATURES if not f.setting and f.stage != "sensor"} <= {*EVERYTHING}
    assert np.all(np.isfinite(outcome.stress))
    assert np.all((outcome.martensite_fraction >= 0.0) & (outcome.martensite_fraction <= 1.0))
    assert 0.005 < outcome.deflection.max() < 0.04
    assert -0.04 < outcome.deflection.min() < -0.005


def test_same_world_does_the_same_to_the_bit() -> None:
    world = World(COMPOSITE, EVERYTHING)
    time, voltage = drive("nested", 20.0)
    first, second = happen(world, time, voltage), happen(world, time, voltage)
    for name in ("temperature", "surface", "current", "stress", "deflection", "ambient"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


@pytest.mark.skipif(compiled.numba is None, reason="numba is not installed: it runs plain anyway")
def test_plain_python_does_the_same_as_compiled() -> None:
    script = (
        "import sys; sys.modules['numba'] = None; sys.path[:0] = sys.argv[1:3]\n"
        "from test_reality_world import EVERYTHING, COMPOSITE, World, drive, happen\n"
        "outcome = happen(World(COMPOSITE, EVERYTHING), *drive('steps', 8.0), 0.25)\n"
        "print(outcome.deflection[-1].hex(), outcome.temperature[-1, 0].hex())"
    )
    process = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script, str(ROOT), str(Path(__file__).parent)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    plain = [float.fromhex(word) for word in process.stdout.split()]
    outcome = happen(World(COMPOSITE, EVERYTHING), *drive("steps", 8.0), 0.25)
    expected = [outcome.deflection[-1], outcome.temperature[-1, 0]]
    np.testing.assert_allclose(plain, expected, rtol=1e-9)
    assert importlib.util.find_spec("numba") is not None


@pytest.mark.parametrize(
    ("features", "told"),
    [
        ({"slak": 0.1}, "no feature slak"),
        ({"slack": -0.1}, "slack is -0.1, expected 0 to 0.03 1"),
        ({"opposing": float("nan")}, "opposing is nan"),
    ],
)
def test_impossible_feature_is_refused(features: dict[str, float], told: str) -> None:
    with pytest.raises(InputError, match=told):
        World(COMPOSITE, features)


def test_rig_that_is_no_composite_is_refused() -> None:
    with pytest.raises(InputError, match="load.kind is clamped"):
        World(Parameters.defaults())
    with pytest.raises(InputError, match="deflection_per_strain is not given"):
        World(COMPOSITE.replace({"composite.deflection_per_strain": 0.0}))


@pytest.mark.parametrize(
    ("time", "shape", "fine", "told"),
    [
        ([0.0, 0.1], (2, 3), 1.0, r"expected \(n,\) and \(n, 4\)"),
        ([0.0, 0.0], (2, 4), 1.0, r"time\[1\] is 0 s"),
        ([0.0, float("nan")], (2, 4), 1.0, "not finite"),
        ([0.0, 0.1], (2, 4), 0.0, "fine is 0"),
    ],
)
def test_impossible_drive_is_refused(
    time: list[float], shape: tuple[int, int], fine: float, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        happen(World(COMPOSITE), time, np.zeros(shape), fine)

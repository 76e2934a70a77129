"""Isobaric tests for E6 and E9: of a material that follows the model, and measured ones."""

from pathlib import Path

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics.kernel import cooled_fraction, heated_fraction
from sma_bench.physics.material import modulus
from sma_bench.records import open_record
from sma_bench.records.instruments import Branch, Cycle, IsobaricRecord

MEASURED = Path(__file__).parents[1] / "data" / "sma_react" / "input"
SEVEN_CYCLES = MEASURED / "preprocessor_samples" / "isobaric_7cycle.txt"


def alloy(number: int) -> list[IsobaricRecord]:
    """Measured loops of an alloy."""
    folder = MEASURED / f"cal_sample_{number}"
    return [open_record(path) for path in sorted(folder.glob("*MPa.txt"))]


def isobaric(
    stress: float, parameters: Parameters, *, noise: float = 2e-5, seed: int = 1,
    shift: float = 0.0, directions: tuple[str, ...] = ("heating", "cooling"),
    span: tuple[float, float] = (293.15, 413.15), points: int = 600,
    zero: float = 0.05,
) -> IsobaricRecord:  # fmt: skip
    """One cycle at one stress (Pa)."""
    rng = np.random.default_rng(seed)
    theta, ambient = parameters["wire.thermal_expansion_factor"], 296.15
    eps_l = parameters["wire.maximum_recoverable_strain"]
    branches = []
    for direction in directions:
        t = np.linspace(*span, points)
        fraction = heated_fraction if direction == "heating" else cooled_fraction
        xi = fraction(t - shift, stress, parameters)
        strain = (stress - theta * (t - ambient)) / modulus(xi, parameters) - eps_l * (1.0 - xi)
        strain = zero + strain + noise * rng.standard_normal(points)
        order = slice(None) if direction == "heating" else slice(None, None, -1)
        branches.append(
            Branch(direction, t[order], strain[order], np.full(points, stress))  # type: ignore[arg-type]
        )
    return IsobaricRecord(Path(f"{stress / 1e6:.0f} MPa.txt"), f"s/{stress / 1e6:.0f} MPa {seed}",
                          stress, "1", (Cycle(1, tuple(branches)),))  # fmt: skip

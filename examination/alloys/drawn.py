"""An alloy, drawn as NiTi wires of the field differ, and what five kinds of test show of it.

Every test has what no test shows by itself: a thermometer's class, the lag of a specimen, a gauge's
and a micrometer's error; and a noise of its own, from tiny to 10 K (or 10 %): cycles and specimens
that differ from each other, as well as readings that scatter.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.records import DscRecord, Record, Signal
from sma_bench.records.dsc import DscSegment
from sma_bench.records.isobaric import IsobaricRecord, read_isobaric
from sma_bench.records.tensile import TensileRecord

Array = NDArray[np.float64]
CELSIUS = 273.15
THERMOMETER, LAG = 0.9, 0.7  # K: class 1 of IEC 60584, a specimen that follows by seconds
CALORIMETER, PAN = 0.5, 5.0  # K, s
GAUGE, DIAMETER = 0.01, 0.01  # relative, of a gauge length and of a diameter


@dataclass(frozen=True)
class Alloy:
    """Contract names to numbers, SI."""

    numbers: dict[str, float]

    def __getitem__(self, name: str) -> float:
        return self.numbers[f"wire.{name}"]

    def shifted(self, stress: float) -> tuple[float, float, float, float]:
        """A_s, A_f, M_s, M_f under stress (Pa), K."""
        up = stress / self["stress_influence_austenite"]
        down = stress / self["stress_influence_martensite"]
        return (
            self["austenite_start_temperature"] + up, self["austenite_finish_temperature"] + up,
            self["martensite_start_temperature"] + down,
            self["martensite_finish_temperature"] + down,
        )


def draw_alloy(random: np.random.Generator) -> Alloy:
    """Near the paper's or far from it; 90 % of C between 5 and 10 MPa/K."""
    centre, half = random.normal(345.0, 30.0), 8.0 * np.exp(0.35 * random.standard_normal())
    widths = 14.0 * np.exp(0.4 * random.standard_normal(2))
    soft = float(np.clip(30e9 * np.exp(0.25 * random.standard_normal()), 18e9, 50e9))
    stiff = float(np.clip(60e9 * np.exp(0.2 * random.standard_normal()), 1.3 * soft, 95e9))
    influence = 7.1e6 * np.exp(0.21 * random.standard_normal())
    return Alloy({
        "wire.austenite_start_temperature": centre + half - widths[0] / 2.0,
        "wire.austenite_finish_temperature": centre + half + widths[0] / 2.0,
        "wire.martensite_start_temperature": centre - half + widths[1] / 2.0,
        "wire.martensite_finish_temperature": centre - half - widths[1] / 2.0,
        "wire.stress_influence_austenite": influence,
        "wire.stress_influence_martensite": influence * np.exp(0.05 * random.standard_normal()),
        "wire.martensite_modulus": soft,
        "wire.austenite_modulus": stiff,
        "wire.maximum_recoverable_strain": random.uniform(0.025, 0.055),
        "wire.thermal_expansion_factor": -random.uniform(6.6e-6, 9e-6) * soft,
    })


def draw_noise(random: np.random.Generator, least: float, most: float) -> float:
    """By its logarithm."""
    return float(np.exp(random.uniform(np.log(least), np.log(most))))


def _martensite(temperature: Array, low: float, high: float) -> Array:
    """Fraction on the way through a range: a cosine, 1 below and 0 above."""
    inside = np.clip((temperature - low) / (high - low), 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * inside))


# --- E6, E9: temperature cycles under held stresses, as a load frame's tables.


def isobaric_tests(
    alloy: Alloy, random: np.random.Generator, folder: Path, stresses: Array,
    between: float | None = None, cycles: int | None = None,
) -> list[IsobaricRecord]:
    """One file a stress (Pa), read back; `between` K by which cycles differ, drawn if None."""
    between = draw_noise(random, 0.02, 10.0) if between is None else between
    reading = draw_noise(random, 0.02, 10.0)  # K: of a row
    if cycles is None:  # who sees cycles differ repeats them
        few = max(between, reading / 10.0) < 0.3
        cycles = int(random.integers(1, 4) if few else random.integers(3, 9))
    offset, lag = THERMOMETER * random.standard_normal(), LAG * random.standard_normal()
    gauge = 1.0 + GAUGE * random.standard_normal()
    section = (1.0 + DIAMETER * random.standard_normal()) ** 2
    records = []
    for k, stress in enumerate(stresses):
        a_s, a_f, m_s, m_f = alloy.shifted(stress)
        low, high = m_f - random.uniform(25.0, 35.0), a_f + random.uniform(25.0, 35.0)
        rows = []
        for _ in range(cycles):
            differs = between * random.standard_normal()
            for rising in (True, False):
                t = np.linspace(low, high, 260)[:: 1 if rising else -1]
                xi = _martensite(t, a_s, a_f) if rising else _martensite(t, m_f, m_s)
                modulus = alloy["austenite_modulus"] + xi * (
                    alloy["martensite_modulus"] - alloy["austenite_modulus"]
                )
                tension = stress - alloy["thermal_expansion_factor"] * (t - 296.15)
                strain = tension / modulus + alloy["maximum_recoverable_strain"] * xi
                # What the thermometer reads: the specimen is behind it, both ways.
                shown = t + differs + offset + (lag if rising else -lag)
                rows.append((shown + reading * random.standard_normal(len(t)),
                             gauge * strain + 5e-5 * random.standard_normal(len(t))))
        temperature, strain = (np.concatenate(part) for part in zip(*rows, strict=True))
        path = folder / f"isobaric_{k}.csv"
        lines = [
            f"{t - CELSIUS:.4f},{e:.7f},{stress * section / 1e6:.4f}"
            for t, e in zip(temperature, strain, strict=True)
        ]
        path.write_text("\n".join(["Temperature (C),Strain (mm/mm),Stress (MPa)", *lines, ""]))
        records.append(read_isobaric(path))
    return records


# --- E5: heat flow of a calorimeter.


def calorimetry(alloy: Alloy, random: np.random.Generator) -> DscRecord:
    """Heating and cooling scans at one rate, peaks of half a sine."""
    between = draw_noise(random, 0.02, 5.0)  # K: of a scan from the others
    cycles = int(random.integers(2, 4) if between < 0.3 else random.integers(4, 8))
    rate = float(random.choice([5.0, 10.0])) / 60.0
    behind = PAN * random.standard_normal() * rate
    offset = CALORIMETER * random.standard_normal()
    latent, heat = random.uniform(8e3, 25e3), random.uniform(400.0, 520.0)
    a_s, a_f, m_s, m_f = alloy.shifted(0.0)
    low, high = m_f - 45.0, a_f + 45.0
    segments = []
    start = 0.0
    for cycle in range(cycles):
        differs = between * random.standard_normal()
        for rising in (True, False):
            time = np.arange(0.0, (high - low) / rate, 0.5)
            t = low + rate * time if rising else high - rate * time
            first, last = (a_s, a_f) if rising else (m_f, m_s)
            inside = np.clip((t - first) / (last - first), 0.0, 1.0)
            peak = latent * np.pi / (2.0 * (last - first)) * np.sin(np.pi * inside)
            sign = 1.0 if rising else -1.0
            flow = sign * rate * (heat * (1.0 + 4e-4 * (t - 320.0)) + peak)
            flow = flow + 2e-5 * rate * latent * random.standard_normal(len(t))
            shown = t + differs + offset + sign * behind
            mass = 10e-6
            segments.append(DscSegment(
                2 * cycle + (1 if rising else 2), "heating" if rising else "cooling", sign * rate,
                start + time, mass * flow, np.zeros(len(t)), shown, shown,
            ))
            start += float(time[-1]) + 0.5
    # A program that knows which way its heat flows says so.
    return DscRecord(Path("drawn.dsc"), 10e-6, {"Endotherm": "up"}, tuple(segments))


# --- E7: tensile curves of both phases.


def tensile_tests(alloy: Alloy, random: np.random.Generator) -> list[TensileRecord]:
    """Some curves of martensite and of austenite, phase in the file."""
    between = draw_noise(random, 2e-4, 0.10)  # relative, of a specimen from the others
    reading = draw_noise(random, 1e5, 2e6)  # Pa
    count = int(random.integers(1, 4) if between < 0.003 else random.integers(3, 7))
    gauge = 1.0 + GAUGE * random.standard_normal()
    section = (1.0 + DIAMETER * random.standard_normal()) ** 2
    records = []
    for phase in ("martensite", "austenite"):
        for k in range(count):
            modulus = alloy[f"{phase}_modulus"] * (1.0 + between * random.standard_normal())
            plateau = random.uniform(100e6, 160e6) if phase == "martensite" else 450e6
            elastic, detwinned = plateau / modulus, 0.045
            knots = [(0.0, 0.0), (elastic, plateau), (detwinned, plateau + 1e9 * 0.03)]
            if phase == "martensite":
                knots.append((detwinned + 0.012, plateau + 1e9 * 0.03 + 0.012 * modulus))
            strain = np.linspace(0.0, knots[-1][0], 1200)
            stress = np.interp(strain, *zip(*knots, strict=True)) * section
            stress = stress + reading * random.standard_normal(len(strain))
            records.append(TensileRecord(
                Path(f"{phase}_{k}.csv"), strain * gauge, stress, None, (), phase
            ))
    return records


# --- E8: force of a clamped wire on a staircase of temperature below A_s.


def clamped_staircase(alloy: Alloy, random: np.random.Generator, section: float) -> Record:
    """Force (N) of a wire of this section (m2) in a chamber; the camera's scale is off."""
    reading = draw_noise(random, 0.02, 10.0)  # K of a sample
    top = alloy["austenite_start_temperature"] - 6.0
    levels = np.linspace(top - 45.0, top, 8)
    levels = np.concatenate([levels, levels[::-1]])
    time = np.arange(0.0, 30.0 * len(levels), 0.05)
    target = levels[np.minimum((time // 30.0).astype(int), len(levels) - 1)]
    t = np.empty_like(time)
    t[0] = target[0]
    for i in range(1, len(time)):
        t[i] = t[i - 1] + (target[i] - t[i - 1]) * 0.05 / 2.0
    actual = section * (1.0 + DIAMETER * random.standard_normal()) ** 2
    stress = 120e6 + alloy["thermal_expansion_factor"] * (t - levels[0])
    force = stress * actual + 0.02 * random.standard_normal(len(time))
    # Of gain, emissivity and spot, as the camera's data sheet and its setting leave them.
    gain = float(np.prod(1.0 + np.array([0.0115, 0.021, 0.02]) * random.standard_normal(3)))
    shown = CELSIUS + (t - CELSIUS) / gain + reading * random.standard_normal(len(t))
    signals = {
        "force": Signal("force", "N", time + 0.013, force),
        "wire.temperature": Signal("wire.temperature", "K", time, shown),
    }
    return Record(Path("clamped"), 0, signals)

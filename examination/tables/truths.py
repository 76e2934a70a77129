"""Forty true tables: bench runs, DSC, isobaric and tensile tests. Synthetic data, in SI units."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from sma_bench.arrays import Array

TABLES = 40
_DATA = yaml.safe_load(Path(__file__).with_name("dialects.yaml").read_text(encoding="utf-8"))
RIGS = _DATA["rigs"]


@dataclass(frozen=True)
class Quantity:
    """One true column: `signal` of the contract (or of the instrument's record), what it is, its
    values (n,) in SI, how the file writes it (`offset` added, `sign` before)."""

    signal: str
    kind: str
    values: Array
    offset: float = 0.0
    sign: float = 1.0


@dataclass(frozen=True)
class Truth:
    """A true table: `time` (n,) s, its columns, and of DSC the mass in kg."""

    kind: str
    time: Array
    columns: tuple[Quantity, ...]
    mass: float = 0.0

    @property
    def is_bench(self) -> bool:
        """Whether the file is imported; else it is an instrument's, and read as it is."""
        return self.kind in RIGS

    @property
    def is_extension(self) -> bool:
        """Whether a tensile test has an extension and no strain."""
        return any(column.kind == "extension" for column in self.columns)


def true_table(number: int, seed: int) -> Truth:
    """Table `number` (0 to 39) of a seed."""
    rng = np.random.default_rng([40, seed, number])
    turn, place = divmod(number, len(_DATA["kinds"]))
    kind = _DATA["kinds"][place]
    if kind == "tensile":
        return _tensile(kind, rng, is_extension=turn % 2 == 1)
    return {"dsc": _dsc, "isobaric": _isobaric}.get(kind, _bench)(kind, rng)


def _bench(kind: str, rng: np.random.Generator) -> Truth:
    """A wire that is heated in two or three steps and cools between them."""
    rows, rate = int(rng.integers(90, 260)), float(rng.choice([4.0, 5.0, 10.0, 20.0]))
    time = np.arange(rows) / rate
    drive = np.zeros(rows)
    steps = int(rng.integers(2, 4))
    level = rng.uniform(1.0, 4.0)
    for k in range(steps):
        begin = rows * (0.1 + 0.9 * k / steps)
        on = (np.arange(rows) >= begin) & (np.arange(rows) < begin + 0.5 * rows / steps)
        drive[on] = level * rng.uniform(0.7, 1.0)
    slow = rows / rate * rng.uniform(0.03, 0.08)
    room, gain = rng.uniform(291.0, 300.0), rng.uniform(40.0, 75.0) / level**2
    rise = np.zeros(rows)
    for k in range(1, rows):
        rise[k] = rise[k - 1] + (gain * drive[k] ** 2 - rise[k - 1]) / (slow * rate)
    ohms = rng.uniform(1.5, 6.0)
    moved = -4e-3 * rng.uniform(0.5, 1.5) / (1.0 + np.exp(-(rise - 35.0) / 5.0))
    moved -= moved[0]
    temperature = Quantity("wire.temperature", "temperature", room + rise)
    volts = Quantity("wire.voltage", "voltage", drive)
    amperes = Quantity("wire.current", "current", drive / ohms)
    zero = rng.choice([2e-5, 4e-4, rng.uniform(0.01, 0.04)])
    position = Quantity("elongation", "length", moved, zero, -1.0 if zero < 1e-3 else 1.0)
    force = Quantity("force", "force", 5.0 - 200.0 * moved)
    room_now = Quantity("ambient.temperature", "ambient", room + 0.3 * np.sin(time / time[-1]))
    columns: list[Quantity] = []
    if kind == "clamped":
        columns = [volts, amperes, temperature]
        columns += [room_now] if rng.random() < 0.4 else []
    elif kind == "spring":
        columns = [volts, amperes, position, force]
        columns += [temperature] if rng.random() < 0.5 else []
    elif kind == "duty":
        duty = drive / drive.max() * rng.uniform(0.3, 0.9)
        columns = [temperature, Quantity("wire.voltage", "duty", duty), position]
        columns += [Quantity("wire.current", "current", 12.0 * np.sqrt(duty) / ohms)]
    else:
        back = np.roll(drive, rows // 6)
        tip = 3e-3 * (rise - np.roll(rise, rows // 6)) / rise.max()
        columns = [Quantity("front.voltage", "voltage", drive),
                   Quantity("back.voltage", "voltage", back),
                   Quantity("deflection", "length", tip - tip[0])]  # fmt: skip
    order = rng.permutation(len(columns) - (kind == "duty" and rng.random() < 0.5))
    return Truth(kind, time, tuple(columns[k] for k in order))


def _dsc(kind: str, rng: np.random.Generator) -> Truth:
    """Heating and cooling at one rate, a peak each way."""
    rows, rate = int(rng.integers(200, 320)), 10.0 / 60.0
    turn = int(rows * 0.5)
    step = rng.choice([1.0, 2.0])
    temperature = 253.15 + rate * step * np.minimum(np.arange(rows), 2 * turn - np.arange(rows))
    is_heating = np.arange(rows) < turn
    height = temperature.max() - 253.15
    centre = np.where(is_heating, 253.15 + 0.6 * height, 253.15 + 0.4 * height)
    peak = rng.uniform(0.1, 0.3) * np.exp(-(((temperature - centre) / (0.06 * height)) ** 2))
    flow = np.where(is_heating, 1.0, -1.0) * (0.05 + peak)  # W/g
    mass = float(np.round(rng.uniform(5e-6, 20e-6), 9))
    columns = (Quantity("temperature", "temperature", temperature),
               Quantity("heat_flow", "heat flow", flow * 1e3 * mass))  # fmt: skip
    return Truth(kind, np.arange(rows) * step, columns, mass)


def _isobaric(kind: str, rng: np.random.Generator) -> Truth:
    """A cycle of temperature at one stress."""
    rows = int(rng.integers(160, 300))
    phase = np.abs(1.0 - np.abs(np.linspace(-1.0, 1.0, rows)))
    low, high = rng.uniform(290.0, 300.0), rng.uniform(380.0, 400.0)
    temperature = low + (high - low) * phase
    centre = np.where(np.arange(rows) < rows // 2, 355.0, 335.0)
    strain = 0.005 + 0.03 / (1.0 + np.exp((temperature - centre) / 3.0))
    stress = rng.uniform(50e6, 250e6) * np.ones(rows) * (1.0 + 1e-3 * np.sin(np.arange(rows)))
    columns = (Quantity("temperature", "temperature", temperature),
               Quantity("strain", "strain", strain), Quantity("stress", "stress", stress))
    return Truth(kind, np.arange(rows) * 2.0, columns)


def _tensile(kind: str, rng: np.random.Generator, is_extension: bool) -> Truth:
    """Loading and unloading; half of them as extension and force."""
    rows = int(rng.integers(120, 260))
    strain = 0.012 * np.minimum(np.linspace(0.0, 1.6, rows), np.linspace(1.6, 0.0, rows) + 0.4)
    stress = rng.uniform(30e9, 60e9) * np.minimum(strain, 0.008 + 0.2 * (strain - 0.008))
    if is_extension:
        columns = (Quantity("strain", "extension", 0.06 * strain),
                   Quantity("stress", "force", 1.9635e-7 * stress))  # fmt: skip
    else:
        columns = (Quantity("strain", "strain", strain), Quantity("stress", "stress", stress))
    return Truth(kind, np.arange(rows) * 0.5, columns)

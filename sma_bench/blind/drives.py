"""What the rig is driven with: triangles, steps, staircases and holds, with rests between."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sma_bench.blind.rigs import CHANNELS, SIDES
from sma_bench.parameters import Parameters

Array = npt.NDArray[np.float64]

COMMAND_PERIOD = 0.02  # s: an Arduino that is told 50 times a second
FAMILIES = ("triangle", "step", "staircase", "trapezoid")
DURATIONS = (100.0, 120.0)
_FIRST = (3.0, 7.0)
_REST = (4.0, 9.0)
# Steady temperature that the peak voltage would hold, K above A_f at the highest stress: full
# cycles end above it, partial ones turn round inside the transformation.
_FULL = (8.0, 24.0)
_PARTIAL = (-16.0, -3.0)
_SWIFT = 1.09  # a ramp lags behind its steady temperature
_SWIFT_FAMILIES = ("triangle",)


@dataclass(frozen=True)
class Pulse:
    """Voltage of one side's wires against time, piecewise linear, zero before and after.

    Attributes:
        side: front or back.
        times, volts: corners, in s since the start of the record and V.
    """

    side: str
    times: tuple[float, ...]
    volts: tuple[float, ...]


@dataclass(frozen=True)
class Drive:
    """The pulses of one record."""

    family: str
    duration: float
    pulses: tuple[Pulse, ...]

    def voltage(self, time: Array) -> Array:
        """(n, 4) V at the wires, held since the last command."""
        told = np.floor(time / COMMAND_PERIOD + 1e-6) * COMMAND_PERIOD
        sides = {side: np.zeros(len(time)) for side in ("front", "back")}
        for pulse in self.pulses:
            volts = np.interp(told, pulse.times, pulse.volts, left=0.0, right=0.0)
            sides[pulse.side] += volts
        return np.column_stack([sides[side] for side in SIDES])

    def grid(self, period: float) -> Array:
        """(n,) times from 0 to the end."""
        return np.asarray(np.arange(int(round(self.duration / period)) + 1) * period, dtype=float)

    def to_json(self) -> dict[str, object]:
        """Plain dictionary for a label."""
        return {
            "family": self.family,
            "duration": self.duration,
            "pulses": [[p.side, list(p.times), list(p.volts)] for p in self.pulses],
        }

    @classmethod
    def from_json(cls, document: Mapping) -> "Drive":
        """What `to_json` wrote."""
        pulses = tuple(Pulse(s, tuple(t), tuple(v)) for s, t, v in document["pulses"])
        return cls(document["family"], document["duration"], pulses)


def draw_drives(truth: Parameters, rng: np.random.Generator) -> dict[str, Drive]:
    """Drives of a record and of the one to hold out, of two different families."""
    families = rng.choice(FAMILIES, size=2, replace=False)
    return {
        name: _draw_drive(str(family), truth, rng)
        for name, family in zip(("record", "hold_out"), families, strict=True)
    }


def _draw_drive(family: str, truth: Parameters, rng: np.random.Generator) -> Drive:
    duration = float(np.round(rng.uniform(*DURATIONS), 1))
    side = str(rng.choice(["front", "back"]))
    # Both sides finish a cycle first; a loop inside a loop and a partial cycle are in every drive.
    plan = ["full", "full", "nested", *rng.permutation(["partial", "partial", "full"])]
    start, pulses = float(rng.uniform(*_FIRST)), []
    for reach in plan:
        pulse = _draw_pulse(family, str(reach), side, start, truth, rng)
        if pulse.times[-1] + _REST[0] > duration:
            break
        pulses.append(pulse)
        start = pulse.times[-1] + float(rng.uniform(*_REST))
        side = "back" if side == "front" else "front"
    return Drive(family, duration, tuple(pulses))


def _draw_pulse(
    family: str, reach: str, side: str, start: float, truth: Parameters, rng: np.random.Generator
) -> Pulse:
    above = rng.uniform(*(_FULL if reach == "full" else _PARTIAL))
    peak = _volts_for(truth, hottest(truth) + above)
    peak *= _SWIFT if family in _SWIFT_FAMILIES else 1.0
    corners = _SHAPES[family](rng)
    if reach == "nested":
        # Turned inside the transformation to austenite, and back inside the one to martensite.
        low = _volts_for(truth, _martensite_middle(truth) + rng.uniform(-4.0, 2.0)) / peak
        corners = _with_dip(corners, low, rng)
    times = np.round(start + np.array([t for t, _ in corners]), 2)
    volts = np.round(peak * np.array([v for _, v in corners]), 3)
    return Pulse(side, tuple(times.tolist()), tuple(volts.tolist()))


_Corners = list[tuple[float, float]]


def _triangle(rng: np.random.Generator) -> _Corners:
    rise, fall = rng.uniform(5.0, 10.0, 2)
    return [(0.0, 0.0), (rise, 1.0), (rise + fall, 0.0)]


def _step(rng: np.random.Generator) -> _Corners:
    return [(0.0, 1.0), (rng.uniform(6.0, 12.0), 1.0)]


def _trapezoid(rng: np.random.Generator) -> _Corners:
    rise, hold, fall = rng.uniform(2.5, 6.0, 3)
    return [(0.0, 0.0), (rise, 1.0), (rise + hold, 1.0), (rise + hold + fall, 0.0)]


def _staircase(rng: np.random.Generator) -> _Corners:
    levels = np.sort(rng.uniform(0.6, 0.95, 2)).tolist()
    corners, now = [], 0.0
    for level in [*levels, 1.0, *levels[::-1][: int(rng.integers(0, 2))]]:
        stay = rng.uniform(2.5, 5.0)
        corners += [(now, level), (now + stay, level)]
        now += stay + COMMAND_PERIOD
    return corners


_SHAPES = {
    "triangle": _triangle,
    "step": _step,
    "staircase": _staircase,
    "trapezoid": _trapezoid,
}


def _with_dip(corners: _Corners, low: float, rng: np.random.Generator) -> _Corners:
    """The shape up to its peak, a fall to `low`, and the last part from the peak on again."""
    last = max(k for k, (_, v) in enumerate(corners) if v == 1.0)
    turn = corners[last][0]
    fall, stay, rise = rng.uniform((2.0, 2.0, 2.0), (3.5, 4.0, 3.5))
    dip = [(turn + fall, low), (turn + fall + stay, low), (turn + fall + stay + rise, 1.0)]
    end = turn + fall + stay + rise + rng.uniform(2.0, 4.0)
    after = [(t - turn + end, v) for t, v in corners[last + 1 :]]
    return [*corners[: last + 1], *dip, (end, 1.0), *after]


def hottest(truth: Parameters) -> float:
    """K at which the last martensite is gone, at full contraction of one side."""
    alpha = truth["composite.deflection_per_strain"]
    beta = truth["composite.stress_per_deflection_front"]
    modulus, strain = truth["wire.austenite_modulus"], truth["wire.maximum_recoverable_strain"]
    wires = len(CHANNELS) // 2
    deflection = wires * strain * modulus / (beta + wires * modulus / alpha)
    stress = beta * deflection / wires
    return float(
        truth["wire.austenite_finish_temperature"]
        + stress / truth["wire.stress_influence_austenite"]
    )


def _martensite_middle(truth: Parameters) -> float:
    names = ("wire.martensite_start_temperature", "wire.martensite_finish_temperature")
    shift = hottest(truth) - truth["wire.austenite_finish_temperature"]
    return float(np.mean([truth[name] for name in names]) + 0.4 * shift)


def _volts_for(truth: Parameters, temperature: float) -> float:
    """V that hold a wire at a temperature: V^2/R = h A (T - T_inf)."""
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    excess = temperature - truth["environment.ambient_temperature"]
    return float(np.sqrt(truth["wire.resistance"] * loss * excess))

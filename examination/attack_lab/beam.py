"""A beam with a wire on each side (E10): eqs. (1), (6) to (13) with the corrected stiffness;
nothing of `sma_bench.physics`."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from examination.attack_lab.instruments import ZERO, Alloy, faulty
from sma_bench.records import Record, Signal

SIDES = ("front_1", "back_1")
STEP, DURATION, RATE = 0.01, 36.0, 50.0  # s, s, Hz


@dataclass(frozen=True)
class Beam:
    """Two wires on a strip of silicone; alpha in m, beta in Pa/m."""

    alloy: Alloy
    alpha: float = 0.9
    beta: float = 4.5e9
    resistance: float = 2.7
    heat_loss: float = 0.024  # W/K
    capacity: float = 0.04  # J/K
    room: float = 296.0

    def driven(self, volts) -> tuple[np.ndarray, np.ndarray]:
        """Kelvin and deflection over the volts of one side."""
        alloy, kelvin, deflection = self.alloy, np.empty(len(volts)), np.empty(len(volts))
        hot, xi, turn, sigma, warm = self.room, 1.0, (self.room, 1.0), 0.0, True
        for k, v in enumerate(volts.tolist()):
            before = hot
            steady = self.room + v * v / self.resistance / self.heat_loss
            hot = steady + (hot - steady) * math.exp(-STEP * self.heat_loss / self.capacity)
            if (hot > before) != warm and abs(hot - before) > 1e-9:
                warm, turn = hot > before, (before, xi)

            def fraction(stress, hot=hot, warm=warm, turn=turn):
                now, then = (float(alloy.martensite(t, stress, warm)) for t in (hot, turn[0]))
                if warm:
                    return turn[1] * now / max(then, 1e-12)
                return 1.0 - (1.0 - turn[1]) * (1.0 - now) / max(1.0 - then, 1e-12)

            def excess(stress, hot=hot, fraction=fraction):
                """What the wire pulls with beyond what the strip asks for."""
                x = fraction(stress)
                e = alloy.modulus(x)
                free = alloy.theta * (hot - self.room) + alloy.eps_l * e * (1.0 - x)
                return free / (self.beta + e / self.alpha) * self.beta - stress

            if abs(excess(sigma)) > 1e3:
                sigma = brentq(excess, -50e6, 400e6, xtol=1e2)
            xi = fraction(sigma)
            kelvin[k], deflection[k] = hot, sigma / self.beta
        return kelvin, deflection


def bend(beam: Beam, random, *, gains=None, swapped=False, stuck=None, **faults: float) -> Record:
    """Triangles of the front, then of the back wire; readings with `gains` by quantity.

    `clip` m where the range sensor ends, `late` s of its stamps, `residual` m from 14 s on.
    """
    f = faulty({"clip": math.inf, "late": 0.0, "residual": 0.0}, faults)
    time = np.arange(0.0, DURATION, STEP)
    stamps = np.arange(0.0, DURATION - STEP, 1.0 / RATE)
    signals: dict[str, Signal] = {}

    def read(name, unit, truth, noise, zero=0.0):
        quantity = name.rpartition(".")[2]
        values = np.interp(stamps, time, truth) - zero
        values = (gains or {}).get(quantity, 1.0) * values + zero
        values = values + noise * random.standard_normal(len(stamps))
        if name == "deflection":
            values = np.minimum(values, f.clip)
        if stuck == quantity:
            values[len(values) // 3 :] = values[len(values) // 3]
        delay = f.late if name == "deflection" else 0.0
        signals[name] = Signal(name, unit, stamps + delay, values)

    tips = []
    for name, seen, at in zip(SIDES, SIDES[::-1] if swapped else SIDES, (1, 14), strict=True):
        volts = np.interp(time, [0, at, at + 4.0, at + 8.0, 36], [0, 0, 2.6, 0, 0])
        kelvin, deflection = beam.driven(volts)
        read(f"{name}.voltage", "V", volts, 0.004)
        read(f"{name}.current", "A", volts / beam.resistance, 0.015)
        read(f"{seen}.temperature", "K", kelvin, 0.1, ZERO)
        tips.append(deflection)
    read("deflection", "m", tips[0] - tips[1] + f.residual * (time > 14.0), 1e-4)
    return Record(Path("beam"), 0, signals)

"""Records of small benches with a planted effect, or none, simulated by the model itself."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter

from sma_bench.diagnose import search
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.physics import simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.records import Record, Signal, read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import signals_of, simulate_finely

CHANNELS = ("front_1", "back_1")
ONE_WIRE = {"bench.channels": ("wire",), "bench.channel_sides": ("front",)}
RATE = 50.0  # Hz
FINER = 4  # simulation steps per sample
DURATION = 20.0  # s
NOISE = {"current": 0.01, "temperature": 0.15, "deflection": 1e-4}  # A, K, m
UNITS = {"voltage": "V", "current": "A", "temperature": "K", "deflection": "m"}
ALL = ("current", "temperature", "deflection")
# The planted effects, and for each stage one that is easily confused with it.
THERMAL = ("supply_drop", "latent_heat", "side_heat_coupling")
FEW = (*THERMAL, "transition_drift", "residual_strain", "viscoelastic_matrix", "deflection_drift")
BENCHES = yaml.safe_load(Path(__file__).with_name("planted.yaml").read_text())
LAB, LOADS = BENCHES["lab"], BENCHES["loads"]


def believed():
    """Stated parameters of the lab, with uncertainties."""
    rig = {"bench.channels": CHANNELS, "bench.channel_sides": ("front", "back")}
    values = {name: value for name, (value, _, _) in LAB.items()}
    stds = {name: std for name, (_, std, _) in LAB.items()}
    return Parameters.of_paper().replace(rig | values, stds)


def true_bench(effects=None):
    """The true bench: slightly off the stated parameters, with effects."""
    moved = {name: value + off * std for name, (value, std, off) in LAB.items() if off}
    return believed().replace(moved | (effects or {}))


def drive(turned=False, rate=RATE):
    """Full strokes of both sides and a partial one of the first; `turned` swaps the sides."""
    time = np.arange(0.0, DURATION, 1.0 / rate)

    def stroke(start, stop):
        """From 0 to 1 within 1.5 s, and back to 0 within 0.5 s."""
        return np.clip(np.minimum((time - start) / 1.5, (stop - time) / 0.5), 0.0, 1.0)

    first, second = 2.6 * stroke(1.0, 5.0) + 2.1 * stroke(14.0, 17.0), 2.5 * stroke(7.5, 11.5)
    return time, np.column_stack((second, first) if turned else (first, second))


def sensor_noise(kind, count, std, random):
    """(count,) noise of one sensor: white, or with a drift of 40 s correlation time."""
    white = std * random.standard_normal(count)
    if kind == "white":
        return white
    phi = np.exp(-1.0 / (RATE * 40.0))
    driving = std * np.sqrt(1.0 - phi**2) * random.standard_normal(count)
    driving[0] /= np.sqrt(1.0 - phi**2)
    return 0.7 * white + lfilter([1.0], [1.0, -phi], driving)


def planted_record(path, effects=None, *, quantities=ALL, kind="white", seed=1, turned=False,
                   bench=None, protocol=None):  # fmt: skip
    """Write a bag of the true bench, or of `bench`, with a protocol or the drive; read it back."""
    parameters = bench or true_bench(effects)
    channels = parameters["bench.channels"]

    def driven(rate):
        time, volts = protocol.sample(1.0 / rate) if protocol else drive(turned, rate)
        return time, volts[:, : len(channels)]

    fine, volts = driven(FINER * RATE)
    found = simulate(parameters, fine, 0.5 * (volts + np.vstack([volts[1:], volts[-1:]])))
    time, voltage = driven(RATE)
    names = ("temperature", "martensite_fraction", "sag")
    amperes = replace(found, **{n: getattr(found, n)[::FINER] for n in names}).current_at(voltage)
    exact = {}
    for k, channel in enumerate(channels):
        exact[f"{channel}.voltage"] = voltage[:, k]
        exact[f"{channel}.current"] = amperes[:, k]
        exact[f"{channel}.temperature"] = found.temperature_reading[::FINER, k]
    if len(channels) > 1:
        exact["deflection"] = found.deflection_reading[::FINER]
    random, signals = np.random.default_rng(seed), []
    for name, values in exact.items():
        quantity = name.rpartition(".")[2]
        if quantity in quantities:
            values = values + sensor_noise(kind, len(time), NOISE[quantity], random)
        if quantity in (*quantities, "voltage"):
            signals.append(Signal(name, UNITS[quantity], time, values))
    write_record(path, signals)
    return read_record(path)


def supply_drop_lab(folder):
    """Put a `bag` of a wire whose leads drop voltage, and its `lab.yaml`, into the folder."""
    belief = believed().replace(ONE_WIRE)
    write_parameters(folder / "lab.yaml", belief)
    bench = belief.replace({"effect.supply_drop.resistance": 0.3})
    planted_record(folder / "bag", quantities=("current", "temperature"), bench=bench)
    return folder


def planted_pair(folder, effects=None, **options):
    """A record, and a hold-out with the drives of the sides swapped."""
    seen = planted_record(folder / "seen", effects, **options)
    unseen = planted_record(folder / "unseen", effects, seed=2, turned=True, **options)
    return [seen], [unseen]


@contextmanager
def few_effects(names=FEW):
    """Reduce the library to some effects: a diagnosis takes a third of the time."""
    chosen = {name: effect for name, effect in EFFECTS.items() if name in names}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "EFFECTS", chosen)
        yield


# --- Wires that pull a weight, a spring, each other or a beam.

INFLUENCES = ("wire.stress_influence_austenite", "wire.stress_influence_martensite")
ENCODER = 2e-6  # m, of a testing machine
READ_WITHIN = {"elongation": 2e-5, "deflection": 2e-5, "force": 0.02}  # m, m, N


def moving_lab(load, more=(), stds=()):
    """Stated parameters of a rig with this load."""
    wire = {"wire.length": 0.2, **dict.fromkeys(INFLUENCES, 8e6)}
    rig = {"load.kind": load, **LOADS[load], **dict(more)}
    return Parameters.of_paper().replace({**wire, **rig}, {"load.preload": 0.5, **dict(stds)})


def strokes(bench, shape, period, duration, top=5.5):
    """Time at 25 Hz and voltages up to `top`, or equivalent duties, one wire after the other."""
    time = np.arange(0.0, duration, 0.04)
    inside = ((time - 2.0) % period) / period
    stroke = {
        "triangle": 2.0 * np.minimum(inside, 1.0 - inside),
        "step": (inside < 0.5) * (0.6 + 0.4 * ((time // period) % 2)),
        "sine": np.sin(np.pi * inside) ** 2,
    }[shape]
    wires = len(bench["bench.channels"])
    turn = (time // period).astype(int) % wires
    volts = np.stack([top * stroke * (turn == k) * (time > 2.0) for k in range(wires)], axis=1)
    if bench["bench.drive"] == "duty":
        volts = volts**2 / bench["bench.supply_voltage"]
    return time, volts


def machine_drive(bench, shape, period, duration, top=5.5):
    """The same strokes of a wire between moving grips: also the elongation [m]."""
    rough, volts = strokes(bench, shape, period, duration, top)
    time = np.arange(0.0, rough[-1], 0.004)  # a force read to 0.1 % resolves 20 ms of a drive
    turn, corners = (time / (1.4 * period)) % 1.0, [0.0, 0.15, 0.45, 0.6, 0.8]
    moved = np.interp(turn, corners, [0.0, -2e-3, -2e-3, 2e-4, 0.0])
    return time, np.interp(time, rough, volts[:, 0]), moved


def moving_record(bench, drive, seed, keep=("voltage", "elongation", "deflection")):
    """Readings of a bench driven by (time, voltages), or (time, voltages, elongation)."""
    random, signals = np.random.default_rng(seed), {}
    for s in signals_of(simulate_finely(bench, *drive)):
        quantity = s.name.rpartition(".")[2]
        if quantity in keep:
            within = READ_WITHIN | ({"elongation": ENCODER} if len(drive) > 2 else {})
            noise = within.get(quantity, 0.0)
            values = s.values + noise * random.standard_normal(len(s.values))
            signals[s.name] = Signal(s.name, s.unit, s.time, values)
    return Record(Path("moving"), 0, signals)

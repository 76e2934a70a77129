"""Records of a small composite bench on which an effect, or none, has been planted.

The model itself makes them, so they test the plumbing and the arithmetic of a diagnosis; how it
fares against another reality is for `./bench blind`.
"""

from contextlib import contextmanager

import numpy as np
import pytest
from scipy.signal import lfilter

from sma_bench.diagnose import search
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.physics import simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.material import current
from sma_bench.records import Signal, read_record
from sma_bench.records.bag_writer import write_record

CHANNELS = ("front_1", "back_1")
ONE_WIRE = {"bench.channels": ("wire",), "bench.channel_sides": ("front",)}
RATE = 50.0  # Hz
FINER = 4  # steps of the bench between samples
DURATION = 20.0  # s
NOISE = {"current": 0.01, "temperature": 0.15, "deflection": 1e-4}  # A, K, m
UNITS = {"voltage": "V", "current": "A", "temperature": "K", "deflection": "m"}
ALL = ("current", "temperature", "deflection")
# Those planted, and for each stage one that it is easily taken for.
THERMAL = ("supply_drop", "latent_heat", "side_heat_coupling")
FEW = (*THERMAL, "transition_drift", "residual_strain", "viscoelastic_matrix", "deflection_drift")
_OFF = {  # of the truth from the belief, in standard deviations
    "wire.resistance": 0.8,
    "wire.heat_transfer_coefficient": -0.7,
    "wire.specific_heat": 0.6,
    "wire.austenite_start_temperature": 0.5,
    "composite.stress_per_deflection_front": -0.8,
    "composite.stress_per_deflection_back": -0.8,
}
_STD = {
    "wire.resistance": 0.02,
    "wire.heat_transfer_coefficient": 4.0,
    "wire.specific_heat": 12.0,
    "wire.surface_area": 1e-6,
    "wire.mass": 4e-7,
    "environment.ambient_temperature": 0.2,
    "wire.austenite_start_temperature": 0.5,
    "wire.austenite_finish_temperature": 0.5,
    "wire.martensite_start_temperature": 0.5,
    "wire.martensite_finish_temperature": 0.5,
    "wire.martensite_modulus": 0.6e9,
    "wire.austenite_modulus": 1.6e9,
    "wire.maximum_recoverable_strain": 8e-4,
    "composite.deflection_per_strain": 0.03,
    "composite.stress_per_deflection_front": 2e8,
    "composite.stress_per_deflection_back": 2e8,
    "wire.stress_influence_austenite": 4e5,
    "wire.stress_influence_martensite": 4e5,
    "wire.thermal_expansion_factor": 1.2e4,
}


def believed():
    """Parameters of the lab, with their uncertainties."""
    return Parameters.of_paper().replace(
        {
            "bench.channels": CHANNELS,
            "bench.channel_sides": ("front", "back"),
            "wire.heat_transfer_coefficient": 125.0,
            "wire.surface_area": 1.9e-4,
            "wire.specific_heat": 440.0,
            "wire.austenite_start_temperature": 337.0,
            "wire.austenite_finish_temperature": 352.0,
            "wire.martensite_start_temperature": 322.0,
            "wire.martensite_finish_temperature": 308.0,
            "wire.stress_influence_austenite": 7.5e6,
            "wire.stress_influence_martensite": 7.7e6,
            "composite.deflection_per_strain": 1.0,
            "composite.stress_per_deflection_front": 4.8e9,
            "composite.stress_per_deflection_back": 4.8e9,
        },
        _STD,
    )


def true_bench(effects=None):
    """The bench as it is: a little off the belief, with effects."""
    belief = believed()
    moved = {name: belief[name] + k * belief.std(name) for name, k in _OFF.items()}
    return belief.replace({**moved, **(effects or {})})


def drive(turned=False, rate=RATE):
    """Full strokes of both sides and a partial one of the first; `turned` swaps the sides."""
    time = np.arange(0.0, DURATION, 1.0 / rate)

    def stroke(start, stop):
        """From 0 to 1 within 1.5 s, and back to 0 within 0.5 s."""
        return np.clip(np.minimum((time - start) / 1.5, (stop - time) / 0.5), 0.0, 1.0)

    first, second = 2.6 * stroke(1.0, 5.0) + 2.1 * stroke(14.0, 17.0), 2.5 * stroke(7.5, 11.5)
    pair = (second, first) if turned else (first, second)
    return time, np.column_stack(pair)


def sensor_noise(kind, count, std, random):
    """(count,) noise of one sensor: white, coloured (5 s memory) or with a slow drift."""
    white = std * random.standard_normal(count)
    if kind == "white":
        return white
    memory = {"coloured": 5.0, "drifting": 40.0}[kind]
    phi = np.exp(-1.0 / (RATE * memory))
    driving = std * np.sqrt(1.0 - phi**2) * random.standard_normal(count)
    driving[0] /= np.sqrt(1.0 - phi**2)
    return np.asarray(0.7 * white + lfilter([1.0], [1.0, -phi], driving))


def planted_record(
    path,
    effects=None,
    *,
    quantities=ALL,
    kind="white",
    seed=1,
    turned=False,
    bench=None,
    protocol=None,
):
    """Write a bag of the true bench, or of `bench`, on a protocol or the drive; read it again."""
    parameters = bench or true_bench(effects)
    channels = parameters["bench.channels"]

    def driven(rate):
        return protocol.sample(1.0 / rate) if protocol else drive(turned, rate)

    fine, volts = driven(FINER * RATE)
    between = 0.5 * (volts + np.vstack([volts[1:], volts[-1:]]))
    found = simulate(parameters, fine, between[:, : len(channels)])
    time, voltage = driven(RATE)
    random = np.random.default_rng(seed)
    kelvin, xi = found.temperature[::FINER], found.martensite_fraction[::FINER]
    amperes = current(parameters, voltage[:, : len(channels)], kelvin, xi)
    exact = {}
    for k, channel in enumerate(channels):
        exact[f"{channel}.voltage"] = voltage[:, k]
        exact[f"{channel}.current"] = amperes[:, k]
        exact[f"{channel}.temperature"] = found.temperature_reading[::FINER, k]
    if len(channels) > 1:
        exact["deflection"] = found.deflection_reading[::FINER]
    signals = []
    for name, values in exact.items():
        quantity = name.rpartition(".")[2]
        if quantity in quantities:
            values = values + sensor_noise(kind, len(time), NOISE[quantity], random)
        if quantity in (*quantities, "voltage"):
            signals.append(Signal(name, UNITS[quantity], time, values))
    write_record(path, signals)
    return read_record(path)


def supply_drop_lab(folder):
    """The folder, with a `bag` of a wire whose leads drop voltage and what its lab believes of it
    in `lab.yaml`."""
    belief = believed().replace(ONE_WIRE)
    write_parameters(folder / "lab.yaml", belief)
    bench = belief.replace({"effect.supply_drop.resistance": 0.3})
    planted_record(folder / "bag", quantities=("current", "temperature"), bench=bench)
    return folder


def planted_pair(folder, effects=None, **options):
    """A record, and one with the sides' parts swapped to hold out."""
    seen = planted_record(folder / "seen", effects, **options)
    unseen = planted_record(folder / "unseen", effects, seed=2, turned=True, **options)
    return [seen], [unseen]


@contextmanager
def few_effects(names=FEW):
    """A library of some effects only, in which a diagnosis takes a third of the time."""
    chosen = {name: effect for name, effect in EFFECTS.items() if name in names}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "EFFECTS", chosen)
        yield

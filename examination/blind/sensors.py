"""The bench's instruments: converters, an infrared camera, a range sensor, and their noise."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from examination.blind.reality import Outcome, World, forms
from sma_bench.arrays import Array
from sma_bench.records import Signal

# --- Noise of a sensor: white, coloured and drifting.

# Noise model -> lowest and highest share of the variance that is correlated, and lowest and highest
# correlation time [s].
# "coloured": an amplifier with filter or mains hum; "drift": one that warms up and drifts.
NOISE_MODELS: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "white": ((0.0, 0.0), (1.0, 1.0)),
    "coloured": ((0.4, 0.95), (0.1, 1.5)),
    "drift": ((0.08, 0.3), (8.0, 40.0))}


@dataclass(frozen=True)
class Noise:
    """Stationary noise: a white part, and an AR(1) part that has a share of the variance and a
    correlation time [s]; `std` of both together."""

    std: float
    share: float = 0.0
    correlation_time: float = 1.0

    @classmethod
    def of_model(cls, noise_model: str, std: float, rng: np.random.Generator) -> "Noise":
        """Noise of one of NOISE_MODELS, its share and time drawn from the ranges given there."""
        (least, most), (fastest, slowest) = NOISE_MODELS[noise_model]
        time = float(np.exp(rng.uniform(np.log(fastest), np.log(slowest))))
        return cls(std, float(rng.uniform(least, most)), time)

    def draw(self, n: int, period: float, rng: np.random.Generator, tails: float = 0.0,
             slow: float = 0.0) -> Array:
        """(n,) noise at samples `period` s apart, stationary from the first one on. Its white part
        follows Student's t with `tails` degrees of freedom, if above 0; a share `slow` of its
        correlated part has ten times the correlation time."""
        white, driving = rng.standard_normal((2, n))
        if tails > 0.0:
            white = rng.standard_t(tails, n) * np.sqrt(1.0 - 2.0 / tails)

        def remembered(driving: Array, time: float) -> Array:
            rho = np.exp(-period / time)
            driving[1:] *= np.sqrt(1.0 - rho**2)
            return np.asarray(lfilter([1.0], [1.0, -rho], driving))

        correlated = remembered(driving, self.correlation_time)
        if slow > 0.0:
            more = remembered(rng.standard_normal(n), 10.0 * self.correlation_time)
            correlated = np.sqrt(1.0 - slow) * correlated + np.sqrt(slow) * more
        mixed = np.sqrt(1.0 - self.share) * white + np.sqrt(self.share) * correlated
        return np.asarray(self.std * mixed)

    def whiten_means(self, means: Array, width: float, samples: float) -> Array:
        """Means over windows side by side, filtered so that their noise is white with std 1. Means
        of white noise plus an AR(1) process are an ARMA(1,1) process: its innovations are what this
        returns, for a process that was quiet before the first window. Args: means (n,) of the
        windows; width [s] of one, and samples in it."""
        ratio = width / self.correlation_time
        rho = float(np.exp(-ratio))
        # Variance of the means, and covariance of neighbours: the correlation integrated twice.
        variance = 2.0 * (ratio - 1.0 + rho) / ratio**2
        neighbours = (1.0 - rho) ** 2 / ratio**2
        variance = self.share * variance + (1.0 - self.share) / samples
        neighbours = self.share * neighbours
        # x_t - rho x_(t-1) is e_t + moving e_(t-1).
        own = (1.0 + rho**2) * variance - 2.0 * rho * neighbours
        next_one = neighbours - rho * variance
        moving = 2.0 * next_one / (own + np.sqrt(max(own**2 - 4.0 * next_one**2, 0.0)))
        innovation = np.sqrt(own / (1.0 + moving**2))
        return np.asarray(lfilter([1.0, -rho], [1.0, moving], means) / (self.std * innovation))


# --- The bench's instruments: an Arduino's 10-bit converters, an infrared camera, a range sensor.
#
# What happens (an Outcome of the reality) becomes readings, by the physics of the instruments,
# and readings become signals, by sampling, noise and resolution.
QUANTITIES = ("voltage", "current", "temperature", "deflection")
UNITS = {"voltage": "V", "current": "A", "temperature": "K", "deflection": "m"}
# 5 V in 1024 counts; current through an amplifier of 1 V/A; a tenth of a degree Celsius of the
# camera; digits of the range sensor.
RESOLUTION = {"voltage": 5 / 1024, "current": 5 / 1024, "temperature": 0.1, "deflection": 5e-6}
_CELSIUS_ZERO = 273.15
# The signal of a camera at 8 to 14 um grows like this power of the temperature around 330 K.
RADIANCE_EXPONENT = 4.5
# s, from the timestamp to the recorder: serial line, image processing, serial line.
_DELAY, _DELAY_SPREAD = {"power": 0.002, "temperature": 0.006, "joint_states": 0.003}, 0.0003
_LARGEST_JITTER = 0.4  # of the period: timestamps stay in order
_DRIFT_TERMS = 3
_SHUTTER_PERIOD = (12.0, 40.0)  # s between two flags of the camera


@dataclass(frozen=True)
class Sensors:
    """One set of instruments: noise by quantity (of a voltage only while driven), rates [Hz],
    jitter [s] of the sampling instants, share of lost messages, lateness [s] of the camera's
    timestamps, seed of what belongs to the rig, not to a record: drift, shutter."""

    noise: Mapping[str, Noise]
    power_rate: float = 50.0
    camera_rate: float = 25.0
    mechanics_rate: float = 50.0
    jitter: float = 0.0009
    dropout: float = 0.01
    camera_clock: float = 0.0
    seed: int = 0

    def std(self, quantity: str) -> float:
        """Noise and rounding of a quantity together."""
        return float(np.hypot(self.noise[quantity].std, RESOLUTION[quantity] / np.sqrt(12.0)))

    def rate(self, quantity: str) -> float:
        """Hz at which a quantity is read."""
        rates = {"temperature": self.camera_rate, "deflection": self.mechanics_rate}
        return rates.get(quantity, self.power_rate)


def readings(outcome: Outcome, world: World, sensors: Sensors) -> dict[str, Array]:
    """Readings of the instruments without noise and rounding: voltage, current, temperature (n, w)
    and, where something moves, deflection (n,), in SI units, by timestamp."""
    time = outcome.time
    # Radiance of wire and surroundings in the spot, through the camera's own lag from rest.
    fill, lag = world.feature("spot_fill"), world.feature("camera_lag")
    seen = outcome.temperature
    if fill < 1.0:
        wire, beside = seen**RADIANCE_EXPONENT, outcome.surface**RADIANCE_EXPONENT
        filled: float | Array = fill
        if world.feature("spot_opposite") > 0.0:  # in the order of channels: front, then back
            beside = np.roll(wire, wire.shape[1] // 2, axis=1)
        if (walk := world.feature("spot_walk")) > 0.0:
            away = np.minimum(np.abs(outcome.deflection) / walk, 1.0)
            filled = 1.0 - (1.0 - fill) * away[:, None]
        seen = (filled * wire + (1.0 - filled) * beside) ** (1.0 / RADIANCE_EXPONENT)
    if lag > 0.0:
        how = world.feature("lag_slow"), world.feature("lag_exposure")
        seen = forms.lagged(seen, time[1] - time[0], lag, *how)
    if sensors.camera_clock != 0.0:
        late = time - sensors.camera_clock
        seen = np.column_stack([np.interp(late, time, column) for column in seen.T])
    if steps := world.feature("shutter_steps"):
        seen = seen + steps * shutter_offset(time, sensors.seed)[:, None]
    seen_of_wires = {"voltage": outcome.voltage, "current": outcome.current, "temperature": seen}
    if world.load == "clamped":  # nothing moves
        return seen_of_wires
    read = outcome.deflection + world.feature("sensor_nonlinearity") * outcome.deflection**2
    read = read + world.feature("pickup") * outcome.current.sum(axis=1)
    if drift := world.feature("deflection_drift"):
        heat = (outcome.voltage * outcome.current).sum(axis=1)
        how = world.feature("drift_settling"), world.feature("drift_by_heat")
        read = read + drift * forms.offset(drift_shape(time, sensors.seed), time, *how, heat)
    return {**seen_of_wires, "deflection": read}


def drift_shape(time: Array, seed: int) -> Array:
    """(n,) smooth random drift from 0, at most 1 in magnitude."""
    rng = np.random.default_rng([seed, 1])
    terms = np.arange(1, _DRIFT_TERMS + 1)
    weights = rng.standard_normal(_DRIFT_TERMS) / terms
    phase = rng.uniform(0.0, 2.0 * np.pi, _DRIFT_TERMS)
    angles = np.pi * terms * (time[:, None] - time[0]) / (time[-1] - time[0])
    shape = ((np.sin(angles + phase) - np.sin(phase)) * weights).sum(axis=1)
    return np.asarray(shape / np.abs(shape).max())


def shutter_offset(time: Array, seed: int) -> Array:
    """(n,) offsets of about 1 that change whenever the camera closes its shutter to calibrate."""
    rng = np.random.default_rng([seed, 2])
    span = time[-1] - time[0]
    instants = np.cumsum(rng.uniform(*_SHUTTER_PERIOD, int(span / _SHUTTER_PERIOD[0]) + 2))
    levels = np.concatenate([[0.0], rng.standard_normal(len(instants))])
    return np.asarray(levels[np.searchsorted(instants, time - time[0], side="right")])


def measure(outcome: Outcome, world: World, sensors: Sensors, rng: np.random.Generator,
            quantities: tuple[str, ...] = QUANTITIES) -> list[Signal]:
    """Signals of the contract as these instruments would record an outcome on a uniform grid from
    0, whose voltage and current hold until the next time; voltages are recorded always."""
    clean, channels = readings(outcome, world, sensors), world.parameters["bench.channels"]
    # By topic: timestamps, times of reception by the recorder's clock, which messages arrived.
    topics = {f"{channel}/power": sensors.power_rate for channel in channels}
    topics |= {f"{channel}/temperature": sensors.camera_rate for channel in channels}
    topics["joint_states"] = sensors.mechanics_rate
    ticks = {}
    for topic, rate in topics.items():
        period, kind = 1.0 / rate, topic.rpartition("/")[2]
        n = int(float(outcome.time[-1]) * rate)
        jitter = sensors.jitter * rng.standard_normal(n)
        jitter = np.clip(jitter, -_LARGEST_JITTER * period, _LARGEST_JITTER * period)
        time = (np.arange(n) + rng.uniform(0.4, 0.6)) * period + jitter
        arrived = rng.random(n) >= sensors.dropout
        # A camera whose clock is late has stamped its images that much later than the recorder.
        late = sensors.camera_clock if kind == "temperature" else 0.0
        received = time - late + _DELAY[kind] + rng.exponential(_DELAY_SPREAD, n)
        ticks[topic] = time, received, arrived, period

    of_wires = [
        (f"{channel}.{quantity}", quantity, f"{channel}/{topic}", clean[quantity][:, wire])
        for wire, channel in enumerate(channels)
        for quantity, topic in (("voltage", "power"), ("current", "power"),
                                ("temperature", "temperature"))]
    if "deflection" in clean:
        motion = "deflection" if world.load in ("beam", "antagonist") else "elongation"
        of_wires.append((motion, "deflection", "joint_states", clean["deflection"]))
    signals = []
    for name, quantity, topic, values in of_wires:
        time, received, arrived, period = ticks[topic]
        true = np.interp(time, outcome.time, values)
        if topic.endswith("/power"):  # held
            true = values[np.searchsorted(outcome.time, time, side="right") - 1]
        noise_form = world.feature("noise_tails"), world.feature("noise_slow")
        noisy = true + sensors.noise[quantity].draw(len(true), period, rng, *noise_form)
        step, zero = RESOLUTION[quantity], _CELSIUS_ZERO if quantity == "temperature" else 0.0
        read = np.rint((noisy - zero) / step) * step + zero
        if quantity == "voltage":  # a converter reads no less than 0, and 0 when off
            read = np.where(true > 0.0, np.maximum(read, 0.0), 0.0)
        if quantity in ("voltage", *quantities):
            arrivals = time[arrived], read[arrived], received[arrived]
            signals.append(Signal(name, UNITS[quantity], *arrivals))
    return signals

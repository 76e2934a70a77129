"""Staircases, ramps and signals of a record that experiments can use."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation import noise_model
from sma_bench.estimation.rig import has_load_frame, is_clamped, pulls_a_load
from sma_bench.estimation.voltage import Segments, find_segments
from sma_bench.findings import Finding
from sma_bench.identify.fits import straight_line
from sma_bench.identify.result import refusal, remark
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import NITI_DENSITY, wire_length
from sma_bench.records import Record
from sma_bench.records.record import has_samples, samples, with_commands

RESISTANCE, COEFFICIENT = "wire.resistance", "wire.heat_transfer_coefficient"
SPECIFIC_HEAT, AMBIENT = "wire.specific_heat", "environment.ambient_temperature"
LAG, CAMERA_LAG = "effect.temperature_lag.time_constant", "sensor.temperature.lag"
LEADS = "bench.lead_resistance"
SETTLE, AVERAGE = 15.0, 15.0  # s of a plateau, one after the other
SHORTEST_PLATEAU, FEWEST_LEVELS = 2.0, 4  # s; voltages of a staircase
_FEWEST_SAMPLES = 8  # of a window
_PRIOR_WEIGHT = 10.0  # samples: weight of the scatter of all windows in that of each
_COLDEST, _HOTTEST = 5.0, 95.0  # percentiles of a wire's temperature
# Camera errors that scale the measured rise of the wire above ambient.
CAMERA = ("sensor.temperature.gain", "sensor.temperature.emissivity",
          "sensor.temperature.spot_share")


@dataclass(frozen=True)
class Drive:
    """The voltage of one channel in segments, without plateaus too short to be averaged."""

    channel: str
    segments: Segments

    @property
    def is_staircase(self) -> bool:
        return self.segments.levels() >= FEWEST_LEVELS

    @property
    def windows(self) -> Array:
        """Averaging windows (p, 2) s of the plateaus, as in section II.B; scaled if short."""
        start, duration = np.array([(p.start, p.duration) for p in self.segments.plateaus]).T
        shares = np.minimum(1.0, duration / (SETTLE + AVERAGE))
        return start[:, None] + np.outer(shares, (SETTLE, SETTLE + AVERAGE))

    def read(self, record: Record, *quantities: str) -> "Drive":
        """Only the plateaus with at least half the usual samples of each quantity, if enough."""
        plateaus = self.segments.plateaus
        kept = np.ones(len(plateaus), dtype=bool)
        for quantity in quantities:
            time = samples(record, f"{self.channel}.{quantity}")[0]
            count = np.diff(np.searchsorted(time, self.windows))[:, 0]
            kept &= (count >= _FEWEST_SAMPLES) & (count >= 0.5 * np.median(count))
        complete = tuple(p for p, keep in zip(plateaus, kept, strict=True) if keep)
        found = replace(self, segments=replace(self.segments, items=complete))
        return found if found.is_staircase else self

    def means(self, record: Record, quantity: str) -> "Means":
        name = f"{self.channel}.{quantity}"
        return means(*samples(record, name), self.windows, name)

    def same_level(self, voltage: Array) -> Array:
        """(p, p) ones where two plateaus share a voltage and so the converter's error."""
        apart = np.abs(voltage[:, None] - voltage[None, :])
        return (apart < self.segments.tolerance).astype(np.float64)

    def source(self, record: Record) -> str:
        first, *_, last = self.segments.plateaus
        return f"{record.path}: {self.channel}, {first.start:.1f} to {last.stop:.1f} s"

    def describe(self) -> str:
        s = self.segments
        counts = {"plateau": len(s.plateaus), "voltage": s.levels(), "ramp": len(s.ramps)}
        plateaus, voltages, ramps = (f"{n} {word}{'' if n == 1 else 's'}"
                                     for word, n in counts.items())
        return f"{self.channel}: {plateaus} at {voltages}, {ramps}"


def find_drives(record: Record) -> tuple[Drive, ...]:
    """The voltage of every channel; InputError for one too short."""
    drives = []
    for channel in (c for c in record.channels if has_samples(record, f"{c}.voltage")):
        try:
            segments = find_segments(*samples(record, f"{channel}.voltage"))
        except InputError as error:
            raise InputError(f"{record.path}: {channel}.{error}") from None
        items = tuple(s for s in segments.items
                      if s.kind == "ramp" or s.duration >= SHORTEST_PLATEAU)
        drives.append(Drive(channel, replace(segments, items=items)))
    return tuple(drives)


def moves(record: Record, parameters: Parameters) -> bool:
    """Whether a record shows the composite bending, or wires moving their load."""
    own = ("elongation",) if pulls_a_load(record, parameters) else ()
    return any(has_samples(record, n) for n in ("deflection", "front.range", "back.range", *own))


def driven(record: Record, parameters: Parameters) -> dict[str, float]:
    """Range [V] of each channel's voltage, or of the one that stands for a current command."""
    record, _ = with_commands(record, parameters)
    return {c: float(np.ptp(samples(record, f"{c}.voltage")[1])) for c in record.channels
            if has_samples(record, f"{c}.voltage")}


def holds_frame(record: Record, parameters: Parameters) -> bool:
    """Whether a record shows one driven wire in a load frame."""
    return len(record.channels) == 1 and has_load_frame(record) and bool(driven(record, parameters))


def is_clamped_wire(record: Record) -> bool:
    """Whether one wire was clamped while its force and temperature were measured."""
    names = ("force", *(f"{c}.temperature" for c in record.channels))
    return len(names) == 2 and is_clamped(record) and all(has_samples(record, n) for n in names)


def about_length(parameters: Parameters) -> Finding:
    computed = f"from mass and diameter at {NITI_DENSITY:g} kg/m3"
    source = "as given" if parameters["wire.length"] else computed
    return remark("gauge length", length=wire_length(parameters), source=source)


def one_wire(parameters: Parameters, channel: str) -> Parameters:
    """A bench of this channel alone, its wire clamped."""
    return parameters.replace({"bench.channels": (channel,), "bench.channel_sides": ("front",),
                               "load.kind": "clamped"})


def sensors_of(records: Sequence[Record], parameters: Parameters) -> Parameters:
    """The parameters with the camera errors that its messages state, unless a file does: the error
    at the wire's coldest is taken for its zero's, the increase to the hottest for its scale's."""
    found = []
    for name, signal in (item for record in records for item in record.signals.items()):
        wire = name.endswith(".temperature") and not name.startswith("ambient.")
        if wire and signal.std is not None and len(signal) > 0:
            low, high = np.percentile(signal.values, (_COLDEST, _HOTTEST))
            ends = (signal.values <= low, signal.values >= high)
            cold, hot = (float(np.median(signal.values[end])) for end in ends)
            at_cold, at_hot = (float(np.median(signal.std[end])) for end in ends)
            on_top = float(np.sqrt(max(at_hot**2 - at_cold**2, 0.0)))
            found.append((at_cold, on_top / max(hot - cold, 1e-9)))
    if not found:
        return parameters
    zero, scale = np.max(found, axis=0).tolist()
    stated = dict.fromkeys(CAMERA, 0.0) | {CAMERA[-1]: scale, "sensor.temperature.offset": zero}
    own = {n: std for n, std in stated.items() if n not in parameters.given_uncertainty}
    return parameters.replace(uncertainty=own)


class Means(NamedTuple):
    """Means of one signal over p plateaus, in its unit."""

    value: Array  # (p,)
    noise: Array  # (p,) their standard errors, coloured noise counted
    hidden: float  # standard deviation of the converter's error that averaging does not remove
    step: float  # the converter's, 0 if none is seen
    drift: Array  # (p,) change over the window by a straight line
    n: int  # samples of all windows


def means(time: Array, values: Array, bounds: Array, what: str) -> Means:
    """Mean of a signal (n,) over time (n,) s in windows (p, 2) s; InputError: too few samples."""
    lines, residuals, drift = [], [], []
    for start, stop in bounds:
        inside = slice(np.searchsorted(time, start), np.searchsorted(time, stop, side="right"))
        t, v = time[inside], values[inside]
        if len(v) < _FEWEST_SAMPLES:
            raise refusal("few to average", what=what, count=len(v), start=start, stop=stop,
                          least=_FEWEST_SAMPLES)
        lines.append(straight_line(t, v))
        residuals.append(v - lines[-1](t))
        drift.append(lines[-1].slope * float(np.ptp(t)))
    n = np.array([len(v) for v in residuals], dtype=np.float64)
    correlated = noise_model.inflation(residuals)
    variance = n * np.array([line.value_variance for line in lines])
    pooled = float(np.sum(variance * n) / np.sum(n))
    steady = (n * variance + _PRIOR_WEIGHT * pooled) / (n + _PRIOR_WEIGHT)
    noise, step = np.sqrt(steady * correlated / n), noise_model.resolution(values)
    hidden = noise_model.quantisation_variance(float(np.sqrt(pooled)), step)
    return Means(np.array([line.value for line in lines]), noise, float(np.sqrt(hidden)), step,
                 np.array(drift), int(np.sum(n)))

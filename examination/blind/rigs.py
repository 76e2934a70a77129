"""A random lab: its rig, its drives, and the readings of its instruments."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import msgspec
import numpy as np
import yaml

from examination.blind.case_files import STAGES
from examination.blind.reality import BY_NAME, Outcome, World, happen
from examination.blind.sensors import Sensors, readings
from sma_bench.arrays import Array
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind, wire_length

# --- A random rig: its true parameters, and those that its owners state.
_DRAWN = yaml.safe_load(Path(__file__).with_name("cases.yaml").read_text())
_LAYOUT, _DRIVES = _DRAWN["layouts"], _DRAWN["drives"]
SIDES = tuple(_LAYOUT["beam"]["bench.channel_sides"])
# Cold martensite of the package's laws is elastic: stretched by its antagonist it does not yield.
_STILL = {"antagonist": {"detwinning_stress": 1e9}}
_CLAMPED_STRESS = 100e6  # Pa, when about a third has transformed
# Two equal stiffnesses, which the owners state as one number.
FRONT = "composite.stress_per_deflection_front"
BACK = "composite.stress_per_deflection_back"


@dataclass(frozen=True)
class Number:
    """A parameter that the owners of a rig state; the fields are explained in rigs.yaml."""

    middle: float
    spread: float
    std: float
    stage: str = "mechanical"
    weighed: bool = False
    absolute: bool = False

    def stated_std(self, value: float) -> float:
        """The standard deviation that the owners state for a value."""
        return float(f"{self.std if self.absolute else abs(value) * self.std:.3g}")


_POPULATION = msgspec.convert(yaml.safe_load(Path(__file__).with_name("rigs.yaml").read_text()),
                              dict[str, dict[str, Number]])


def numbers(load: str) -> dict[str, Number]:
    return _POPULATION["wire"] | _POPULATION.get(load, {}) | _POPULATION["temperatures"]


def draw_truth(rng: np.random.Generator, load: str = "beam") -> Parameters:
    drawn = {}
    for name, n in numbers(load).items():
        moved = n.spread * rng.uniform(-1.0, 1.0)
        drawn[name] = float(n.middle + moved if n.absolute else n.middle * (1.0 + moved))
    return _rig(drawn, {}, load)


def true_values(truth: Parameters) -> dict[str, float]:
    return {name: float(truth[name]) for name in numbers(load_kind(truth))}


def draw_nominal(truth: Parameters, rng: np.random.Generator,
                 wrong: Mapping[str, float] | None = None) -> Parameters:
    """The stated parameters: the true ones, off by one draw of their stated uncertainty, or by the
    number of stated standard deviations in `wrong`."""
    values, stds = {}, {}
    for name, number in numbers(load_kind(truth)).items():
        true, drawn = float(truth[name]), rng.standard_normal()
        values[name] = true + (wrong or {}).get(name, drawn) * number.stated_std(true)
        # From the stated value: the uncertainty must not reveal the true one.
        stds[name] = number.stated_std(values[name])
    return _rig(values, stds, load_kind(truth))


def recalibrated(load: str) -> tuple[str, ...]:
    """Parameters that may be wrong: for a clamped wire only those that its signals show."""
    shown = ("electrical", "thermal") if load == "clamped" else STAGES
    known = numbers(load).items()
    return tuple(name for name, n in known if not n.weighed and n.stage in shown)


def draw_wrong(rng: np.random.Generator, load: str = "beam") -> dict[str, float]:
    """One to three parameters and their errors in stated standard deviations."""
    names = rng.choice(recalibrated(load), size=int(rng.integers(1, 4)), replace=False)
    sizes = rng.uniform(*_DRAWN["wrong_by"], len(names)) * rng.choice([-1.0, 1.0], len(names))
    return {str(name): float(size) for name, size in zip(names, sizes, strict=True)}


def world_of(truth: Parameters, features: Mapping[str, float]) -> World:
    """A rig of the population with these features."""
    return World(truth, {**_STILL.get(load_kind(truth), {}), **features})


def _rig(values: dict[str, float], stds: dict[str, float], load: str) -> Parameters:
    values, stds = ({**given, BACK: given[FRONT]} if FRONT in given else given
                    for given in (values, stds))
    layout = {n: tuple(v) if isinstance(v, list) else v for n, v in _LAYOUT[load].items()}
    return Parameters({"wire.diameter": 0.3e-3, **layout, **values}, stds)


# --- Drives: triangles, steps, staircases and holds, with rests between.
COMMAND_PERIOD = 0.02  # s: an Arduino that is commanded 50 times a second
FAMILIES = ("triangle", "step", "staircase", "trapezoid")


class Pulse(NamedTuple):
    """Voltage of a side's wires by corners [s since the start, V], linear between, zero outside."""

    side: str
    times: tuple[float, ...]
    volts: tuple[float, ...]


@dataclass(frozen=True)
class Drive:
    """The pulses of one record."""

    family: str
    duration: float
    pulses: tuple[Pulse, ...]

    def voltage(self, time: Array, of: tuple[str, ...] = SIDES) -> Array:
        """(n, w) V at the wires of these sides, held since the last command."""
        commanded = np.floor(time / COMMAND_PERIOD + 1e-6) * COMMAND_PERIOD
        sides = {side: np.zeros(len(time)) for side in ("front", "back")}
        for pulse in self.pulses:
            volts = np.interp(commanded, pulse.times, pulse.volts, left=0.0, right=0.0)
            sides[pulse.side] += volts
        return np.column_stack([sides[side] for side in of])

    def grid(self, period: float) -> Array:
        """(n,) times from 0 to the end."""
        return np.asarray(np.arange(int(round(self.duration / period)) + 1) * period, dtype=float)


def draw_drive(family: str, truth: Parameters, rng: np.random.Generator) -> Drive:
    """Full, nested and partial strokes of one of FAMILIES."""
    duration = float(np.round(rng.uniform(*_DRIVES["duration"]), 1))
    sides = tuple(dict.fromkeys(truth["bench.channel_sides"]))
    side = str(rng.choice(sides))
    # Both sides finish a cycle first; a loop inside a loop and a partial cycle are in every drive.
    plan = ["full", "full", "nested", *rng.permutation(["partial", "partial", "full"])]
    start, pulses = float(rng.uniform(*_DRIVES["first"])), []
    for reach in plan:
        pulse = _draw_pulse(family, str(reach), side, start, truth, rng)
        if pulse.times[-1] + _DRIVES["rest"][0] > duration:
            break
        pulses.append(pulse)
        start = pulse.times[-1] + float(rng.uniform(*_DRIVES["rest"]))
        side = sides[(sides.index(side) + 1) % len(sides)]
    return Drive(family, duration, tuple(pulses))


def _draw_pulse(family: str, reach: str, side: str, start: float, truth: Parameters,
                rng: np.random.Generator) -> Pulse:
    above = rng.uniform(*_DRIVES["full" if reach == "full" else "partial"])
    peak = _volts_for(truth, hottest(truth) + above)
    corners: list[tuple[float, float]] = []  # s, share of the peak
    if family == "triangle":
        peak *= _DRIVES["swift"]
        rise, fall = rng.uniform(5.0, 10.0, 2)
        corners = [(0.0, 0.0), (rise, 1.0), (rise + fall, 0.0)]
    elif family == "step":
        corners = [(0.0, 1.0), (rng.uniform(6.0, 12.0), 1.0)]
    elif family == "trapezoid":
        rise, hold, fall = rng.uniform(2.5, 6.0, 3)
        corners = [(0.0, 0.0), (rise, 1.0), (rise + hold, 1.0), (rise + hold + fall, 0.0)]
    else:
        levels, now = np.sort(rng.uniform(0.6, 0.95, 2)).tolist(), 0.0
        for level in [*levels, 1.0, *levels[::-1][: int(rng.integers(0, 2))]]:
            stay = rng.uniform(2.5, 5.0)
            corners += [(now, level), (now + stay, level)]
            now += stay + COMMAND_PERIOD
    if reach == "nested":
        # Reversed inside the transformation to austenite, and inside that to martensite: up to the
        # peak, a fall, a hold, a rise, and then the last part of the pulse, from the peak on.
        ends = [truth[f"wire.martensite_{end}_temperature"] for end in ("start", "finish")]
        shift = hottest(truth) - truth["wire.austenite_finish_temperature"]
        middle = float(np.mean(ends) + 0.4 * shift)
        low = _volts_for(truth, middle + rng.uniform(-4.0, 2.0)) / peak
        last = max(k for k, (_, v) in enumerate(corners) if v == 1.0)
        turn = corners[last][0]
        fall, stay, rise = rng.uniform((2.0, 2.0, 2.0), (3.5, 4.0, 3.5))
        back = turn + fall + stay + rise
        end = back + rng.uniform(2.0, 4.0)
        dip = [(turn + fall, low), (turn + fall + stay, low), (back, 1.0), (end, 1.0)]
        after = [(t - turn + end, v) for t, v in corners[last + 1 :]]
        corners = [*corners[: last + 1], *dip, *after]
    times = np.round(start + np.array([t for t, _ in corners]), 2)
    volts = np.round(peak * np.array([v for _, v in corners]), 3)
    return Pulse(side, tuple(times.tolist()), tuple(volts.tolist()))


def hottest(truth: Parameters) -> float:
    """A_f [K] at the stress of full contraction, or at _CLAMPED_STRESS."""
    modulus, strain = truth["wire.austenite_modulus"], truth["wire.maximum_recoverable_strain"]
    # Wires of a side; load [Pa], and stiffness [Pa] per contraction, that they pull against.
    wires, load = 1, 0.0
    if load_kind(truth) == "clamped":  # it never transforms completely
        return float(truth["wire.austenite_finish_temperature"]
                     + _CLAMPED_STRESS / truth["wire.stress_influence_austenite"])
    if load_kind(truth) == "beam":
        wires, stiffness = 2, truth["composite.deflection_per_strain"] * truth[FRONT]
    else:
        section = np.pi * truth["wire.diameter"] ** 2 / 4.0
        load = (truth["load.preload"] + truth["load.force"]) / section
        stiffness = truth["load.stiffness"] * wire_length(truth) / section
        if load_kind(truth) == "antagonist":
            stiffness += truth["wire.martensite_modulus"]
    own = wires * modulus
    # sum sigma = n E_A (eps_L + eps_0 - e) = load + K e
    drawn = load / (wires * truth["wire.martensite_modulus"])
    contraction = (own * (strain + drawn) - load) / (own + stiffness)
    stress = (load + stiffness * contraction) / wires
    return float(truth["wire.austenite_finish_temperature"]
                 + stress / truth["wire.stress_influence_austenite"])


def _volts_for(truth: Parameters, temperature: float) -> float:
    """V that hold a wire at a temperature: V^2/R = h A (T - T_inf)."""
    loss = truth["wire.heat_transfer_coefficient"] * truth["wire.surface_area"]
    excess = temperature - truth["environment.ambient_temperature"]
    return float(np.sqrt(truth["wire.resistance"] * loss * excess))


# --- One rig under the drives of its two records, simulated with any set of features.
RECORDS = ("record", "hold_out")
PER_WIRE = ("current", "temperature")
# Steps of 20 ms instead of 5 ms: enough to size an effect, and for sensitivities.
COARSE = 0.25


@dataclass(frozen=True)
class Stage:
    """A rig's true parameters, its instruments, and its drive in each record."""

    truth: Parameters
    sensors: Sensors
    drives: Mapping[str, Drive]
    _played: dict[tuple, Outcome] = field(default_factory=dict, init=False, repr=False,
                                          compare=False)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.truth["bench.channels"])

    @property
    def sides(self) -> tuple[str, ...]:
        """Of each wire."""
        return tuple(self.truth["bench.channel_sides"])

    @classmethod
    def from_label(cls, label: Mapping[str, Any]) -> Self:
        """The stage of a case, whose features are label["features"], or label["base"]."""
        return cls(_rig(dict(label["truth"]), {}, label.get("load", "beam")),
                   msgspec.convert(label["sensors"], Sensors),
                   msgspec.convert(label["drives"], dict[str, Drive]))

    def play(self, features: Mapping[str, float], record: str, fine: float = 1.0,
             parameters: Parameters | None = None) -> Outcome:
        """Simulate a record with these features: output every 20 ms, steps of at most 5 ms/fine;
        `parameters` instead of the rig's true ones if given."""
        # Features of the instruments do not change the bench.
        physical = {n: v for n, v in features.items() if BY_NAME[n].stage != "sensor"}
        key = (record, fine, *sorted(physical.items()))
        if parameters is None and key in self._played:
            return self._played[key]
        time = self.drives[record].grid(COMMAND_PERIOD)
        world = world_of(parameters or self.truth, features)
        outcome = happen(world, time, self.drives[record].voltage(time, self.sides), fine)
        if parameters is None:
            self._played[key] = outcome
        return outcome

    def read(self, features: Mapping[str, float], record: str, fine: float = 1.0,
             parameters: Parameters | None = None) -> dict[str, Array]:
        """Readings of the instruments without noise: signal -> (n,), every 20 ms."""
        outcome = self.play(features, record, fine, parameters)
        return self.named(readings(outcome, world_of(self.truth, features), self.sensors))

    def named(self, clean: Mapping[str, Array]) -> dict[str, Array]:
        """Signal -> (n,) of readings (n, w) by quantity."""
        of_wires = {f"{channel}.{quantity}": clean[quantity][:, wire]
                    for quantity in PER_WIRE for wire, channel in enumerate(self.channels)}
        return of_wires | {n: v for n, v in clean.items() if n == "deflection"}

    def peak_current(self) -> float:
        """A; the largest of both records in the baseline."""
        volts = (np.max(d.voltage(d.grid(COMMAND_PERIOD))) for d in self.drives.values())
        return float(max(volts) / self.truth["wire.resistance"])


def quantity_of(signal: str) -> str:
    return signal.rpartition(".")[2]


def gaps(one: Mapping[str, Array], other: Mapping[str, Array], sensors: Sensors,
         quantities: Iterable[str]) -> dict[str, float]:
    """Root mean square of the difference over the noise, for every signal of the quantities."""
    wanted = set(quantities)
    return {name: float(np.sqrt(np.mean((one[name] - other[name]) ** 2)) / sensors.std(quantity))
            for name in one if (quantity := quantity_of(name)) in wanted}


def where(with_effect: Mapping[str, Array], without: Mapping[str, Array], stage: Stage, record: str,
          quantities: Iterable[str]) -> list[dict[str, Any]]:
    """The gap by signal, phase and side, largest share first: rows of signal, phase, side, gap
    (over noise, root mean square in the cell) and share (of the squared gaps over noise of all
    samples that the record holds)."""
    drive = stage.drives[record]
    time = drive.grid(COMMAND_PERIOD)
    driven = (drive.voltage(time) > 0.0).any(axis=1)
    phase = np.where(driven, "drive", np.where(np.maximum.accumulate(driven), "rest", "initial"))
    side = np.full(len(time), "", dtype="<U5")  # driven now, or last
    for pulse in drive.pulses:
        side[time >= pulse.times[0]] = pulse.side
    rows = []
    for name in gaps(with_effect, without, stage.sensors, quantities):
        quantity = quantity_of(name)
        square = ((with_effect[name] - without[name]) / stage.sensors.std(quantity)) ** 2
        here = side
        if quantity in PER_WIRE:
            own = stage.sides[stage.channels.index(name.partition(".")[0])]
            here = np.full(len(side), own)
        if len(set(stage.sides)) == 1:  # no other side to tell it from
            here = np.full(len(side), "")
        for p, s in sorted(set(zip(phase.tolist(), here.tolist(), strict=True))):
            cell = square[(phase == p) & (here == s)]
            energy = float(cell.sum() * stage.sensors.rate(quantity))
            row = {"signal": name, "phase": p, "side": s, "gap": float(np.sqrt(cell.mean()))}
            rows.append({**row, "share": energy})
    total = sum(row["share"] for row in rows) or 1.0
    rows = [{**row, "share": row["share"] / total} for row in rows]
    return sorted(rows, key=lambda row: -row["share"])

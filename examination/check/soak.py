"""False cuts: the safety rules on hours of benches without faults, where they must never cut.

Rooms have 5 to 40 degC while the parameter file says 23; there are draughts (up to 0.25 m/s, 1.7
times the heat loss), wires whose resistance has grown by up to 20 %, sensors that are slow, have
four times the noise of their data sheets and drop readings now and then, supplies that sag under
load and dip. True temperatures stay 10 K below the limit, currents below 0.8 of theirs, so every
cut is false.

host       hardware/safety.py on the physics and sensors of the virtual bench: in 19 of 20 hours one
           wire with the rules of the commanding node, in the others four wires with the bridge's
           driver
firmware   safety.c and session.c compiled for this computer (test/firmware/host/soak.c)

    ./bench check soak [--hours 1000] [--json soak.json]
"""

import functools
import math
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "firmware"))

from host_firmware import build_program

from examination.pieces import IN_PIECES, in_pieces, options_of, poisson_bound, print_table
from sma_bench.arrays import Array
from sma_bench.hardware.bench_driver import BenchDriver, device_limits
from sma_bench.hardware.bench_sensors import BenchSensors, Instrument
from sma_bench.hardware.safety import CELSIUS_ZERO, Guard, Limits
from sma_bench.hardware.serial_link import LinkStatus
from sma_bench.hardware.serial_messages import CAUSES, DeviceIdentity, Telemetry
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.node_tables import SERIAL_BRIDGE, SIMULATOR
from sma_bench.physics import Bench, Simulation

ROOT, HOUR = Path(__file__).resolve().parents[2], 3600.0
GRID, COMMANDS = 0.01, 0.02  # s, of the physics and between commands
GUST = 30.0  # s, length of a draught and of a drive
N, TICKS = round(GUST / COMMANDS), round(GUST / GRID)  # commands and steps per draught
CLOCK = GRID * np.arange(TICKS + 1)
EVERY_DRIVEN = 20  # every 20th hour of the host has four wires with the bridge's driver
STATED = {"a wire": Parameters.defaults()}
STATED["four wires"] = read_parameters(ROOT / "config" / "composite_rig.yaml")
SIMULATED = {p.name: p.default for p in SIMULATOR}
BRIDGE = {p.name: p.default for p in SERIAL_BRIDGE}
DEVICE = DeviceIdentity("sma-uno", "0", "", 10.0, 0.2, 6.5, 12.0, (6.0, 15.0), 1.0, 8.0, 2.0)
COOLER, SHARE_OF_CURRENT = 10.0, 0.8  # K below, and share of, the limits of the bench
SWING = 1.5  # K, change of the room temperature in an hour
Cuts = list[tuple[float, str]]  # time and reason
CURRENT_NOISE = 0.018  # A, of one conversion with an ACS712-20A
DRIFT = 3.4e-3  # A/K, of its offset
CONVERSIONS = 24  # per board and telemetry message


@dataclass(frozen=True)
class World:
    """Conditions of an hour; factors, unless a unit is given."""

    room: float  # K
    draught: float  # largest relative increase of the heat loss
    age: tuple[float, ...]  # of each wire's resistance
    austenite: float  # relative change of resistance
    noise: float
    slow: bool
    sag: float  # ohm of supply and cables
    dip: float  # largest relative drop of the supply voltage, for half a second
    camera: bool
    errors: tuple[float, ...]  # of volts, amperes, kelvins above the room; offsets in A, K

    def guard(self, channels: Sequence[str]) -> Guard:
        """A new guard, for the sensors of this bench."""
        feedback = ("power", "temperature") if self.camera else ("power",)
        return Guard(channels, feedback, BRIDGE["feedback_timeout"])

    def parameters(self, stated: Parameters, loss: float, warmer: float) -> Parameters:
        """True parameters in a draught of `loss` and a room `warmer` K than at the start."""
        return stated.replace({
            "wire.resistance": stated["wire.resistance"] * max(self.age),
            "wire.heat_transfer_coefficient": stated["wire.heat_transfer_coefficient"] * loss,
            "environment.ambient_temperature": self.room + warmer,
            "effect.phase_dependent_resistance.austenite_change": self.austenite,
            "effect.temperature_lag.time_constant": 0.4 if self.slow else 0.03})

    def highest(self, limits: Limits) -> float:
        """Highest voltage [V] of the drive."""
        least = limits.resistance * max(self.age) * min(1.0 + self.austenite, 1.0)
        hottest = limits.maximum_temperature - COOLER - max(self.room, limits.ambient) - SWING
        heat = math.sqrt(hottest * limits.heat_loss * least)
        return min(heat, SHARE_OF_CURRENT * limits.maximum_current * least)


def draw_world(rng: np.random.Generator) -> World:
    """Random conditions; each disturbance occurs in half of the hours."""
    uniform, has = rng.uniform, (rng.random(6) < 0.5).tolist()
    age = 1.0 + 0.2 * rng.random() * has[1]
    return World(CELSIUS_ZERO + uniform(5.0, 40.0), 0.7 * has[0], (age,) * 4, uniform(-0.15, 0.1),
                 4.0 if has[2] else 1.0, has[3], uniform(0.02, 0.1) * has[4], 0.08 * has[4],
                 bool(rng.random() < 0.8),
                 tuple(uniform(-1.0, 1.0, 5) * (0.01, 0.02, 0.02, 0.05, 2.0)))  # fmt: skip


def programme(rng: np.random.Generator, most: float) -> Array:
    """(N,) V, one per command: 0 V for a second; then rest, hold, staircase, triangle or pulses."""
    at, level, shape = np.arange(N), most * rng.random() ** 0.5, rng.integers(5)
    if shape < 2:
        found = np.full(N, level * shape)
    elif shape == 2:
        found = (most * rng.random(rng.integers(2, 9)))[at * 2 // N]
    else:
        period = rng.uniform(4.0, 30.0) if shape == 3 else rng.uniform(0.2, 4.0)
        phase = at * COMMANDS / period % 1.0
        shown = 1.0 - np.abs(2.0 * phase - 1.0) if shape == 3 else phase < rng.uniform(0.2, 0.8)
        found = level * shown
    found[: round(1.0 / COMMANDS)] = 0.0
    return found


def dips(rng: np.random.Generator, world: World) -> Array:
    """(N,) relative voltage of the supply, one per command."""
    share = np.full(N, 1.0)
    if world.dip:
        begin, last = int(rng.integers(N)), int(rng.uniform(0.02, 0.6) / COMMANDS) + 1
        share[begin : begin + last] -= world.dip * rng.random()
    return share


def instruments(rng: np.random.Generator, world: World,
                seed: int) -> tuple[dict[str, Instrument], int, int]:
    """Sensors by quantity; steps of GRID between two readings of power and of temperature."""
    settings = {name: value * world.noise if name.endswith("_noise") else value
                for name, value in SIMULATED.items()}
    kinds = ("voltage", "current", "temperature")
    seeds = np.random.SeedSequence(seed).spawn(len(kinds))
    chain = {k: Instrument(settings, k, s) for k, s in zip(kinds, seeds, strict=True)}
    steps = (20, 25) if world.slow else (2, 2) if rng.random() < 0.05 else (20, 20)
    return chain, *steps


def silences(rng: np.random.Generator, world: World, n: int) -> list[bool]:
    """(n,) True where a reading is dropped; never three in a row for a slow camera."""
    silent = rng.random(n) < (0.05 if world.slow or world.noise > 1.0 else 0.0)
    silent[2:] &= ~(silent[1:-1] & silent[:-2])
    silent[:2] = silent[-2:] = False
    return silent.tolist()


def driven(rng: np.random.Generator, world: World, stated: Parameters, seconds: float,
           regulated: bool) -> Iterator[tuple[float, Array, Array, Simulation]]:
    """For each draught: its start [s], the commands (N, w) V, the supply's share at each (N,), and
    what the bench does; a `regulated` drive makes up for its supply."""
    limits = Limits.from_parameters(stated)
    own, most = limits.resistance * max(world.age), world.highest(limits)
    bench = Bench(world.parameters(stated, 1.0, 0.0))
    for k in range(math.ceil(seconds / GUST)):
        calm = rng.random() < 0.4
        share = 0.02 * rng.random() if calm else min(rng.exponential(0.3), world.draught)
        warmer = SWING * math.sin(2.0 * math.pi * k * GUST / HOUR)
        commands = np.column_stack([programme(rng, most) for _ in stated["bench.channels"]])
        supply = dips(rng, world)
        volts = commands if regulated else commands * (supply * own / (own + world.sag))[:, None]
        held = np.repeat(volts, 2, axis=0)
        now = world.parameters(stated, 1.0 + min(share, world.draught), warmer)
        bench = Bench(now, initial=bench.state)
        yield GUST * k, commands, supply, bench.follow(CLOCK, np.vstack([held, held[-1:]]))


def hour_of_a_wire(world: World, seed: int, seconds: float = HOUR) -> Cuts:
    """Cuts of a faultless wire by the rules of a commanding node."""
    rng, stated = np.random.default_rng([1, seed]), STATED["a wire"]
    limits = Limits.from_parameters(stated)
    chain, power_every, kelvin_every = instruments(rng, world, seed)
    volt_gain, ampere_gain, kelvin_gain = (1.0 + error for error in world.errors[:3])
    cuts, arrived = [], [0.0]
    heard = 1.0  # s, after which a new guard has all its readings
    guard = world.guard(["wire"])
    for begun, commands, _, made in driven(rng, world, stated, seconds, regulated=False):
        # The latest reading of a sensor when the next command comes.
        read = slice(power_every - 1, -1, power_every)
        volts = chain["voltage"].read_all(made.voltage[read, 0] * volt_gain)
        amperes = chain["current"].read_all(made.current[read, 0] * ampere_gain + world.errors[3])
        amperes[silences(rng, world, len(amperes))] = math.nan
        kelvins = chain["temperature"].read_all(
            world.room
            + kelvin_gain * (made.temperature_reading[kelvin_every::kelvin_every, 0] - world.room)
            + world.errors[4] - CELSIUS_ZERO) + CELSIUS_ZERO
        silent = silences(rng, world, len(kelvins))
        powers = list(zip(volts.tolist(), amperes.tolist(), strict=True))
        temperatures, asked = kelvins.tolist(), commands[:, 0].tolist()
        late = begun + CLOCK + rng.uniform(0.0, 0.04, TICKS + 1)
        late[0] = arrived[-1]
        arrived = np.maximum.accumulate(late).tolist()
        for k in range(1, TICKS + 1):
            stamp, reason, now = begun + GRID * k, "", arrived[k]
            if k % 2:
                guard.commanded((asked[k // 2],))
            if k % kelvin_every == 0 and not silent[k // kelvin_every - 1] and world.camera:
                reason = guard.fault(now) if stamp > heard else ""  # the oldest stamp
                guard.temperature("wire", temperatures[k // kelvin_every - 1], stamp, now, limits)
            if k % power_every == 0:
                guard.power("wire", *powers[k // power_every - 1], stamp, now, limits)
                reason = reason or (guard.fault(now) if stamp > heard else "")
            if reason:
                cuts.append((stamp, reason))
                guard, heard = world.guard(["wire"]), begun + GUST + 1.0
                break
    return cuts


def driver_of(world: World) -> tuple[BenchDriver, Guard, Limits]:
    """The bridge's driver of four wires, with a device that obeys and is not tested here."""
    stated, doing = STATED["four wires"], dict.fromkeys(("limit", "arm", "drive", "stop"), done)
    limits, channels = Limits.from_parameters(stated), stated["bench.channels"]
    link: Any = SimpleNamespace(status=LinkStatus(True, DEVICE, connections=1), **doing)
    guard = world.guard(channels)
    sensors = BenchSensors(stated["bench.channel_sides"], BRIDGE)
    return BenchDriver(link, sensors, guard, channels, limits, waiver="soak"), guard, limits


def done(*_: Any) -> None:
    """Request to the device: does nothing."""


def hour_of_four_wires(world: World, seed: int, seconds: float = HOUR) -> Cuts:
    """Cuts of four faultless wires by the bridge's driver."""
    rng, stated = np.random.default_rng([2, seed]), STATED["four wires"]
    driver, guard, limits = driver_of(world)
    chain, power_every, kelvin_every = instruments(rng, world, seed)
    channels, cuts = stated["bench.channels"], []
    own = limits.resistance * max(world.age)
    for begun, commands, share, made in driven(rng, world, stated, seconds, regulated=True):
        # The pulses of a board load its supply.
        held, supply = np.repeat(commands, 2, axis=0), np.repeat(12.0 * share, 2)
        ohms = own * (1.0 + world.austenite * (1.0 - made.martensite_fraction[1:]))
        pairs = held.reshape(-1, 2, 2) > 0.0
        drop = supply[:, None] * world.sag * (pairs / ohms.reshape(-1, 2, 2)).sum(axis=2)
        loaded = supply[:, None] - drop
        duties = (held / np.repeat(loaded, 2, axis=1)) ** 2
        mean = (duties * np.repeat(loaded, 2, axis=1) / ohms).reshape(-1, 2, 2).sum(axis=2)
        noise = rng.normal(0.0, CURRENT_NOISE * world.noise / CONVERSIONS**0.5, mean.shape)
        mean = mean * (1.0 + world.errors[1]) + world.errors[3] + noise
        kelvins = made.temperature_reading[1:]
        kelvins = world.room + (1.0 + world.errors[2]) * (kelvins - world.room) + world.errors[4]
        silent = silences(rng, world, TICKS // kelvin_every)
        if not driver.enabled:  # at the start, and after a cut
            for k in range(100):
                at = begun + GRID * (k - 100)
                driver.take(Telemetry(0, 0, 0, 0, 12.0, (world.errors[3],) * 2, (1.5, 1.5),
                                      (0.0,) * 4, 0, time=at), at)
            for name in channels:
                guard.temperature(name, world.room, begun, begun, limits)
            driver.enable(begun)
        for k in range(TICKS):
            stamp = begun + GRID * (k + 1)
            now = stamp + 0.01
            if (k + 1) % kelvin_every == 0 and not silent[k // kelvin_every] and world.camera:
                for name, kelvin in zip(channels, kelvins[k], strict=True):
                    read = chain["temperature"].read(kelvin - CELSIUS_ZERO) + CELSIUS_ZERO
                    guard.temperature(name, read, stamp, now, limits)
            if (k + 1) % power_every == 0:
                driver.take(Telemetry(0, 0, 0, 0, supply[k] * (1.0 + world.errors[0]),
                                      tuple(mean[k]), (1.5, 1.5), tuple(duties[k]), 0,
                                      tuple(drop[k]), stamp), now)
            if k % 2:
                continue
            timeouts = driver.gate.timeouts
            reason = driver.command(commands[k // 2].tolist(), now, "soak") or driver.tick(now)
            if driver.gate.timeouts > timeouts:
                reason = reason or "a command timed out"
            if reason:
                cuts.append((stamp, reason))
                driver, guard, limits = driver_of(world)
                break
    return cuts


# --- The firmware's rules
@functools.cache
def built() -> tuple[Any, Path]:
    """The firmware's program, built once per process, and its folder."""
    folder = tempfile.TemporaryDirectory(prefix="soak_")
    return folder, build_program("soak.c", Path(folder.name), ("-O3",))


def hour_of_the_firmware(world: World, seed: int, seconds: float = HOUR) -> Cuts:
    """Cuts of four faultless wires by safety.c."""
    limits = Limits.from_parameters(STATED["four wires"])
    numbers = (seed, seconds, 12.0, world.sag, world.dip, CURRENT_NOISE * world.noise,
               2.0 * world.errors[3], DRIFT * SWING, limits.resistance * max(world.age),
               world.austenite, world.room, limits.heat_loss * (1.0 + 0.3 * world.draught),
               limits.heat_capacity, world.highest(limits))
    asked = "C " + " ".join(map(str, device_limits(limits, DEVICE, 12.0)))
    ended = subprocess.run([built()[1], *map(repr, map(float, numbers)), asked],
                           capture_output=True, text=True, check=True)
    lines = [line.split() for line in ended.stdout.splitlines()]
    return [(float(at), f"device: {CAUSES[int(cause)]}") for at, cause in lines]


PLAYS = {"a wire": hour_of_a_wire, "four wires": hour_of_four_wires,
         "firmware": hour_of_the_firmware}


def played(kind: str, number: int) -> dict[str, Any]:
    """A random hour: its cuts and its run time."""
    started = time.monotonic()
    world = draw_world(np.random.default_rng([list(PLAYS).index(kind), number]))
    cuts = PLAYS[kind](world, number)
    return {"kind": kind, "seed": number, "cuts": cuts, "took": time.monotonic() - started}


def report(found: Sequence[dict[str, Any]]) -> int:
    """Print the tables; number of cuts."""
    rows = []
    for kind in PLAYS:
        if own := [one for one in found if one["kind"] == kind]:
            hours, cuts = len(own), sum(len(one["cuts"]) for one in own)
            speed = HOUR * hours / sum(one["took"] for one in own)
            rows.append((kind, hours, cuts, f"{cuts / hours:.2g}",
                         f"{poisson_bound(cuts) / hours:.2g}", f"{speed:.3g}"))
    print_table(("sound benches", ">hours", ">false cuts", ">an hour", ">at most (95 %)",
                 ">times real time"), rows)
    kinds: dict[str, list[str]] = {}
    for one in found:
        for at, reason in one["cuts"]:
            where = f"{one['kind']} {one['seed']} at {at:.1f} s: {reason}"
            kinds.setdefault(re.sub(r"-?\d[\d.]*", "#", reason), []).append(where)
    for cuts in sorted(kinds.values(), key=len, reverse=True):
        print(f"{len(cuts)} like {cuts[0]}")
    return sum(len(one["cuts"]) for one in found)


def main(argv: Sequence[str] | None = None) -> int:
    """0 if nothing was cut."""
    options = options_of("soak", __doc__, argv, seed=(1, "of all"),
                         hours=(1000, "of host and of firmware, each"), **IN_PIECES)
    driven = options.hours // EVERY_DRIVEN
    hours = {"a wire": options.hours - driven, "four wires": driven, "firmware": options.hours}
    jobs = [(kind, 10_000 * options.seed + k) for kind, n in hours.items() for k in range(n)]
    return 1 if report(in_pieces(played, jobs, options)) else 0

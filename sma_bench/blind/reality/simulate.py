"""Let things happen in a world: voltages in, true values out."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sma_bench.blind.reality import heat
from sma_bench.blind.reality.beam import beam, pull_at_rest
from sma_bench.blind.reality.heat import NODES, circuit, strip
from sma_bench.blind.reality.loop import (
    CURRENT,
    MARTENSITE,
    QUANTITIES,
    STRESS,
    SURFACE,
    TEMPERATURE,
    Course,
    Habits,
    Rig,
    run,
    scratch_for,
    wires_at_rest,
)
from sma_bench.blind.reality.transformation import grain_classes, grains_at_rest, ramp_table
from sma_bench.blind.reality.world import World
from sma_bench.compiled import warn_if_plain
from sma_bench.errors import InputError

Array = NDArray[np.float64]

LONGEST_STEP = 5e-3  # s
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Outcome:
    """What happened, true values on the given time grid (w wires in the order of the channels).

    Attributes:
        time: (n,) s; voltage: (n, w) V at the driver, held from each sample to the next.
        current: (n, w) A; temperature: (n, w) K of the wires.
        surface: (n, w) K of the silicone beside each wire, which an infrared spot sees too.
        martensite_fraction: (n, w); stress: (n, w) Pa.
        deflection: (n,) m of the tip, positive to the front; side_deflection: (n, 2) m, what
            front and back do, each towards itself.
        ambient: (n,) K of the air.
    """

    time: Array
    voltage: Array
    current: Array
    temperature: Array
    surface: Array
    martensite_fraction: Array
    stress: Array
    deflection: Array
    side_deflection: Array
    ambient: Array


def happen(world: World, time: ArrayLike, voltage: ArrayLike, fine: float = 1.0) -> Outcome:
    """What a world does under given voltages, from rest at ambient temperature.

    Args:
        world: the rig with its features; sensor features do nothing here.
        time: (n,) s, increasing; voltage: (n, w) V, held from each sample to the next.
        fine: internal steps are at most 5 ms/fine long (0.25: 20 ms, for cheap sensitivities).

    Raises:
        InputError: shapes that do not fit, times that do not increase, values that are not finite.
    """
    warn_if_plain()
    course = _course(world, np.array(time, dtype=float), np.array(voltage, dtype=float), fine)
    samples, wires = course.voltage.shape
    rig = _rig(world)
    still = float(world.parameters["environment.ambient_temperature"])
    field = np.full((len(rig.pairs), NODES), still)
    values = np.zeros((samples, QUANTITIES, wires))
    tip, sides = np.zeros(samples), np.zeros((samples, 2))
    grains = grains_at_rest(wires, len(rig.classes.weight))
    run(
        rig, course, field, grains, pull_at_rest(wires), wires_at_rest(wires, still),
        scratch_for(wires), values, tip, sides,
    )
    return Outcome(
        time=course.time,
        voltage=course.voltage,
        current=values[:, CURRENT],
        temperature=values[:, TEMPERATURE],
        surface=values[:, SURFACE],
        martensite_fraction=values[:, MARTENSITE],
        stress=values[:, STRESS],
        deflection=tip,
        side_deflection=sides,
        ambient=course.ambient,
    )


def _course(world: World, time: Array, voltage: Array, fine: float) -> Course:
    wires = len(world.parameters["bench.channels"])
    if time.ndim != 1 or voltage.shape != (len(time), wires):
        raise InputError(
            f"happen: time has shape {time.shape} and voltage {voltage.shape}, "
            f"expected (n,) and (n, {wires})"
        )
    if not (np.all(np.isfinite(time)) and np.all(np.isfinite(voltage))):
        raise InputError("happen: time or voltage is not finite, expected numbers")
    gap = np.diff(time)
    if np.any(gap <= 0.0):
        k = int(np.argmax(gap <= 0.0))
        raise InputError(f"happen: time[{k + 1}] is {time[k + 1]:g} s, expected to increase")
    if not 0.0 < fine < math.inf:
        raise InputError(f"happen: fine is {fine:g}, expected above 0")
    steps = np.ceil(gap * (fine / LONGEST_STEP) - ROUNDING).astype(np.int64)
    return Course(
        time, voltage, heat.ambient(world, time), heat.gusts(world, time), np.maximum(steps, 1)
    )


def _rig(world: World) -> Rig:
    sides = world.parameters["bench.channel_sides"]
    front, back = ([i for i, s in enumerate(sides) if s == side] for side in ("front", "back"))
    return Rig(
        circuit(world),
        strip(world),
        np.array([front, back], dtype=np.int64).T.copy(),
        grain_classes(world),
        ramp_table(world.feature("kinetics_smoothness")),
        beam(world),
        Habits(
            memory=world.feature("return_point_memory"),
            lag=world.feature("transformation_lag"),
            latent=world.parameters["wire.mass"] * world.feature("latent_heat"),
            drift=world.feature("transition_drift"),
            plastic=world.feature("plastic_strain"),
            drift_cycles=world.feature("drift_cycles"),
            friction=world.feature("friction"),
            slip=world.feature("clamp_slip"),
            slip_time=world.feature("clamp_slip_time"),
        ),
    )

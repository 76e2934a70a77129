"""Heat in the reality: electrical heating, the silicone between the wires, the air."""

import math
from collections import namedtuple

import numpy as np

from examination.blind.reality import forms
from examination.blind.reality.forms import Array
from examination.blind.reality.world import World
from sma_bench.compiled import inlined

# --- The air around a bench: its temperature, its gusts, and the heat transfer at a surface.
#
# Free convection from a horizontal cylinder: S. W. Churchill and H. H. S. Chu, Int. J. Heat
# Mass Transfer 18 (1975) 1049, eq. 12. Radiation to surroundings at the temperature of the air.

GRAVITY, STEFAN_BOLTZMANN = 9.81, 5.670374e-8
PRANDTL, EMISSIVITY = 0.71, 0.9  # of air; of silicone
REFERENCE_EXCESS = 25.0  # K above the air, at which the film is the baseline's
EXCESS_STEP, LARGEST_EXCESS = 1.0, 400.0  # K, of the table that the loop reads
LEAST_FILM = 0.05
WAVE_PERIOD = 180.0  # s
GUST_GAP, GUST_LENGTH = 12.0, (2.0, 8.0)  # s: mean of an exponential distribution; ends


def free_convection(excess: Array, air: float, diameter: float) -> Array:
    """h [W/(m2 K)] of a horizontal cylinder, its surface so many K (above 0) above the air."""
    film = air + 0.5 * excess
    conductivity = 0.0241 * (film / 273.15) ** 0.81
    viscosity = 1.33e-5 * (film / 273.15) ** 1.76  # kinematic, at sea level
    rayleigh = GRAVITY / film * excess * diameter**3 * PRANDTL / viscosity**2
    factor = (1.0 + (0.559 / PRANDTL) ** (9.0 / 16.0)) ** (8.0 / 27.0)
    nusselt = (0.60 + 0.387 * rayleigh ** (1.0 / 6.0) / factor) ** 2
    return np.asarray(nusselt * conductivity / diameter)


def relative_film(world: World) -> Array:
    """(m,) conductance of the film over the baseline's, by excess in steps of EXCESS_STEP."""
    air = world.parameters["environment.ambient_temperature"]
    diameter = world.parameters["composite.thickness" if world.load == "beam" else "wire.diameter"]
    excess = np.maximum(np.arange(0.0, LARGEST_EXCESS, EXCESS_STEP), 1e-3)
    surface, share = air + excess, world.feature("convection_by_correlation")
    rays = EMISSIVITY * STEFAN_BOLTZMANN * (surface**2 + air**2) * (surface + air)
    both = free_convection(excess, air, diameter) + rays
    relative, rays = (h / np.interp(REFERENCE_EXCESS, excess, h) for h in (both, rays))
    other = world.feature("convection_radiant"), world.feature("convection_onset")
    relative = forms.film(*other, relative, rays, excess, REFERENCE_EXCESS)
    return np.asarray(np.maximum(1.0 + share * (relative - 1.0), LEAST_FILM))


def ambient(world: World, time: Array) -> Array:
    """(n,) K of the air; starts at the rig's ambient temperature."""
    passed = time - time[0]
    wave = world.feature("ambient_wave") * np.sin(2.0 * np.pi * passed / WAVE_PERIOD)
    still = world.parameters["environment.ambient_temperature"]
    warmed = [world.feature(f"ambient_{name}") for name in ("rate", "settling", "instant")]
    return np.asarray(still + forms.room(*warmed, passed) + wave)


def gusts(world: World, time: Array) -> Array:
    """(n,) factor on the film's conductance, 1 in still air: a seeded train of smooth gusts."""
    factor, strength = np.ones(len(time)), world.feature("draught")
    if strength == 0.0:
        return factor
    rng = np.random.default_rng(int(world.feature("draught_seed")))
    passed = time - time[0]
    start = rng.exponential(GUST_GAP)
    while start < passed[-1]:
        length, height = rng.uniform(*GUST_LENGTH), rng.uniform(0.5, 1.0)
        phase = np.clip((passed - start) / length, 0.0, 1.0)
        factor += strength * height * np.sin(np.pi * phase) ** 2
        start += length + rng.exponential(GUST_GAP)
    return factor


# --- Current through a wire: its resistance by phase and temperature, leads, contacts, driver.
#
# The resistance of martensite and austenite differs, and both rise with temperature (NiTi: D.
# C. Lagoudas, Shape Memory Alloys, 2008, table 1.1); only the wire's own part heats it.
LEAST_RESISTANCE = 0.05  # of the wire's at rest
SECONDS_PER_MINUTE = 60.0


@inlined
def current(rig, voltage, temperature, martensite, driven, sag):
    """A and heating W of a wire driven so long [s], its supply sagging by so many V."""
    has = rig.features
    rise = temperature - rig.beam.rest_temperature
    warm = 1.0 + has.resistance_temperature_coefficient * rise
    phase = 1.0 + forms.phase_change(has, martensite, rise)
    wire = rig.resistance * max(warm * phase, LEAST_RESISTANCE)
    contact = has.contact_growth / SECONDS_PER_MINUTE
    amperes = forms.drawn(has, voltage, sag, wire + contact * driven)
    if has.current_limit > 0.0:
        amperes = min(max(amperes, -has.current_limit), has.current_limit)
    return amperes, amperes * amperes * wire


# --- Heat across the thickness: air, silicone, front wire, silicone, back wire, silicone, air.
#
# Each pair of a front wire and the back wire behind it is a strip, a chain of nodes:
#
#     SKIN cells, front wire, MIDDLE cells, back wire, SKIN cells
#
# of C dT/dt = conduction to the neighbours (+ Joule heat in a wire). The skin and the film at its
# surface share the baseline's resistance 1/(h A_c) between wire and air, so that a skin without
# heat capacity is the baseline. Time integration: the L-stable, stiffly accurate, second order
# SDIRK of R. Alexander, SIAM J. Numer. Anal. 14 (1977) 1006; a cell without capacity is an
# algebraic equation to it. Each of its two stages is one tridiagonal solution.

# Relative thickness of the cells, from a wire outwards and from wire to wire: finer at the wires.
SKIN_CELLS, MIDDLE_CELLS = (0.1, 0.2, 0.3, 0.4), (0.15, 0.35, 0.35, 0.15)
SKIN, MIDDLE = len(SKIN_CELLS), len(MIDDLE_CELLS)
FRONT_WIRE, BACK_WIRE, NODES = SKIN, SKIN + 1 + MIDDLE, 2 * SKIN + MIDDLE + 2
STAGE = 1.0 - math.sqrt(0.5)
CARRIED = (1.0 - STAGE) / STAGE
# Rows of the scratch array.
CAPACITY, UPPER, PIVOT, START, RIGHT = 0, 1, 2, 3, 4
# Constants of every strip's chain of nodes: capacity (NODES,) J/K, link (NODES - 1,) W/K to the
# next node; W/K from the outermost cell's middle to its surface (rim) and from there to air, and
# the factor on that by the surface's excess in steps of EXCESS_STEP.
Strip = namedtuple("Strip", "capacity link rim film relative_film")


def strip_of(world: World) -> Strip:
    p = world.parameters
    loss = p["wire.heat_transfer_coefficient"] * p["wire.surface_area"]
    share, conductance = world.feature("silicone_share"), world.feature("side_conductance")
    conductance *= 1.0 - world.feature("coupling_plume")
    # W/K: wire to the first cell, cell to cell, last cell to the surface; and from wire to wire.
    skin_cells, middle_cells = share / loss * np.array(SKIN_CELLS), np.array(MIDDLE_CELLS)
    skin, middle = (0.5 * np.concatenate([[0.0], cells]) + 0.5 * np.concatenate([cells, [0.0]])
                    for cells in (skin_cells, middle_cells))
    skin, middle = 1.0 / skin, conductance / middle
    heat = world.feature("silicone_heat_capacity")
    wire = p["wire.mass"] * p["wire.specific_heat"]
    skin_heat = heat * np.array(SKIN_CELLS)
    # Isolated cells have no influence, but the equations need a number.
    between = 2.0 * heat + world.feature("coupling_capacity")
    middle_heat = between * middle_cells if conductance > 0.0 else np.ones(MIDDLE)
    return Strip(np.concatenate([skin_heat[::-1], [wire], middle_heat, [wire], skin_heat]),
                 np.concatenate([skin[:-1][::-1], middle, skin[:-1]]), float(skin[-1]),
                 loss / (1.0 - share), relative_film(world))


@inlined
def surface_temperature(strip, cell, air, gust):
    """K of the silicone's surface, and W/K from the outermost cell to the air. The film is taken at
    the excess that the surface would have over the baseline's film."""
    film = strip.film * gust
    excess = abs(cell - air) * strip.rim / (strip.rim + film)
    place = min(excess / EXCESS_STEP, len(strip.relative_film) - 1.001)
    k = int(place)
    lower, upper = strip.relative_film[k], strip.relative_film[k + 1]
    film *= lower + (upper - lower) * (place - k)
    share = strip.rim / (strip.rim + film)
    return air + (cell - air) * share, film * share


@inlined
def warm(strip, field, row, sources, air, gust, step, scratch):
    """Advance the nodes of one strip, a row of field (s, NODES), by a step. sources (2, 2) by front
    and back wire: W into it; J/K that it has beyond its own capacity."""
    front_air = surface_temperature(strip, field[row, 0], air, gust)[1]
    back_air = surface_temperature(strip, field[row, NODES - 1], air, gust)[1]
    part = STAGE * step
    for j in range(NODES):
        scratch[CAPACITY, j] = strip.capacity[j]
    scratch[CAPACITY, FRONT_WIRE] += sources[1, 0]
    scratch[CAPACITY, BACK_WIRE] += sources[1, 1]
    # C + part * conduction, eliminated downwards.
    above = 0.0
    for j in range(NODES):
        diagonal = scratch[CAPACITY, j]
        diagonal += part * (front_air if j == 0 else strip.link[j - 1] * (1.0 - above))
        diagonal += part * (back_air if j == NODES - 1 else strip.link[j])
        scratch[PIVOT, j] = 1.0 / diagonal
        if j < NODES - 1:
            above = part * strip.link[j] * scratch[PIVOT, j]
            scratch[UPPER, j] = above
        scratch[START, j] = field[row, j]
    for stage in range(2):
        for j in range(NODES):
            scratch[RIGHT, j] = scratch[CAPACITY, j] * scratch[START, j]
        scratch[RIGHT, 0] += part * front_air * air
        scratch[RIGHT, NODES - 1] += part * back_air * air
        scratch[RIGHT, FRONT_WIRE] += part * sources[0, 0]
        scratch[RIGHT, BACK_WIRE] += part * sources[0, 1]
        scratch[RIGHT, 0] *= scratch[PIVOT, 0]
        for j in range(1, NODES):
            carried = part * strip.link[j - 1] * scratch[RIGHT, j - 1]
            scratch[RIGHT, j] = (scratch[RIGHT, j] + carried) * scratch[PIVOT, j]
        for j in range(NODES - 2, -1, -1):
            scratch[RIGHT, j] += scratch[UPPER, j] * scratch[RIGHT, j + 1]
        for j in range(NODES):
            now = scratch[RIGHT, j]
            if stage == 0:
                scratch[START, j] += CARRIED * (now - field[row, j])
            else:
                field[row, j] = now

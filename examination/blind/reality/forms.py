"""Other forms of the same effects, selected by settings: short equations, each with its source.

With every setting off, each function is the original form, to the last bit. Sources are for the
kind of equation; one without a source is a plausible assumption of this examination."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sma_bench.compiled import inlined

Array = NDArray[np.float64]

# --- Electrical.
SLOW_SHARE = 0.8  # share of a battery's drop that builds up and decays slowly


@inlined
def phase_change(has, martensite, rise):
    """Relative change of a wire's resistance by phase, `rise` K above the start. a [(1 - w)(1 - xi)
    + 4 w xi (1 - xi)] + |a| b xi (T - T_0): an intermediate phase of higher resistivity (R-phase:
    Otsuka and Ren, Prog. Mater. Sci. 50, 2005), martensite whose resistance rises with temperature
    (Furst and Seelecke, J. Intell. Mater. Syst. Struct. 23, 2012)."""
    change, hump, austenite = has.resistance_austenite_change, has.resistance_hump, 1.0 - martensite
    mixed = change * ((1.0 - hump) * austenite + 4.0 * hump * austenite * martensite)
    return mixed + abs(change) * has.resistance_martensite_slope * rise * martensite


@inlined
def drawn(has, voltage, sag, ohm):
    """Current [A] that a supply drives through `ohm` behind its leads. V - R_s I; V - R_s max(I -
    I_k, 0), an overloaded supply; V - (1 - m) R_s I - u with tau du/dt = m R_s I - u, a battery
    (Thevenin's model: Plett, Battery Management Systems 1, 2015)."""
    leads = has.supply_resistance
    if has.supply_memory > 0.0:
        leads *= 1.0 - SLOW_SHARE
        voltage = max(voltage - sag, 0.0)
    if has.supply_knee > 0.0:
        freely = voltage / ohm
        if freely <= has.supply_knee:
            return freely
        voltage += leads * has.supply_knee
    return voltage / (ohm + leads)


@inlined
def sagged(has, sag, amperes, step):
    """u [V] of `drawn` after a step."""
    if has.supply_memory > 0.0:
        share = -math.expm1(-step / has.supply_memory)
        sag += share * (SLOW_SHARE * has.supply_resistance * amperes - sag)
    return sag


# --- Heat.
ASIDE_WIDTH, ASIDE_BELOW = 5.0, 8.0  # K: deviation of a heat peak of its own, below A_s
ONSET_GAIN = 1.44
EVENT_RISE, EVENT_FALL = 3.0, 60.0  # s
EVENT_REACH = 120.0  # s: a door has the size of a rate over this time


@inlined
def latent_worth(has, martensite):
    """Share of the mean latent heat at this fraction: (1 - q)[1 + k (2 xi - 1)], the skewed peaks
    of calorimetry (Otsuka and Ren 2005)."""
    return (1.0 - has.latent_aside) * (1.0 + has.latent_skew * (2.0 * martensite - 1.0))


@inlined
def latent_aside(has, temperature, centre):
    """Share of the latent heat per kelvin that another phase absorbs: q N(T; T_R, 5 K), the
    R-phase's own peak (Miyazaki and Otsuka, Metall. Trans. A 17, 1986)."""
    if has.latent_aside == 0.0:
        return 0.0
    away = (temperature - centre) / ASIDE_WIDTH
    return has.latent_aside * math.exp(-0.5 * away * away) / (ASIDE_WIDTH * 2.5066282746)


def film(radiant: float, onset: float, relative: Array, rays: Array, excess: Array,
         reference: float) -> Array:
    """Film (m,) by excess over that at the reference [K]: free convection and radiation; radiation
    alone, `rays` (m,) (Stefan and Boltzmann); or Nu = 1 + 1.44 max(1 - Ra_c/Ra, 0), a layer in
    which convection sets in (Hollands et al., J. Heat Transfer 98, 1976)."""
    if onset > 0.0:
        layer = 1.0 + ONSET_GAIN * np.maximum(1.0 - onset / excess, 0.0)
        return np.asarray(layer / np.interp(reference, excess, layer))
    return rays if radiant > 0.0 else relative


LAYERS = (0.1, 1.0, 10.0)  # of the time


@inlined
def from_reservoir(has, warmed, i, temperature, step):
    """W into wire i from reservoirs that it warms beside it; `warmed` (w, 3) K is advanced. G
    (E - T) with tau dE/dt = T - E, a clamp; the mean of three of them, times a decade apart, a
    block (lumped capacities: Incropera, Fundamentals of Heat and Mass Transfer, ch. 5)."""
    watts = 0.0
    for k in range(3):
        part = 1.0 / 3.0 if has.reservoir_spread > 0.0 else (1.0 if k == 1 else 0.0)
        watts += part * has.reservoir * (warmed[i, k] - temperature)
        share = -math.expm1(-step / (has.reservoir_time * LAYERS[k]))
        warmed[i, k] += share * (temperature - warmed[i, k])
    return watts


def room(rate: float, settling: float, instant: float, passed: Array) -> Array:
    """K by which a room has warmed: r t; r tau [1 - exp(-t/tau)], an enclosure that settles; or a
    door that is opened, 120 s r exp(-t/60 s) from that instant on (first-order rooms: ASHRAE
    Handbook, Fundamentals)."""
    if settling > 0.0:
        return np.asarray(-rate * settling * np.expm1(-passed / settling))
    if instant > 0.0:
        since = np.maximum(passed - instant, 0.0)
        opened = np.exp(-since / EVENT_FALL) - np.exp(-since / EVENT_RISE)
        return np.asarray(rate * EVENT_REACH * opened)
    return np.asarray(rate * passed)


# --- Transformation.
RELAYS = 6
NARROW = 0.35  # width of a grain's own range, of the wire's


def relay_rows(starts, finishes, shifts, share: float) -> list[tuple]:
    """Grain classes (weight, A_f, rate, shift, M_f, rate, shift), each with a narrow range of
    its own, in the same order both ways: Preisach's plane along its centres, the play operator
    (Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989)."""
    # Places that give, with the narrow ranges, the mean and deviation of the cosine.
    places = np.arccos(1.0 - 2.0 * (np.arange(RELAYS) + 0.5) / RELAYS) / np.pi - 0.5
    places *= math.sqrt((0.25 - 2.0 / math.pi**2) * (1.0 - NARROW**2)) / np.std(places)
    hot, cold = finishes[0] - starts[0], starts[1] - finishes[1]
    return [(share / RELAYS, 0.5 * (starts[0] + finishes[0]) + (place + 0.5 * NARROW) * hot,
             1.0 / (NARROW * hot), shifts[0],
             0.5 * (starts[1] + finishes[1]) + (place - 0.5 * NARROW) * cold, 1.0 / (NARROW * cold),
             shifts[1]) for place in places.tolist()]


@inlined
def duhem(bow, own, turned, before):
    """Factor on the straight way out of a loop, and on its slope: 1 + b (1 - y_r)(1 - o/o_r), a
    branch that starts flat, as with Duhem equations whose slope grows with the distance travelled
    (Madill and Wang, IEEE Trans. Control Syst. Technol. 6, 1998). A full loop stays as it is."""
    bulge = bow * max(1.0 - before, 0.0)
    if bulge == 0.0 or turned <= 0.0 or own <= 0.0 or own > turned:
        return 1.0, 1.0
    place = own / turned
    return 1.0 + bulge * (1.0 - place), 1.0 + bulge * (1.0 - 2.0 * place)


@inlined
def bent_stress(knee, square, stress):
    """Stress on which the change of 1/C acts, and its slope: above a knee only (Brinson, J. Intell.
    Mater. Syst. Struct. 4, 1993), or sigma |sigma|/sigma_0, a bent line in the plane of stress and
    temperature (Tanaka et al., Res. Mechanica 18, 1986)."""
    if square > 0.0:
        return stress * abs(stress) / square, 2.0 * abs(stress) / square
    return (stress - knee, 1.0) if stress > knee else (0.0, 0.0)


def smooth_ramp(law: float, position: Array, deviation: float) -> tuple[Array, Array]:
    """Ramp (m,) and its slope, of the mean 1/2 and this deviation: logistic (Ikuta et al., IEEE
    MEMS 1991), or exponential with a sharp start (Tanaka 1986)."""
    if law == 1.0:
        scale = deviation * math.sqrt(3.0) / math.pi
        value = 1.0 / (1.0 + np.exp(-(position - 0.5) / scale))
        return value, value * (1.0 - value) / scale
    value = np.exp(np.minimum(position - 0.5 - deviation, 0.0) / deviation)
    return value, np.where(value < 1.0, value / deviation, 0.0)


@inlined
def worn(has, loops, driven):
    """Share of the drift that is reached: by loops, or by the time that the wire was hot (ageing:
    Eggeler et al., Mater. Sci. Eng. A 378, 2004)."""
    if has.drift_time > 0.0:
        return -math.expm1(-driven / has.drift_time)
    return -math.expm1(-loops / has.drift_cycles)


# --- Mechanics.
SLOW_BACK = 8.0  # time constant of recovery over that of relaxation
POWER_TIMES, POWER_LAW = (0.001, 3.0), 0.3  # of the time; exponent


def prony(law: float, time: float) -> tuple[Array, Array]:
    """Times (k,) and shares of the relaxing terms: a decade apart, one (standard linear solid,
    slower in recovery), or those of a power law t^-0.3 (Schapery, Int. J. Solids Struct. 2,
    1966)."""
    if law == 1.0:
        return np.array([time]), np.ones(1)
    if law == 2.0:
        times = np.geomspace(*POWER_TIMES, 9)
        return time * times, times**-POWER_LAW / np.sum(times**-POWER_LAW)
    return time * np.array([1.0 / math.sqrt(10.0), math.sqrt(10.0)]), np.full(2, 0.5)


@inlined
def relaxing_in(has, time, held):
    """Time constant of a term that holds so much of the deflection: rubber that recovers more
    slowly than it relaxes (Bergstrom and Boyce, J. Mech. Phys. Solids 46, 1998)."""
    return time * SLOW_BACK if has.relaxation_law == 1.0 and held < 0.0 else time


STOP = 0.015  # m


def unequal_sides(lever: float, progressive: float, nearer: float) -> tuple[Array, Array, Array]:
    """Of front and back (2,): lever [m], stiffness over the belief, its growth with d^2 [1/m2]: a
    soft stop on one side (Duffing), or wires nearer to the middle, alpha and beta as 1/a (eq. 16).
    """
    signs = np.array([1.0, -1.0])
    relative = 1.0 / (1.0 - nearer * signs)
    return lever * relative, relative, np.maximum(progressive * signs, 0.0) / STOP**2


@inlined
def taken_up(has, strain, modulus, loose):
    """Elastic strain of a wire with slack, its slope, and how far it lies loose: dead zone; soft,
    s [x/s - 1 + exp(-x/s)], a crimped wire that straightens (Lanir, J. Biomech. 16, 1983); or a
    sleeve with friction, in which it slides where |sigma| > sigma_f (play with friction: Armstrong-
    Helouvry et al., Automatica 30, 1994)."""
    slack = has.slack
    if has.slack_soft > 0.0 and slack > 0.0:
        if strain <= 0.0:
            return strain, 1.0, 0.0
        left = math.exp(-strain / slack)
        return strain - slack * (1.0 - left), 1.0 - left, 0.0
    if has.slack_friction > 0.0:
        hold = has.slack_friction / modulus
        now = min(max(loose, strain - hold), strain + hold)
        now = min(max(now, 0.0), slack)
        sticks = abs(strain - now) < hold or now == 0.0 or now == slack
        return strain - now, 1.0 if sticks else 0.0, now
    now = min(max(strain, 0.0), slack)
    return strain - now, 0.0 if 0.0 < strain < slack else 1.0, 0.0


@inlined
def crept_back(has, most, austenite, step):
    """Largest austenite fraction that still holds strain, which creeps back: tau dm/dt = 1 - xi - m
    (recovery of two-way strain; plausible)."""
    if has.residual_recovery > 0.0:
        most -= (most - austenite) * -math.expm1(-step / has.residual_recovery)
    return most


@inlined
def ratcheted(has, loops):
    """Share of the strain that stays after so many loops: 1 - exp(-n/n_0) (ratcheting: Lagoudas,
    Shape Memory Alloys, 2008, ch. 3)."""
    return -math.expm1(-loops / has.residual_ratchet) if has.residual_ratchet > 0.0 else 1.0


# --- Sensors.
SLOWER = 8.0  # time constant of the slow share over that of the fast one


def lagged(values: Array, period: float, lag: float, slow: float, exposure: float) -> Array:
    """(n, w) readings `period` s apart with a lag from rest: first order, a slow share beside it (a
    glued thermocouple: Moffat, Exp. Therm. Fluid Sci. 1, 1988), or a mean over an exposure."""
    def first_order(time: float) -> Array:
        rho = np.exp(-period / time)
        return np.asarray(lfilter([1.0 - rho], [1.0, -rho], values, axis=0, zi=rho * values[:1])[0])

    if exposure > 0.0:
        width = max(round(2.0 * lag / period), 1)
        total = np.cumsum(np.vstack([np.repeat(values[:1], width, axis=0), values]), axis=0)
        return np.asarray((total[width:] - total[:-width]) / width)
    if slow == 0.0:
        return first_order(lag)
    return (1.0 - slow) * first_order(lag) + slow * first_order(SLOWER * lag)


def offset(shape: Array, time: Array, settling: float, memory: float, power: Array) -> Array:
    """(n,) of a deflection's slow offset, at most about 1: wandering `shape`, a warm-up 1 - exp(-t/
    tau), or a mount that follows the wires' heat (n,) W (thermal drift of triangulation sensors:
    makers' data sheets)."""
    if settling > 0.0:
        return np.asarray(-np.expm1(-(time - time[0]) / settling))
    if memory > 0.0:
        rho = np.exp(-(time[1] - time[0]) / memory)
        warm = lfilter([1.0 - rho], [1.0, -rho], power)
        return np.asarray(warm / max(float(np.max(warm)), 1e-12))
    return shape

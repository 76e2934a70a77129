"""The compiled kernel: heat, phase, stress and boundary of any number of wires, step by step.

A step of length dt at held voltages, for every wire i of every side s:

    T_i     = T_eq + (T_i0 - T_eq) exp(-dt/tau) + lag (xi_i - xi_i0)      (lag: latent heat)
    sigma_i = E(xi_i) [eps_L (1 - xi_i) - e_s] + Theta_T (T_i - T_inf)
    xi_i    = the law (laws/, kinetics.py) at T_i, sigma_i
    sum sigma_i = load_s + K_s e_s +- F_s,   or e_s prescribed            (e: contraction)

Dry friction F_s opposes the motion; within +-F_s of balance the side stays where it was. Two sides
that pull on one slider give one equation: the front's sum of stresses minus the back's, with
e_back = -e_front.

A wire's temperature is monotone within the step, so reversals fall on samples. A wire whose ends
are moved reverses where T - sigma/C_A does, as computed for a purely elastic stretch.

Everything is stored in two plain arrays (columns.py): `wires` (w, WIRE_COLUMNS) and `sides` (s,
SIDE_COLUMNS); `i` is a wire, `side` a side. `run` allocates nothing, so no function counts
references, and the functions of the innermost loops are inlined: together this halves the time.

Wires and sides that an effect marks take a longer path through a step. The regime of a side (wires
taut, hanging or pushing; passive wires elastic or yielding) and of a wire (at its largest austenite
fraction so far or not) starts as in the last step and changes if the solution contradicts it."""

import math
from functools import reduce
from importlib import import_module

from sma_bench.compiled import borrowing, inlined
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.physics import columns as at
from sma_bench.physics import orientation
from sma_bench.physics.effects import slack
from sma_bench.physics.effects.ambient_drift import air_temperature
from sma_bench.physics.effects.latent_heat import latent_rise
from sma_bench.physics.effects.matrix_thermal_mass import combine_sinks, heat_with_silicone
from sma_bench.physics.effects.opposing_wires import give_way, resist, set_passive, yield_sign
from sma_bench.physics.effects.phase_dependent_resistance import resistance
from sma_bench.physics.effects.residual_strain import exceeds_most
from sma_bench.physics.effects.side_heat_coupling import in_plume, set_opposite
from sma_bench.physics.effects.supply_drop import current, power
from sma_bench.physics.effects.temperature_dependent_convection import loss
from sma_bench.physics.effects.temperature_lag import read
from sma_bench.physics.effects.temperature_underfill import spot_temperature
from sma_bench.physics.effects.transition_drift import drifts, shift_transition
from sma_bench.physics.effects.viscoelastic_matrix import relax, relaxing
from sma_bench.physics.kinetics import NORMAL, close_loops, fraction, reverse
from sma_bench.physics.laws.normal import push

NEWTON_STEP = 1e-10  # of xi and e; with 1e-7, slow convergence left an error of 2.5e-9 in xi
NEWTON_LIMIT = 15  # iterations
BISECTION_LIMIT = 200  # iterations
BRACKET = 1e-15  # width of xi or e at which bisection ends
REGIME_LIMIT = 12  # changes of regime within a step
LARGEST_STRAIN = 1e6  # step at which the search for a bracket ends
MOST_STIFFENED = 100.0  # e-folds of a spring's stiffness; no wire pulls so far
MOVED = 2.0  # value of PRESCRIBED for moved ends; 1: held ends
RECORDED = (at.TEMPERATURE, at.FRACTION, at.STRESS, at.READING, at.MOUNT, at.SAG)
TURN = 0.3  # K by which T - sigma/C_A turns back at a reversal; less may be an encoder's error


# --- Effects within a step; `added_strain` and `after_step` of every effect's file are found here.

def of_effects(place, both):
    """One function of those named `place` in all effects: compiled code cannot loop over a list."""
    modules = [import_module(f"sma_bench.physics.effects.{name}") for name in sorted(EFFECTS)]
    return reduce(both, [getattr(module, place) for module in modules if hasattr(module, place)])


added_strain = of_effects("added_strain", lambda first, second: inlined(
    lambda wires, i: first(wires, i) + second(wires, i)))
after_step = of_effects("after_step", lambda first, second: inlined(
    lambda wires, i, xi, step: (first(wires, i, xi, step), second(wires, i, xi, step))))


@borrowing
def heat_balance(wires, i, voltage, step):
    """Steady temperature [K] of wire i in constant surroundings; sets its decay and lag."""
    air = in_plume(wires, i, air_temperature(wires, i))
    heating = power(wires, i, voltage, resistance(wires, i), step)
    if wires[i, at.MATRIX_CAPACITY] > 0.0:
        combine_sinks(wires, i, wires[i, at.OPPOSITE_MATRIX], step)
        surface = wires[i, at.MATRIX_RISE] + wires[i, at.AMBIENT]
        return heat_with_silicone(wires, i, heating, loss(wires, i, surface - air), air, step)
    conductance = loss(wires, i, wires[i, at.TEMPERATURE] - air)
    combine_sinks(wires, i, wires[i, at.OPPOSITE], step)
    total = conductance + wires[i, at.BESIDE]
    exponent = -step * total / wires[i, at.CAPACITY]
    wires[i, at.DECAY] = math.exp(exponent)
    wires[i, at.LAG] = latent_rise(wires, i) * math.expm1(exponent) / exponent
    beside = wires[i, at.BESIDE] * wires[i, at.BESIDE_TEMPERATURE]
    return (heating + conductance * air + beside) / total


@borrowing
def prepare_side(wires, sides, side, step):
    """Set stiffness and load of a side for the coming step, in its last regime."""
    sides[side, at.MATRIX_STIFFNESS] = sides[side, at.OWN_STIFFNESS]
    sides[side, at.MATRIX_LOAD] = sides[side, at.OWN_LOAD]
    if sides[side, at.RELAXATION] + sides[side, at.SPREAD_RELAXATION] > 0.0:
        relaxing(sides, side, step)
        sides[side, at.MATRIX_STIFFNESS] += sides[side, at.RELAXING_STIFFNESS]
        sides[side, at.MATRIX_LOAD] += sides[side, at.RELAXING_LOAD]
    if sides[side, at.ENGAGEMENT] > 0.0:
        set_passive(wires, sides, side)
    set_regime(sides, side)


@borrowing
def set_regime(sides, side):
    """Set stiffness and load of the beam in this regime, and as its wires feel them."""
    stiffness, load = sides[side, at.MATRIX_STIFFNESS], sides[side, at.MATRIX_LOAD]
    if sides[side, at.ENGAGEMENT] > 0.0:
        passive_stiffness, passive_load = resist(sides, side)
        stiffness += passive_stiffness
        load -= passive_load
    sides[side, at.BEAM_STIFFNESS], sides[side, at.BEAM_LOAD] = stiffness, load
    if slack.hangs(sides, side):
        stiffness, load = 0.0, sides[side, at.SLIDES] * sides[side, at.RUBBING]
    elif sides[side, at.SLACK] + sides[side, at.SOFT_SLACK] > 0.0:
        slack.linearise_bending(sides, side)
        slope = sides[side, at.PULLED_SLOPE]
        load += stiffness * (sides[side, at.PULLED_TO] - slope * sides[side, at.PULLED_FROM])
        stiffness *= slope
    sides[side, at.STIFFNESS], sides[side, at.LOAD] = stiffness, load


@borrowing
def bending(sides, side):
    """Bending of a side's beam at its present contraction and regime."""
    if slack.hangs(sides, side):
        return slack.hanging_bending(sides, side)
    return slack.pulls(sides, side, sides[side, at.CONTRACTION])[0]


@borrowing
def change_regime(wires, sides, side):
    """After a solution: change the regime if the solution contradicts it; True if changed."""
    changed = False
    for i in range(wires.shape[0]):
        changed |= pull_sign(wires, sides, i, side) != 0.0 and exceeds_most(wires, i)
    if changed or sides[side, at.PRESCRIBED] > 0.0:
        return changed
    if sides[side, at.ENGAGEMENT] > 0.0:
        sign = yield_sign(sides, side, bending(sides, side))
        changed = sign != sides[side, at.YIELDING]
        sides[side, at.YIELDING] = sign
    if not changed and sides[side, at.SLACK] > 0.0:
        rubs = sides[side, at.RUBBING] > 0.0
        column = at.SLIDES if rubs else at.TAUT
        regime = slack.slide(sides, side) if rubs else slack.contact(sides, side)
        changed = regime != sides[side, column]
        sides[side, column] = regime
    changed = changed or slack.linearised_too_far(sides, side)
    if changed:
        set_regime(sides, side)
    return changed


@borrowing
def finish_side(sides, side, step):
    """After a step: update the bending of a side, and its relaxation and detwinning."""
    bent = bending(sides, side)
    if sides[side, at.SLIDES] != 0.0:
        sides[side, at.PLAY_TAKEN] = sides[side, at.CONTRACTION] - bent
    if sides[side, at.ENGAGEMENT] > 0.0:
        sides[side, at.PASSIVE_BENDING] = give_way(sides, side, bent)
        bent += sides[side, at.ENGAGEMENT] * sides[side, at.PASSIVE_BENDING]
    if sides[side, at.RELAXATION] + sides[side, at.SPREAD_RELAXATION] > 0.0:
        relax(sides, side, bent, step)
    sides[side, at.BENDING] = bent - sides[side, at.PASSIVE_BENDING]


@borrowing
def finish_wire(wires, sides, i, fraction_before, step):
    """After a step: update the states that effects add to wire i, and its reading."""
    if wires[i, at.RETURN_POINT] != 0.0:
        close_loops(wires, i)
    if wires[i, at.LAW] >= orientation.FIRST:
        orientation.after_step(wires, i)
    after_step(wires, i, fraction_before, step)
    if wires[i, at.READ_OTHERWISE] > 0.0:
        wires[i, at.READING] = read(wires, i, see(wires, sides, i), step)
    else:
        wires[i, at.READING] = wires[i, at.TEMPERATURE]


@borrowing
def currents(wires, voltage, temperature, fraction, sag, found):
    """Write the currents (n, w) of wires with these states (n, w) at these voltages (n, w)."""
    for k in range(voltage.shape[0]):
        for i in range(wires.shape[0]):
            wires[i, at.TEMPERATURE], wires[i, at.FRACTION] = temperature[k, i], fraction[k, i]
            wires[i, at.SAG] = sag[k, i]
            found[k, i] = current(wires, i, voltage[k, i], resistance(wires, i))


@borrowing
def see(wires, sides, i):
    """Temperature [K] of an infrared spot on wire i, including its background."""
    bent = sides[0, at.BENDING]
    if sides.shape[0] > 1 and sides[0, at.COUPLED] == 0.0:
        bent -= sides[1, at.BENDING]
    background = air_temperature(wires, i)
    if wires[i, at.MATRIX_CAPACITY] > 0.0:
        background = wires[i, at.MATRIX_RISE] + wires[i, at.AMBIENT]
    return spot_temperature(wires, i, background, bent)


# --- The step that all wires and sides share.

@inlined
def constitutive(wires, i, contraction, xi):
    """T, sigma (eq. 6), E and elastic strain at the end of the step, given xi and e."""
    temperature = wires[i, at.START] + wires[i, at.LAG] * xi
    modulus = wires[i, at.AUSTENITE_MODULUS] + xi * wires[i, at.MODULUS_CHANGE]
    stretch = wires[i, at.RECOVERABLE_STRAIN] * (1.0 - xi) + wires[i, at.OFFSET] - contraction
    stress = modulus * stretch + wires[i, at.EXPANSION] * (temperature - wires[i, at.AMBIENT])
    return temperature, stress, modulus, stretch


@inlined
def residual(wires, i, contraction, xi):
    """xi minus the law's fraction, its slopes in xi and e; sigma, its slope in xi; and E."""
    temperature, stress, modulus, stretch = constitutive(wires, i, contraction, xi)
    stress_slope = wires[i, at.MODULUS_CHANGE] * stretch - wires[i, at.RECOVERABLE_STRAIN] * modulus
    stress_slope += wires[i, at.EXPANSION] * wires[i, at.LAG]
    target, by_temperature, by_stress = fraction(wires, i, temperature, stress)
    slope = 1.0 - by_temperature * wires[i, at.LAG] - by_stress * stress_slope
    return xi - target, slope, by_stress * modulus, stress, stress_slope, modulus


@inlined
def solve_wire(wires, i, contraction):
    """xi at a given contraction, starting at GUESS: Newton within a shrinking bracket."""
    xi = wires[i, at.GUESS]
    low, high = -1.0, 2.0  # wider than 0 to 1, so that a step onto a limit lies inside
    for iteration in range(BISECTION_LIMIT):
        error, slope = residual(wires, i, contraction, xi)[:2]
        step = error / slope if slope > 0.0 else 2.0
        if abs(step) < NEWTON_STEP:
            return min(max(xi - step, 0.0), 1.0)
        if error > 0.0:
            high = xi
        else:
            low = xi
        xi -= step
        if iteration > NEWTON_LIMIT or not low < xi < high:
            xi = 0.5 * (low + high)
            if high - low < BRACKET:
                break
    return min(max(xi, 0.0), 1.0)


@inlined
def pull_sign(wires, sides, i, side):
    """1 for a wire of the side, 0 for others, -1 for those that pull the same slider back."""
    return 1.0 if wires[i, at.SIDE] == side else -sides[side, at.COUPLED]


@inlined
def resisted(sides, side, contraction):
    """Sum of stresses that balances a side's load at a contraction, and its slope."""
    load, stiffness = sides[side, at.LOAD], sides[side, at.STIFFNESS]
    if sides[side, at.STIFFENING] == 0.0:
        return load + stiffness * contraction, stiffness
    grown = min(sides[side, at.STIFFENING] * contraction, MOST_STIFFENED)
    load += stiffness * math.expm1(grown) / sides[side, at.STIFFENING]
    return load, stiffness * math.exp(grown)


@borrowing
def solve_jointly(wires, sides, side, contraction):
    """Newton on the fractions and the contraction of a side: (True if converged, contraction)."""
    for _ in range(NEWTON_LIMIT):
        taken, stiffness = resisted(sides, side, contraction)
        imbalance = -taken
        for i in range(wires.shape[0]):
            sign = pull_sign(wires, sides, i, side)
            if sign == 0.0:
                continue
            found = residual(wires, i, sign * contraction, wires[i, at.GUESS])
            error, slope, coupling, stress, stress_slope, modulus = found
            if slope <= 0.0:
                return False, contraction
            wires[i, at.STEP], wires[i, at.COUPLING] = error / slope, coupling / slope
            imbalance += sign * (stress - stress_slope * wires[i, at.STEP])
            stiffness += modulus + stress_slope * wires[i, at.COUPLING]
        if stiffness <= 0.0:
            return False, contraction
        change = imbalance / stiffness
        contraction += change
        largest = abs(change)
        for i in range(wires.shape[0]):
            sign = pull_sign(wires, sides, i, side)
            if sign == 0.0:
                continue
            step = wires[i, at.STEP] + wires[i, at.COUPLING] * sign * change
            wires[i, at.GUESS] = min(max(wires[i, at.GUESS] - step, 0.0), 1.0)
            largest = max(largest, abs(step))
        if largest < NEWTON_STEP:
            return True, contraction
    return False, contraction


@borrowing
def side_imbalance(wires, sides, side, contraction):
    """Sum of stresses minus the load, with fractions solved; decreases with contraction."""
    imbalance = -resisted(sides, side, contraction)[0]
    for i in range(wires.shape[0]):
        sign = pull_sign(wires, sides, i, side)
        if sign != 0.0:
            wires[i, at.GUESS] = solve_wire(wires, i, sign * contraction)
            imbalance += sign * constitutive(wires, i, sign * contraction, wires[i, at.GUESS])[1]
    return imbalance


@borrowing
def solve_nested(wires, sides, side, contraction):
    """Bisection on the contraction, solving fractions in each step: slow, safe, seldom needed."""
    low, high, reach = contraction, contraction, 1e-3
    while side_imbalance(wires, sides, side, low) < 0.0 and reach < LARGEST_STRAIN:
        low -= reach
        reach *= 2.0
    while side_imbalance(wires, sides, side, high) > 0.0 and reach < LARGEST_STRAIN:
        high += reach
        reach *= 2.0
    for _ in range(BISECTION_LIMIT):
        contraction = 0.5 * (low + high)
        if side_imbalance(wires, sides, side, contraction) > 0.0:
            low = contraction
        else:
            high = contraction
        if high - low < BRACKET:
            break
    return contraction


@borrowing
def reverse_by_drive(wires, i, excess):
    """Reverse a wire with moved ends once T - sigma/C_A of an elastic stretch has turned back."""
    modulus = wires[i, at.AUSTENITE_MODULUS] + wires[i, at.FRACTION] * wires[i, at.MODULUS_CHANGE]
    falls = excess * (1.0 - wires[i, at.DECAY])
    falls += modulus * wires[i, at.STRETCHED] * wires[i, at.AUSTENITE_SHIFT]
    wires[i, at.RETREAT] = max(wires[i, at.RETREAT] + falls * wires[i, at.TREND], 0.0)
    if wires[i, at.RETREAT] > TURN:
        wires[i, at.RETREAT] = 0.0
        reverse(wires, i, -wires[i, at.TREND])


@inlined
def heat(wires, voltage, k, step):
    """The part of the temperatures at the end of the step that is independent of xi; reversals."""
    for i in range(wires.shape[0]):
        if wires[i, at.HEATED_OTHERWISE] > 0.0:
            steady = heat_balance(wires, i, voltage[k, i], step)
        else:
            steady = wires[i, at.AMBIENT] + wires[i, at.HEATING] * voltage[k, i] * voltage[k, i]
        excess = wires[i, at.TEMPERATURE] - steady
        if wires[i, at.STRETCHED] != 0.0:
            reverse_by_drive(wires, i, excess)
        elif excess * wires[i, at.TREND] > 0.0:
            reverse(wires, i, -wires[i, at.TREND])
        wires[i, at.START] = steady + excess * wires[i, at.DECAY]
        wires[i, at.START] -= wires[i, at.LAG] * wires[i, at.FRACTION]
        if wires[i, at.EVOLVES] > 0.0:
            wires[i, at.OFFSET] = wires[i, at.PRESTRETCH] + added_strain(wires, i)
            if wires[i, at.LAW] >= orientation.FIRST:
                wires[i, at.OFFSET] += orientation.orient(wires, i)
            if wires[i, at.R_STRAIN] != 0.0:
                wires[i, at.OFFSET] -= orientation.r_phase_strain(wires, i)


@borrowing
def solve_side(wires, sides, side, start):
    """Solve fractions and contraction of a side at the end of the step; returns the change of the
    contraction. `start`: contraction at the start of the step, where friction may hold it."""
    before = sides[side, at.CONTRACTION]
    if sides[side, at.PRESCRIBED] > 0.0:
        for i in range(wires.shape[0]):
            if wires[i, at.SIDE] == side:
                wires[i, at.GUESS] = solve_wire(wires, i, before)
        return 0.0
    expected, load = before + sides[side, at.CONTRACTION_CHANGE], sides[side, at.LOAD]
    if sides[side, at.FRICTION] > 0.0:
        expected = start
        excess = side_imbalance(wires, sides, side, start)
        if abs(excess) <= sides[side, at.FRICTION]:
            sides[side, at.CONTRACTION] = start
            return start - before
        sides[side, at.LOAD] += math.copysign(sides[side, at.FRICTION], excess)
    converged, after = solve_jointly(wires, sides, side, expected)
    if not converged:
        for i in range(wires.shape[0]):
            if pull_sign(wires, sides, i, side) != 0.0:
                wires[i, at.GUESS] = wires[i, at.FRACTION]
        after = solve_nested(wires, sides, side, before)
    sides[side, at.CONTRACTION], sides[side, at.LOAD] = after, load
    return after - before


@inlined
def solve(wires, sides):
    """Solve the fractions and contractions of all sides at the end of the step."""
    for i in range(wires.shape[0]):
        wires[i, at.GUESS] = min(max(wires[i, at.FRACTION] + wires[i, at.CHANGE], 0.0), 1.0)
    for side in range(sides.shape[0]):
        if side > 0 and sides[0, at.COUPLED] > 0.0:
            sides[side, at.CONTRACTION] = -sides[0, at.CONTRACTION]
            break
        start = sides[side, at.CONTRACTION]
        change = solve_side(wires, sides, side, start)
        if sides[side, at.PULLS_OTHERWISE] > 0.0:
            for _ in range(REGIME_LIMIT):
                if not change_regime(wires, sides, side):
                    break
                change += solve_side(wires, sides, side, start)
        sides[side, at.CONTRACTION_CHANGE] = change


@inlined
def settle(wires, sides, step):
    """Write the solved step into the state of the wires and sides."""
    for side in range(sides.shape[0]):
        if sides[side, at.PULLS_OTHERWISE] > 0.0:
            finish_side(sides, side, step)
        else:
            sides[side, at.BENDING] = sides[side, at.CONTRACTION]
    for i in range(wires.shape[0]):
        xi, contraction = wires[i, at.GUESS], sides[int(wires[i, at.SIDE]), at.CONTRACTION]
        temperature, stress, _, _ = constitutive(wires, i, contraction, xi)
        wires[i, at.TEMPERATURE], wires[i, at.STRESS] = temperature, stress
        wires[i, at.STEP] = wires[i, at.FRACTION]  # the fraction before the step
        wires[i, at.CHANGE], wires[i, at.FRACTION] = xi - wires[i, at.FRACTION], xi
        wires[i, at.CLOCK] += step
        if wires[i, at.LAW] == NORMAL:
            push(wires, i)
        if wires[i, at.EVOLVES] == 0.0:
            wires[i, at.READING] = temperature
    for i in range(wires.shape[0]):  # a second loop: a reading depends on other wires too
        if wires[i, at.EVOLVES] > 0.0:
            finish_wire(wires, sides, i, wires[i, at.STEP], step)


@borrowing
def impose(wires, sides, strain, k):
    """Move the ends of the wires to their positions at sample k."""
    for i in range(wires.shape[0]):
        side = int(wires[i, at.SIDE])
        wires[i, at.STRETCHED] = sides[side, at.CONTRACTION] - strain[0, k, side]
    for side in range(sides.shape[0]):
        sides[side, at.CONTRACTION] = strain[0, k, side]


@borrowing
def run(time, voltage, wires, sides, history, strain):
    """Advance a bench over all samples of one drive, recording it at each. `time`: (n,) s;
    `voltage`: (n, w) V held from each sample to the next; `wires`, `sides`: rows of the bench,
    advanced in place, TREND 0 starts a new history. Written: `history` (6, n, w) of RECORDED and
    `strain` (2, n, s), contraction and bending; a MOVED contraction is read from `strain`."""
    effects = False
    for i in range(wires.shape[0]):
        effects = effects or wires[i, at.HEATED_OTHERWISE] > 0.0
        if wires[i, at.TREND] == 0.0:
            reverse(wires, i, 1.0)
        elif drifts(wires, i):
            shift_transition(wires, i)
    for side in range(sides.shape[0]):
        effects = effects or sides[side, at.PULLS_OTHERWISE] > 0.0
    last_step, moved = 0.0, sides[0, at.PRESCRIBED] == MOVED
    for k in range(time.shape[0]):
        if k > 0:
            step = time[k] - time[k - 1]
            if step != last_step:
                last_step = step
                for i in range(wires.shape[0]):
                    exponent = -step / wires[i, at.TIME_CONSTANT]
                    wires[i, at.DECAY] = math.exp(exponent)
                    wires[i, at.LAG] = wires[i, at.LATENT_RISE] * math.expm1(exponent) / exponent
            if effects:
                set_opposite(wires)
                for side in range(sides.shape[0]):
                    if sides[side, at.PULLS_OTHERWISE] > 0.0:
                        prepare_side(wires, sides, side, step)
            if moved:
                impose(wires, sides, strain, k)
            heat(wires, voltage, k - 1, step)
            solve(wires, sides)
            settle(wires, sides, step)
        for i in range(wires.shape[0]):
            for row, column in enumerate(RECORDED):
                history[row, k, i] = wires[i, column]
        for side in range(sides.shape[0]):
            strain[0, k, side] = sides[side, at.CONTRACTION]
            strain[1, k, side] = sides[side, at.BENDING]

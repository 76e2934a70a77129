# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""The compiled kernel: heat, phase, stress and boundary of any number of wires, step by step.

A step of length dt at held voltages, for every wire i of every side s:

    T_i     = T_eq + (T_i0 - T_eq) exp(-dt/tau) + lag (xi_i - xi_i0)      (lag: latent heat)
    sigma_i = E(xi_i) [eps_L (1 - xi_i) - e_s] + Theta_T (T_i - T_inf)
    xi_i    = the rule of material.py at T_i, sigma_i
    sum sigma_i = load_s + K_s e_s,   or e_s prescribed                   (e: contraction)

Two sides that pull on one slider are one equation: the sum of the front's stresses less that of the
back's, e_back = -e_front.

A wire's temperature is monotone within the step, so reversals fall on samples.

Everything lies in two plain arrays (columns.py) that all functions share: `wires` (w,
WIRE_COLUMNS), `sides` (s, SIDE_COLUMNS); `i` is a wire, `side` a side. Wires and sides that an
effect marks go through otherwise.py before and after the common solution.

`run` allocates nothing, so no function here counts references, and those of the innermost loops
are compiled into it: together that halves its time.
"""

import math

from sma_bench.compiled import borrowing, inlined
from sma_bench.physics.columns import (
    AMBIENT,
    AUSTENITE_MODULUS,
    BENDING,
    CHANGE,
    CLOCK,
    CONTRACTION,
    CONTRACTION_CHANGE,
    COUPLED,
    COUPLING,
    DECAY,
    EVOLVES,
    EXPANSION,
    FINAL_SHIFT,
    FRACTION,
    GUESS,
    HEATED_OTHERWISE,
    HEATING,
    LAG,
    LATENT_RISE,
    LOAD,
    MODULUS_CHANGE,
    OFFSET,
    PRESCRIBED,
    PULLS_OTHERWISE,
    READING,
    RECOVERABLE_STRAIN,
    SIDE,
    START,
    STEP,
    STIFFNESS,
    STRESS,
    TEMPERATURE,
    TIME_CONSTANT,
    TREND,
)
from sma_bench.physics.effects.side_heat_coupling import look_across
from sma_bench.physics.effects.transition_drift import shift_transition
from sma_bench.physics.kinetics import fraction, reverse
from sma_bench.physics.otherwise import (
    change_regime,
    finish_side,
    finish_wire,
    heat_balance,
    prepare_side,
    set_strain,
)

NEWTON_STEP = 1e-10  # converges quadratically: the error left is of order 10 NEWTON_STEP^2
NEWTON_LIMIT = 15
BISECTION_LIMIT = 200
BRACKET = 1e-15
REGIME_LIMIT = 12
LARGEST_STRAIN = 1e6


@inlined
def constitutive(wires, i, contraction, xi):
    """T, sigma of eq. (6), E and sigma's elastic strain at the end of the step, given xi and e."""
    temperature = wires[i, START] + wires[i, LAG] * xi
    modulus = wires[i, AUSTENITE_MODULUS] + xi * wires[i, MODULUS_CHANGE]
    stretch = wires[i, RECOVERABLE_STRAIN] * (1.0 - xi) + wires[i, OFFSET] - contraction
    stress = modulus * stretch + wires[i, EXPANSION] * (temperature - wires[i, AMBIENT])
    return temperature, stress, modulus, stretch


@inlined
def residual(wires, i, contraction, xi):
    """How far xi is from the rule, its slopes in xi and e; sigma, its slope in xi; and E."""
    temperature, stress, modulus, stretch = constitutive(wires, i, contraction, xi)
    stress_slope = wires[i, MODULUS_CHANGE] * stretch - wires[i, RECOVERABLE_STRAIN] * modulus
    stress_slope += wires[i, EXPANSION] * wires[i, LAG]
    target, by_temperature, by_stress = fraction(wires, i, temperature, stress)
    slope = 1.0 - by_temperature * wires[i, LAG] - by_stress * stress_slope
    return xi - target, slope, by_stress * modulus, stress, stress_slope, modulus


@inlined
def solve_wire(wires, i, contraction):
    """xi at a given contraction, from its guess: Newton within a shrinking bracket."""
    xi = wires[i, GUESS]
    low, high = -1.0, 2.0  # beyond 0 and 1, so that a step onto these lies inside
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
    if wires[i, SIDE] == side:
        return 1.0
    return -sides[side, COUPLED]


@borrowing
def solve_jointly(wires, sides, side, contraction):
    """Newton on the fractions and the contraction of a side together; whether it converged."""
    for _ in range(NEWTON_LIMIT):
        imbalance = -sides[side, LOAD] - sides[side, STIFFNESS] * contraction
        stiffness = sides[side, STIFFNESS]
        for i in range(wires.shape[0]):
            sign = pull_sign(wires, sides, i, side)
            if sign == 0.0:
                continue
            error, slope, coupling, stress, stress_slope, modulus = residual(
                wires, i, sign * contraction, wires[i, GUESS]
            )
            if slope <= 0.0:
                return False, contraction
            wires[i, STEP], wires[i, COUPLING] = error / slope, coupling / slope
            imbalance += sign * (stress - stress_slope * wires[i, STEP])
            stiffness += modulus + stress_slope * wires[i, COUPLING]
        if stiffness <= 0.0:
            return False, contraction
        change = imbalance / stiffness
        contraction += change
        largest = abs(change)
        for i in range(wires.shape[0]):
            sign = pull_sign(wires, sides, i, side)
            if sign == 0.0:
                continue
            step = wires[i, STEP] + wires[i, COUPLING] * sign * change
            wires[i, GUESS] = min(max(wires[i, GUESS] - step, 0.0), 1.0)
            largest = max(largest, abs(step))
        if largest < NEWTON_STEP:
            return True, contraction
    return False, contraction


@borrowing
def side_imbalance(wires, sides, side, contraction):
    """Sum of stresses beyond what the boundary takes, fractions solved; and minus its slope."""
    imbalance = -sides[side, LOAD] - sides[side, STIFFNESS] * contraction
    total = sides[side, STIFFNESS]
    for i in range(wires.shape[0]):
        sign = pull_sign(wires, sides, i, side)
        if sign == 0.0:
            continue
        wires[i, GUESS] = solve_wire(wires, i, sign * contraction)
        _, slope, coupling, stress, stress_slope, modulus = residual(
            wires, i, sign * contraction, wires[i, GUESS]
        )
        imbalance += sign * stress
        total += modulus
        if slope > 0.0:
            total += stress_slope * coupling / slope
    return imbalance, total


@borrowing
def solve_nested(wires, sides, side, contraction):
    """Bracketed Newton on the contraction, the fractions solved within: slow and sure."""
    imbalance, total = side_imbalance(wires, sides, side, contraction)
    low, high, reach = contraction, contraction, 1e-3
    outward = 1.0 if imbalance > 0.0 else -1.0
    while imbalance * outward > 0.0 and reach < LARGEST_STRAIN:
        contraction += outward * reach
        reach *= 2.0
        imbalance, total = side_imbalance(wires, sides, side, contraction)
        low, high = min(low, contraction), max(high, contraction)
    for iteration in range(BISECTION_LIMIT):
        if imbalance > 0.0:
            low = contraction
        else:
            high = contraction
        step = imbalance / total if total > 0.0 else LARGEST_STRAIN
        contraction += step
        if abs(step) < BRACKET:
            break
        if iteration > NEWTON_LIMIT or not low < contraction < high:
            contraction = 0.5 * (low + high)
            if high - low < BRACKET:
                break
        imbalance, total = side_imbalance(wires, sides, side, contraction)
    side_imbalance(wires, sides, side, contraction)
    return contraction


@inlined
def set_step(wires, step):
    """Constants of a step of this length [s]."""
    for i in range(wires.shape[0]):
        exponent = -step / wires[i, TIME_CONSTANT]
        wires[i, DECAY] = math.exp(exponent)
        wires[i, LAG] = wires[i, LATENT_RISE] * math.expm1(exponent) / exponent


@inlined
def heat(wires, voltage, k, step):
    """Temperatures at the end of the step, as far as they do not depend on xi; reversals."""
    for i in range(wires.shape[0]):
        if wires[i, HEATED_OTHERWISE] > 0.0:
            steady = heat_balance(wires, i, voltage[k, i], step)
        else:
            steady = wires[i, AMBIENT] + wires[i, HEATING] * voltage[k, i] * voltage[k, i]
        excess = wires[i, TEMPERATURE] - steady
        if excess * wires[i, TREND] > 0.0:
            reverse(wires, i, -wires[i, TREND])
        wires[i, START] = steady + excess * wires[i, DECAY] - wires[i, LAG] * wires[i, FRACTION]
        if wires[i, EVOLVES] > 0.0:
            set_strain(wires, i)


@borrowing
def solve_side(wires, sides, side):
    """Fractions and contraction of a side at the end of the step; how far it contracted."""
    before = sides[side, CONTRACTION]
    if sides[side, PRESCRIBED] > 0.0:
        for i in range(wires.shape[0]):
            if wires[i, SIDE] == side:
                wires[i, GUESS] = solve_wire(wires, i, before)
        return 0.0
    guess = before + sides[side, CONTRACTION_CHANGE]
    converged, after = solve_jointly(wires, sides, side, guess)
    if not converged:
        for i in range(wires.shape[0]):
            if pull_sign(wires, sides, i, side) != 0.0:
                wires[i, GUESS] = wires[i, FRACTION]
        after = solve_nested(wires, sides, side, before)
    sides[side, CONTRACTION] = after
    return after - before


@inlined
def solve(wires, sides):
    """Fractions, stresses and contractions of all sides at the end of the step."""
    for i in range(wires.shape[0]):
        guess = wires[i, FRACTION] + wires[i, CHANGE]
        wires[i, GUESS] = min(max(guess, 0.0), 1.0)
    for side in range(sides.shape[0]):
        if side > 0 and sides[0, COUPLED] > 0.0:
            sides[side, CONTRACTION] = -sides[0, CONTRACTION]
            break
        change = solve_side(wires, sides, side)
        if sides[side, PULLS_OTHERWISE] > 0.0:
            for _ in range(REGIME_LIMIT):
                if not change_regime(wires, sides, side):
                    break
                change += solve_side(wires, sides, side)
        sides[side, CONTRACTION_CHANGE] = change


@inlined
def settle(wires, sides, step):
    """Write the solved step into the state of the wires and sides."""
    for side in range(sides.shape[0]):
        if sides[side, PULLS_OTHERWISE] > 0.0:
            finish_side(sides, side)
        else:
            sides[side, BENDING] = sides[side, CONTRACTION]
    for i in range(wires.shape[0]):
        xi, contraction = wires[i, GUESS], sides[int(wires[i, SIDE]), CONTRACTION]
        temperature, stress, _, _ = constitutive(wires, i, contraction, xi)
        before = wires[i, FRACTION]
        wires[i, TEMPERATURE], wires[i, STRESS] = temperature, stress
        wires[i, CHANGE] = xi - before
        wires[i, FRACTION] = xi
        wires[i, CLOCK] += step
        if wires[i, EVOLVES] > 0.0:
            finish_wire(wires, i, before, step)
        else:
            wires[i, READING] = temperature


@inlined
def prepare(wires, sides, step):
    """What effects change before a step."""
    look_across(wires)
    for side in range(sides.shape[0]):
        if sides[side, PULLS_OTHERWISE] > 0.0:
            prepare_side(wires, sides, side, step)


@borrowing
def any_effect(wires, sides):
    """Whether any wire or side is to be prepared before a step."""
    for i in range(wires.shape[0]):
        if wires[i, HEATED_OTHERWISE] > 0.0:
            return True
    for side in range(sides.shape[0]):  # noqa: SIM110 (numba compiles no generators)
        if sides[side, PULLS_OTHERWISE] > 0.0:
            return True
    return False


@borrowing
def run(time, voltage, wires, sides, history, strain):
    """Advance wires and sides over all samples, recording them at each.

    Args:
        time: (n,) s; voltage: (n, w) V held from each sample to the next.
        wires, sides: advanced in place; a TREND of 0 starts a history.
        history: (4, n, w) temperature, fraction, stress, reading; strain: (2, n, s) contraction,
            and the part that bends; written.
    """
    for i in range(wires.shape[0]):
        if wires[i, TREND] == 0.0:
            reverse(wires, i, 1.0)
        elif wires[i, FINAL_SHIFT] != 0.0:
            shift_transition(wires, i)
    effects = any_effect(wires, sides)
    last_step = 0.0
    for k in range(time.shape[0]):
        if k > 0:
            step = time[k] - time[k - 1]
            if step != last_step:
                last_step = step
                set_step(wires, step)
            if effects:
                prepare(wires, sides, step)
            heat(wires, voltage, k - 1, step)
            solve(wires, sides)
            settle(wires, sides, step)
        for i in range(wires.shape[0]):
            history[0, k, i] = wires[i, TEMPERATURE]
            history[1, k, i] = wires[i, FRACTION]
            history[2, k, i] = wires[i, STRESS]
            history[3, k, i] = wires[i, READING]
        for side in range(sides.shape[0]):
            strain[0, k, side] = sides[side, CONTRACTION]
            strain[1, k, side] = sides[side, BENDING]


@borrowing
def run_many(time, voltage, wires, sides, history, strain):
    """`run` of p benches on one drive, each array but the drive with the benches first."""
    for bench in range(wires.shape[0]):
        run(time, voltage, wires[bench], sides[bench], history[bench], strain[bench])

# mypy: disallow-untyped-defs=False, disallow-incomplete-defs=False
"""The compiled kernel: heat, phase, stress and boundary of any number of wires, step by step.

Importing this module imports numba; `simulate` does so at its first call. Everything that is
compiled stays in this one file: numba's cache notices changes of a function's own file only.

A step of length dt at held voltages, for every wire i of every side s:

    T_i     = T_eq + (T_i0 - T_eq) exp(-dt/tau) + lag (xi_i - xi_i0)      (lag: latent heat)
    sigma_i = E(xi_i) [eps_L (1 - xi_i) - e_s] + Theta_T (T_i - T_inf)
    xi_i    = the rule of phase.py at T_i, sigma_i
    sum sigma_i = load_s + K_s e_s,   or e_s prescribed                   (e: contraction)

A wire's temperature is monotone within the step, so reversals fall on samples.

Everything lies in two plain arrays, one row a wire and one row a side, which all functions share:
`wires` (w, WIRE_COLUMNS), `sides` (s, SIDE_COLUMNS); `i` is a wire, `side` a side. Plain arrays
because calls with many arguments cost more than the physics, and because numba's cache on disk
would hold on to classes of an older version.
"""

import math

from sma_bench.physics.compiled import compiled

# Columns of a wire: what it is (SI; reciprocals spare the kernel divisions),
AMBIENT, HEATING, TIME_CONSTANT, LATENT_RISE = 0, 1, 2, 3  # K, K/V2, s, K
AUSTENITE_FINISH, AUSTENITE_SLOPE, AUSTENITE_SHIFT = 4, 5, 6  # A_f, 1/(A_f - A_s), 1/C_A
MARTENSITE_FINISH, MARTENSITE_SLOPE, MARTENSITE_SHIFT = 7, 8, 9  # M_f, 1/(M_s - M_f), 1/C_M
AUSTENITE_MODULUS, MODULUS_CHANGE, RECOVERABLE_STRAIN, EXPANSION, SIDE = 10, 11, 12, 13, 14
# its state,
WIRE_STATE = 15
TEMPERATURE, FRACTION, STRESS, TREND, CHANGE = 15, 16, 17, 18, 19
PHASE_REVERSED, OWN_REVERSED, OTHER_REVERSED, OTHER_POSITION_REVERSED = 20, 21, 22, 23
# and scratch of a step, temperature = START + LAG xi.
DECAY, LAG, START, GUESS, STEP, COUPLING = 24, 25, 26, 27, 28, 29
WIRE_COLUMNS = 30

# Columns of a side: sum of stresses = LOAD + STIFFNESS e, or e stays if PRESCRIBED; its state.
PRESCRIBED, STIFFNESS, LOAD = 0, 1, 2
SIDE_STATE = 3
CONTRACTION, CONTRACTION_CHANGE = 3, 4
SIDE_COLUMNS = 5

NEWTON_STEP = 1e-10  # converges quadratically: the error left is of order 10 NEWTON_STEP^2
NEWTON_LIMIT = 15
BISECTION_LIMIT = 200
BRACKET = 1e-15
LARGEST_STRAIN = 1e6


@compiled
def ramp(position):
    """sin^2 ramp from 0 to 1 over positions 0 to 1, and its slope."""
    if position <= 0.0:
        return 0.0, 0.0
    if position >= 1.0:
        return 1.0, 0.0
    root = math.sin(0.5 * math.pi * position)
    return root * root, math.pi * root * math.sqrt(1.0 - root * root)


@compiled
def positions(wires, i, temperature, stress):
    """Where T, sigma lie on the ramps f and g."""
    of_f = wires[i, AUSTENITE_FINISH] - temperature + stress * wires[i, AUSTENITE_SHIFT]
    of_g = temperature - stress * wires[i, MARTENSITE_SHIFT] - wires[i, MARTENSITE_FINISH]
    return of_f * wires[i, AUSTENITE_SLOPE], of_g * wires[i, MARTENSITE_SLOPE]


@compiled
def phase_left(wires, i, own, other):
    """What is left of the vanishing phase (phase.py), its slopes along own and other position."""
    phase, own_reversed = wires[i, PHASE_REVERSED], wires[i, OWN_REVERSED]
    other_reversed = wires[i, OTHER_REVERSED]
    share, share_slope = ramp(own)
    left, by_own, by_other = 0.0, 0.0, 0.0
    if own_reversed > 0.0:
        scale = phase / own_reversed
        left, by_own = share * scale, share_slope * scale
    elif phase > 0.0 and other_reversed < 1.0:
        scale = phase / (1.0 - other_reversed)
        rest, rest_slope = ramp(other)
        left, by_other = (1.0 - rest) * scale, -rest_slope * scale
    # The other ramp's sine is spared unless stress has moved that ramp back.
    if other < wires[i, OTHER_POSITION_REVERSED] and other_reversed > 0.0 and share > left:
        rest, rest_slope = ramp(other)
        bound = 1.0 - rest / other_reversed
        if bound >= share:
            left, by_own, by_other = share, share_slope, 0.0
        elif bound > left:
            left, by_own, by_other = bound, 0.0, -rest_slope / other_reversed
    if left > 1.0:
        return 1.0, 0.0, 0.0
    return left, by_own, by_other


@compiled
def fraction(wires, i, temperature, stress):
    """xi of wire i by the rule of phase.py, d xi/dT and d xi/d sigma."""
    of_f, of_g = positions(wires, i, temperature, stress)
    if wires[i, TREND] > 0.0:
        xi, by_f, by_g = phase_left(wires, i, of_f, of_g)
    else:
        left, by_g, by_f = phase_left(wires, i, of_g, of_f)
        xi, by_f, by_g = 1.0 - left, -by_f, -by_g
    by_f *= wires[i, AUSTENITE_SLOPE]
    by_g *= wires[i, MARTENSITE_SLOPE]
    return xi, by_g - by_f, by_f * wires[i, AUSTENITE_SHIFT] - by_g * wires[i, MARTENSITE_SHIFT]


@compiled
def reverse(wires, i, trend):
    """Make the present state of wire i the state of the last reversal."""
    of_f, of_g = positions(wires, i, wires[i, TEMPERATURE], wires[i, STRESS])
    f, g = ramp(of_f)[0], ramp(of_g)[0]
    rising = trend > 0.0
    wires[i, TREND] = trend
    wires[i, CHANGE] = 0.0
    wires[i, PHASE_REVERSED] = wires[i, FRACTION] if rising else 1.0 - wires[i, FRACTION]
    wires[i, OWN_REVERSED] = f if rising else g
    wires[i, OTHER_REVERSED] = g if rising else f
    wires[i, OTHER_POSITION_REVERSED] = of_g if rising else of_f


@compiled
def constitutive(wires, i, contraction, xi):
    """T, sigma of eq. (6), E and sigma's elastic strain at the end of the step, given xi and e."""
    temperature = wires[i, START] + wires[i, LAG] * xi
    modulus = wires[i, AUSTENITE_MODULUS] + xi * wires[i, MODULUS_CHANGE]
    stretch = wires[i, RECOVERABLE_STRAIN] * (1.0 - xi) - contraction
    stress = modulus * stretch + wires[i, EXPANSION] * (temperature - wires[i, AMBIENT])
    return temperature, stress, modulus, stretch


@compiled
def residual(wires, i, contraction, xi):
    """How far xi is from the rule, its slopes in xi and e; sigma, its slope in xi; and E."""
    temperature, stress, modulus, stretch = constitutive(wires, i, contraction, xi)
    stress_slope = wires[i, MODULUS_CHANGE] * stretch - wires[i, RECOVERABLE_STRAIN] * modulus
    stress_slope += wires[i, EXPANSION] * wires[i, LAG]
    target, by_temperature, by_stress = fraction(wires, i, temperature, stress)
    slope = 1.0 - by_temperature * wires[i, LAG] - by_stress * stress_slope
    return xi - target, slope, by_stress * modulus, stress, stress_slope, modulus


@compiled
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


@compiled
def solve_jointly(wires, sides, side, contraction):
    """Newton on the fractions and the contraction of a side together; whether it converged."""
    for _ in range(NEWTON_LIMIT):
        imbalance = -sides[side, LOAD] - sides[side, STIFFNESS] * contraction
        stiffness = sides[side, STIFFNESS]
        for i in range(wires.shape[0]):
            if wires[i, SIDE] != side:
                continue
            error, slope, coupling, stress, stress_slope, modulus = residual(
                wires, i, contraction, wires[i, GUESS]
            )
            if slope <= 0.0:
                return False, contraction
            wires[i, STEP], wires[i, COUPLING] = error / slope, coupling / slope
            imbalance += stress - stress_slope * wires[i, STEP]
            stiffness += modulus + stress_slope * wires[i, COUPLING]
        if stiffness <= 0.0:
            return False, contraction
        change = imbalance / stiffness
        contraction += change
        largest = abs(change)
        for i in range(wires.shape[0]):
            if wires[i, SIDE] != side:
                continue
            step = wires[i, STEP] + wires[i, COUPLING] * change
            wires[i, GUESS] = min(max(wires[i, GUESS] - step, 0.0), 1.0)
            largest = max(largest, abs(step))
        if largest < NEWTON_STEP:
            return True, contraction
    return False, contraction


@compiled
def side_imbalance(wires, sides, side, contraction):
    """Sum of stresses beyond what the boundary takes, fractions solved; and minus its slope."""
    imbalance = -sides[side, LOAD] - sides[side, STIFFNESS] * contraction
    total = sides[side, STIFFNESS]
    for i in range(wires.shape[0]):
        if wires[i, SIDE] != side:
            continue
        wires[i, GUESS] = solve_wire(wires, i, contraction)
        _, slope, coupling, stress, stress_slope, modulus = residual(
            wires, i, contraction, wires[i, GUESS]
        )
        imbalance += stress
        total += modulus
        if slope > 0.0:
            total += stress_slope * coupling / slope
    return imbalance, total


@compiled
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


@compiled
def set_step(wires, step):
    """Constants of a step of this length [s]."""
    for i in range(wires.shape[0]):
        exponent = -step / wires[i, TIME_CONSTANT]
        wires[i, DECAY] = math.exp(exponent)
        wires[i, LAG] = wires[i, LATENT_RISE] * math.expm1(exponent) / exponent


@compiled
def heat(wires, voltage, k):
    """Temperatures at the end of the step, as far as they do not depend on xi; reversals."""
    for i in range(wires.shape[0]):
        steady = wires[i, AMBIENT] + wires[i, HEATING] * voltage[k, i] * voltage[k, i]
        excess = wires[i, TEMPERATURE] - steady
        if excess * wires[i, TREND] > 0.0:
            reverse(wires, i, -wires[i, TREND])
        wires[i, START] = steady + excess * wires[i, DECAY] - wires[i, LAG] * wires[i, FRACTION]


@compiled
def solve(wires, sides):
    """Fractions, stresses and contractions at the end of the step, together."""
    for i in range(wires.shape[0]):
        guess = wires[i, FRACTION] + wires[i, CHANGE]
        wires[i, GUESS] = min(max(guess, 0.0), 1.0)
    for side in range(sides.shape[0]):
        before = sides[side, CONTRACTION]
        if sides[side, PRESCRIBED] > 0.0:
            for i in range(wires.shape[0]):
                if wires[i, SIDE] != side:
                    continue
                wires[i, GUESS] = solve_wire(wires, i, before)
            continue
        converged, after = solve_jointly(
            wires, sides, side, before + sides[side, CONTRACTION_CHANGE]
        )
        if not converged:
            for i in range(wires.shape[0]):
                if wires[i, SIDE] != side:
                    continue
                wires[i, GUESS] = wires[i, FRACTION]
            after = solve_nested(wires, sides, side, before)
        sides[side, CONTRACTION], sides[side, CONTRACTION_CHANGE] = after, after - before


@compiled
def settle(wires, sides):
    """Write the solved step into the state of the wires."""
    for i in range(wires.shape[0]):
        xi, contraction = wires[i, GUESS], sides[int(wires[i, SIDE]), CONTRACTION]
        temperature, stress, _, _ = constitutive(wires, i, contraction, xi)
        wires[i, TEMPERATURE], wires[i, STRESS] = temperature, stress
        wires[i, CHANGE] = xi - wires[i, FRACTION]
        wires[i, FRACTION] = xi


@compiled
def run(time, voltage, wires, sides, history, strain):
    """Advance wires and sides over all samples, recording them at each.

    Args:
        time: (n,) s; voltage: (n, w) V held from each sample to the next.
        wires, sides: advanced in place; a TREND of 0 starts a history.
        history: (3, n, w) temperature, fraction, stress; strain: (n, s) contraction; written.
    """
    for i in range(wires.shape[0]):
        if wires[i, TREND] == 0.0:
            reverse(wires, i, 1.0)
    last_step = 0.0
    for k in range(time.shape[0]):
        if k > 0:
            step = time[k] - time[k - 1]
            if step != last_step:
                last_step = step
                set_step(wires, step)
            heat(wires, voltage, k - 1)
            solve(wires, sides)
            settle(wires, sides)
        for i in range(wires.shape[0]):
            history[0, k, i] = wires[i, TEMPERATURE]
            history[1, k, i] = wires[i, FRACTION]
            history[2, k, i] = wires[i, STRESS]
        for side in range(sides.shape[0]):
            strain[k, side] = sides[side, CONTRACTION]

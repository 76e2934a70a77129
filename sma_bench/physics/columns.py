"""What the compiled core keeps of a bench: one row a wire, one row a side, plain numbers (SI).

Plain arrays because calls with many arguments cost more than the physics, and because numba's
cache on disk would hold on to classes of an older version.
"""

# --- a wire: what it is (reciprocals spare the core divisions)
AMBIENT, HEATING, TIME_CONSTANT, LATENT_RISE = range(4)  # K, K/V2, s, K
AUSTENITE_FINISH, AUSTENITE_SLOPE, AUSTENITE_SHIFT = range(4, 7)  # A_f, 1/(A_f - A_s), 1/C_A
MARTENSITE_FINISH, MARTENSITE_SLOPE, MARTENSITE_SHIFT = range(7, 10)  # M_f, 1/(M_s-M_f), 1/C_M
AUSTENITE_MODULUS, MODULUS_CHANGE, RECOVERABLE_STRAIN, EXPANSION, SIDE = range(10, 15)
# effects that change how it is heated: any at all, and their numbers,
HEATED_OTHERWISE, CAPACITY, LOSS, RESISTANCE = range(15, 19)  # m c_p, h A_c, R
AUSTENITE_RESISTANCE, RESISTANCE_SLOPE, SUPPLY_RESISTANCE = range(19, 22)
CONVECTION_RISE, MATRIX_CAPACITY, MATRIX_INNER_SHARE, ACROSS = range(22, 26)
AMBIENT_RATE, AMBIENT_BEND = range(26, 28)
# effects that change how it transforms and reads.
EVOLVES, MEMORY, FINAL_SHIFT, SHIFT_CYCLES, FINAL_PLASTIC, RESIDUAL_SHARE = range(28, 34)
FULL_STRAIN, AUSTENITE_FINISH_FRESH, MARTENSITE_FINISH_FRESH = range(34, 37)
READ_OTHERWISE, MISSING_SPOT, READING_LAG = range(37, 40)
AUSTENITE_SPREAD, MARTENSITE_SPREAD, TAIL = range(40, 43)  # of the ramps, which run from 0 to 1
RETURN_POINT = 43
# its state,
WIRE_STATE = 44
TEMPERATURE, FRACTION, STRESS, TREND, CHANGE = range(44, 49)
PHASE_REVERSED, OWN_REVERSED, OTHER_REVERSED, OTHER_POSITION_REVERSED = range(49, 53)
CLOCK, MATRIX_RISE, CYCLES, TURNED_CYCLES, MOST_AUSTENITE, READING, SEEN = range(53, 60)
# reversals that are remembered: how many, and xi, f, g of each,
TURNS, TURN_STATES, TURN_DEPTH = 60, 61, 6
# and scratch of a step, temperature = START + LAG xi, and likewise the silicone's rise; OFFSET is
# strain beyond the contract's.
DECAY, LAG, START, GUESS, STEP, COUPLING, OFFSET = range(79, 86)
OPPOSITE, OPPOSITE_MATRIX, MATRIX_START, MATRIX_LAG = range(86, 90)
WIRE_COLUMNS = 90

# --- a side: sum of stresses = LOAD + STIFFNESS e, or e stays if PRESCRIBED; effects on it,
PRESCRIBED, STIFFNESS, LOAD = range(3)
PULLS_OTHERWISE, SLACK, RELAXATION, RELAXATION_TIME, ENGAGEMENT, DETWINNING_STRESS = range(3, 9)
OWN_STIFFNESS, OWN_LOAD = range(9, 11)
# its state (BENDING is the contraction that bends the beam; TAUT: 1, 0 hanging, -1 pushing),
SIDE_STATE = 11
CONTRACTION, CONTRACTION_CHANGE, BENDING, RELAXED, DETWINNED, YIELDING, TAUT = range(11, 18)
PASSIVE_FRACTION, PASSIVE_BENDING = range(18, 20)
# and scratch of a step: the matrix and its relaxing part; the passive wires; all of them together.
MATRIX_STIFFNESS, MATRIX_LOAD, RELAXING_STIFFNESS, RELAXING_LOAD = range(20, 24)
PASSIVE_MODULUS, PASSIVE_LIMIT, PASSIVE_HARDENING, BEAM_STIFFNESS, BEAM_LOAD = range(24, 29)
SIDE_COLUMNS = 29

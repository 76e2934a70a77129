"""What the compiled core keeps of a bench: one row a wire, one row a side, plain numbers (SI).

Plain arrays because calls with many arguments cost more than the physics, and because numba's
cache on disk would hold on to classes of an older version.

Columns are numbered here, from the core's own lists and from what the effects declare of theirs:
first what a bench is, then its state, then what is noted within a step."""

from sma_bench.parameters.parameter import EFFECTS

PLAYS = 8  # at most, of laws/normal.py
_WIRE = {
    "constants": (  # reciprocals spare the core divisions
        "AMBIENT", "HEATING", "TIME_CONSTANT", "LATENT_RISE",  # K, K/V2, s, K
        "AUSTENITE_FINISH", "AUSTENITE_SLOPE", "AUSTENITE_SHIFT",  # A_f, 1/(A_f - A_s), 1/C_A
        "MARTENSITE_FINISH", "MARTENSITE_SLOPE", "MARTENSITE_SHIFT",  # M_f, 1/(M_s - M_f), 1/C_M
        "AUSTENITE_MODULUS", "MODULUS_CHANGE", "RECOVERABLE_STRAIN", "EXPANSION", "SIDE",
        "AUSTENITE_SPREAD", "MARTENSITE_SPREAD", "TAIL",  # of the ramps, which run from 0 to 1
        "LAW", "GROUPS", "SHARPNESS",  # its number; of laws/normal.py number, 1/s and of each play
        *["CENTRES"] * PLAYS, *["HALF_WIDTHS"] * PLAYS, *["SHARES"] * PLAYS, *["WARMTH"] * PLAYS,
        "SKEW",  # of the centres' distribution
        # of orientation.py: D by stress, the moduli and expansion that a step may change
        "ORIENTS_FROM", "ORIENTS_WITHIN", "MISMATCH", "AUSTENITE_STIFF", "MARTENSITE_STIFF",
        "EXPANDS", "R_STRAIN", "R_END", "R_RANGE",  # the R-phase: strain, K, K
        "CAPACITY", "LOSS", "RESISTANCE",  # m c_p, h A_c, R
        "CONVECTION", "CONVECTION_EXPONENT", "RADIATION",  # of free convection, W/K, 1, W/K4
        "SOURCE", "PRESTRETCH",  # 1 of current, 2 of power; strain at which it is mounted
        "HEATED_OTHERWISE", "EVOLVES", "READ_OTHERWISE",  # marks of effects
    ),
    "state": (
        "TEMPERATURE", "FRACTION", "STRESS", "TREND", "CHANGE", "PHASE_REVERSED", "OWN_REVERSED",
        "OTHER_REVERSED", "OTHER_POSITION_REVERSED", "CLOCK", "READING", "RETREAT",
        *["PLAY"] * PLAYS, "ORIENTED", "STRESS_BEFORE",
    ),
    # temperature = START + LAG xi; OFFSET is strain beyond the contract's
    "scratch": ("DECAY", "LAG", "START", "GUESS", "STEP", "COUPLING", "OFFSET", "STRETCHED",
                "FOLLOWS", "BEGUN", "DETWINS"),
}
_SIDE = {
    # sum of stresses, if COUPLED less the other side's, = LOAD + STIFFNESS e, or e is PRESCRIBED
    "constants": (
        "PRESCRIBED", "COUPLED", "STIFFNESS", "LOAD", "OWN_STIFFNESS", "OWN_LOAD",
        "PULLS_OTHERWISE", "FRICTION",  # of the sum of stresses, Pa, against the motion
        "STIFFENING",  # 0, or s of a spring: STIFFNESS (exp(s e) - 1)/s in place of STIFFNESS e
    ),
    "state": ("CONTRACTION", "CONTRACTION_CHANGE", "BENDING"),  # the last bends the beam
    # the matrix with its relaxing part; and with the passive wires
    "scratch": ("MATRIX_STIFFNESS", "MATRIX_LOAD", "BEAM_STIFFNESS", "BEAM_LOAD"),
}


def _numbered(row: str, own: dict[str, tuple[str, ...]]) -> tuple[dict[str, int], int, int]:
    """Column of every name (its first); where the state begins, and the number of columns."""
    effects = [EFFECTS[name] for name in sorted(EFFECTS) if EFFECTS[name].row == row]
    names: list[str] = []
    state = 0
    for part, of_core in own.items():
        if part == "state":
            state = len(names)
        names += of_core
        for effect in effects:
            if part == "constants":
                names += effect.columns.values()
            names += getattr(effect, part)
    return {name: names.index(name) for name in names}, state, len(names)


WIRE_NAMES, WIRE_STATE, WIRE_COLUMNS = _numbered("wire", _WIRE)
SIDE_NAMES, SIDE_STATE, SIDE_COLUMNS = _numbered("side", _SIDE)
globals().update(WIRE_NAMES, **SIDE_NAMES)


def __getattr__(name: str) -> int:
    """Names that are generated are known to type checkers by this."""
    raise AttributeError(f"no column {name}: neither the core nor an effect declares it")

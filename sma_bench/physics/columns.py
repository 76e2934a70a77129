"""Columns of the compiled core's arrays: one row per wire, one row per side, plain numbers (SI).

Plain arrays because calls with many arguments cost more than the physics, and because numba's
cache on disk would hold on to classes of an older version.

Columns are numbered here, from the core's own lists and those that the effects declare: first the
constants of a bench, then its state, then scratch values of one step."""

from sma_bench.parameters.parameter import EFFECTS

PLAYS = 8  # largest number of plays in laws/normal.py
_WIRE = {
    "constants": (  # reciprocals spare the core divisions
        "AMBIENT", "HEATING", "TIME_CONSTANT", "LATENT_RISE",  # K, K/V2, s, K
        "AUSTENITE_FINISH", "AUSTENITE_SLOPE", "AUSTENITE_SHIFT",  # A_f, 1/(A_f - A_s), 1/C_A
        "MARTENSITE_FINISH", "MARTENSITE_SLOPE", "MARTENSITE_SHIFT",  # M_f, 1/(M_s - M_f), 1/C_M
        "AUSTENITE_MODULUS", "MODULUS_CHANGE", "RECOVERABLE_STRAIN", "EXPANSION", "SIDE",
        "AUSTENITE_SPREAD", "MARTENSITE_SPREAD", "TAIL",  # widths relative to the ramps'; share
        "LAW", "GROUPS", "SHARPNESS",  # index in LAWS; normal.py: number of plays, 1/s
        *["CENTRES"] * PLAYS, *["HALF_WIDTHS"] * PLAYS, *["SHARES"] * PLAYS, *["WARMTH"] * PLAYS,
        "SKEW",  # of the distribution of the centres
        # of orientation.py: D by stress; moduli and expansion as given (steps change the others)
        "ORIENTS_FROM", "ORIENTS_WITHIN", "MISMATCH", "AUSTENITE_STIFF", "MARTENSITE_STIFF",
        "EXPANDS", "R_STRAIN", "R_END", "R_RANGE",  # the R-phase: strain, K, K
        "CAPACITY", "LOSS", "RESISTANCE",  # m c_p, h A_c, R
        "CONVECTION", "CONVECTION_EXPONENT", "RADIATION",  # of free convection, W/K, 1, W/K4
        "SOURCE", "PRESTRETCH",  # 1: current, 2: power; strain when mounted
        "HEATED_OTHERWISE", "EVOLVES", "READ_OTHERWISE",  # 1 where an effect does so
    ),
    "state": (
        "TEMPERATURE", "FRACTION", "STRESS", "TREND", "CHANGE", "PHASE_REVERSED", "OWN_REVERSED",
        "OTHER_REVERSED", "OTHER_POSITION_REVERSED", "CLOCK", "READING", "RETREAT",
        *["PLAY"] * PLAYS, "ORIENTED", "STRESS_BEFORE",
    ),
    # temperature = START + LAG xi; OFFSET: strain added to the contract's
    "scratch": ("DECAY", "LAG", "START", "GUESS", "STEP", "COUPLING", "OFFSET", "STRETCHED",
                "ORIENTED_SLOPE", "ORIENTED_START", "ORIENTED_BY_STRESS"),
}
_SIDE = {
    # sum of stresses (if COUPLED minus the other side's) = LOAD + STIFFNESS e, or e is PRESCRIBED
    "constants": (
        "PRESCRIBED", "COUPLED", "STIFFNESS", "LOAD", "OWN_STIFFNESS", "OWN_LOAD",
        "PULLS_OTHERWISE", "FRICTION",  # of the sum of stresses, Pa, against the motion
        "STIFFENING",  # 0, or s of a spring: STIFFNESS (exp(s e) - 1)/s in place of STIFFNESS e
    ),
    "state": ("CONTRACTION", "CONTRACTION_CHANGE", "BENDING"),  # BENDING bends the beam
    # MATRIX: matrix with its relaxing part; BEAM: this and the passive wires
    "scratch": ("MATRIX_STIFFNESS", "MATRIX_LOAD", "BEAM_STIFFNESS", "BEAM_LOAD"),
}


def _numbered(row: str, own: dict[str, tuple[str, ...]]) -> tuple[dict[str, int], int, int]:
    """First column of every name, the column where the state begins, and the number of columns."""
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
    """Raise for an unknown column; its type tells type checkers about the generated names."""
    raise AttributeError(f"no column {name}: neither the core nor an effect declares it")

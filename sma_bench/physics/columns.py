"""What the compiled core keeps of a bench: one row a wire, one row a side, plain numbers (SI).

Plain arrays because calls with many arguments cost more than the physics, and because numba's
cache on disk would hold on to classes of an older version.

Columns are numbered here, from the core's own lists and from what the effects declare of theirs:
first what a bench is, then its state, then what is noted within a step.
"""

from itertools import chain
from typing import Literal

from sma_bench.parameters.parameter import EFFECTS

_WIRE_CONSTANTS = (  # reciprocals spare the core divisions
    "AMBIENT", "HEATING", "TIME_CONSTANT", "LATENT_RISE",  # K, K/V2, s, K
    "AUSTENITE_FINISH", "AUSTENITE_SLOPE", "AUSTENITE_SHIFT",  # A_f, 1/(A_f - A_s), 1/C_A
    "MARTENSITE_FINISH", "MARTENSITE_SLOPE", "MARTENSITE_SHIFT",  # M_f, 1/(M_s - M_f), 1/C_M
    "AUSTENITE_MODULUS", "MODULUS_CHANGE", "RECOVERABLE_STRAIN", "EXPANSION", "SIDE",
    "AUSTENITE_SPREAD", "MARTENSITE_SPREAD", "TAIL",  # of the ramps, which run from 0 to 1
    "CAPACITY", "LOSS", "RESISTANCE",  # m c_p, h A_c, R
    "CURRENT_DRIVEN", "PRESTRETCH",  # by a current source; strain at which an antagonist is mounted
    "HEATED_OTHERWISE", "EVOLVES", "READ_OTHERWISE",  # marks of effects
)  # fmt: skip
_WIRE_STATE = (
    "TEMPERATURE", "FRACTION", "STRESS", "TREND", "CHANGE",
    "PHASE_REVERSED", "OWN_REVERSED", "OTHER_REVERSED", "OTHER_POSITION_REVERSED",
    "CLOCK", "READING",
)  # fmt: skip
_WIRE_SCRATCH = (  # temperature = START + LAG xi; OFFSET is strain beyond the contract's
    "DECAY", "LAG", "START", "GUESS", "STEP", "COUPLING", "OFFSET",
)  # fmt: skip

_SIDE_CONSTANTS = (
    # sum of stresses = LOAD + STIFFNESS e, or e stays if PRESCRIBED; if COUPLED, the sum less that
    # of the other side, which is stretched by e
    "PRESCRIBED", "COUPLED", "STIFFNESS", "LOAD", "OWN_STIFFNESS", "OWN_LOAD", "PULLS_OTHERWISE",
)  # fmt: skip
_SIDE_STATE = (  # BENDING is the contraction that bends the beam
    "CONTRACTION", "CONTRACTION_CHANGE", "BENDING",
)  # fmt: skip
_SIDE_SCRATCH = (  # the matrix with its relaxing part; and with the passive wires
    "MATRIX_STIFFNESS", "MATRIX_LOAD", "BEAM_STIFFNESS", "BEAM_LOAD",
)  # fmt: skip


def _declared(row: str, part: Literal["constants", "state", "scratch"]) -> list[str]:
    effects = [EFFECTS[name] for name in sorted(EFFECTS) if EFFECTS[name].row == row]
    numbers = [(effect.columns or {}).values() if part == "constants" else () for effect in effects]
    return list(chain(*numbers, *(getattr(effect, part) for effect in effects)))


def _numbered(*parts: list[str]) -> tuple[dict[str, int], list[int]]:
    """Column of every name, the first where it stands several times; where each part begins."""
    names = list(chain(*parts))
    starts = [sum(map(len, parts[:k])) for k in range(len(parts) + 1)]
    return {name: names.index(name) for name in names}, starts


WIRE_NAMES, (_, WIRE_STATE, _, WIRE_COLUMNS) = _numbered(
    [*_WIRE_CONSTANTS, *_declared("wire", "constants")],
    [*_WIRE_STATE, *_declared("wire", "state")], [*_WIRE_SCRATCH, *_declared("wire", "scratch")],
)
SIDE_NAMES, (_, SIDE_STATE, _, SIDE_COLUMNS) = _numbered(
    [*_SIDE_CONSTANTS, *_declared("side", "constants")],
    [*_SIDE_STATE, *_declared("side", "state")], [*_SIDE_SCRATCH, *_declared("side", "scratch")],
)
globals().update(WIRE_NAMES, **SIDE_NAMES)


def __getattr__(name: str) -> int:
    """Names that are generated are known to type checkers by this."""
    raise AttributeError(f"no column {name}: neither the core nor an effect declares it")

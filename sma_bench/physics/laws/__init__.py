"""Laws of the phase, `wire.law`: how the fraction follows temperature and stress, one law per file.

Each file has the equation and source in its docstring and, for the full branches,

    ramp(position) -> share, slope    compiled: share 0 at the end of a branch, 1 at its start,
                                      or nearly: what ramp(0) gives is left at A_f and M_f
    ENDS                              positions between which it goes from 0 to 1, or nearly

with position = (A_f - T + sigma/C_A)/(A_f - A_s) on heating, (T - M_f - sigma/C_M)/(M_s - M_f) on
cooling, and share that of the vanishing phase. All laws have the same four temperatures;
`wire.transition_spread` and `_tail` are for the cosine only. After a reversal inside the loop they
follow the contract's rule (kinetics.py), except laws with states of their own (`normal`).

Laws whose strain depends on the load (`ORIENTING`, orientation.py) also have

    orients(wires, i, stress) -> D, slope    compiled: the share of new martensite with a strain
    shifting(wires, i, stress)               stress in place of sigma, slope: heating, then cooling
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any


def law_of(parameters: Mapping[str, Any]) -> Any:
    """The module of the law that these parameters name."""
    return import_module(f"sma_bench.physics.laws.{parameters['wire.law']}")


def ramp_of(parameters: Mapping[str, Any]) -> Any:
    """`ramp` of the law that these parameters name, not compiled: for a few calls from Python."""
    ramp = law_of(parameters).ramp
    return getattr(ramp, "py_func", ramp)

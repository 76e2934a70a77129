"""Laws of the phase, `wire.law`: how the fraction follows temperature and stress, one law a file.

A file has its equation and source in the docstring, and of its full branches

    ramp(position) -> share, slope    compiled: 0 and 1 where heating or cooling ends and starts
    position(share)                   its inverse
    UNDONE                            the share at A_f and M_f

of the position (A_f - T + sigma/C_A)/(A_f - A_s) on heating, (T - M_f - sigma/C_M)/(M_s - M_f) on
cooling; the share is that of the phase that vanishes. All laws have the same four temperatures;
`wire.transition_spread` and `_tail` are the cosine's only. After a reversal inside the loop they
follow the contract's rule (kinetics.py), unless a law's own states say otherwise (`normal`).

Laws of which the load decides the strain (`ORIENTING`, orientation.py) have besides

    orients(wires, i, stress) -> D, slope    compiled: the share of new martensite with a strain
    oriented(stress, p) -> D                 the same of arrays
    shifting(wires, i, stress)               what stands for sigma above, and its slope, both ways
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any


def law_of(parameters: Mapping[str, Any]) -> Any:
    """The module of the law that these parameters name."""
    return import_module(f"sma_bench.physics.laws.{parameters['wire.law']}")

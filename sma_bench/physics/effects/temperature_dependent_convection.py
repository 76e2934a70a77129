"""Heat transfer that grows with the surface's temperature.

    h(T) = h [1 + c (T - T_inf)]

Linear in the excess: over 20 to 120 K natural convection (Churchill and Chu 1975, Ra^(1/6) and up)
and radiation (T^4) are within a few percent of a line."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.material import free_loss

_LEAST = 0.05  # lower limit of the bracket


@borrowing
def loss(wires, i, excess):
    """Heat loss of wire i [W/K] at a surface `excess` K above the air."""
    still = free_loss(wires, i, excess) if wires[i, at.RADIATION] > 0.0 else wires[i, at.LOSS]
    return still * max(1.0 + wires[i, at.CONVECTION_RISE] * excess, _LEAST)

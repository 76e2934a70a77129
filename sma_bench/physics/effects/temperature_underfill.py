"""An infrared spot larger than the wire sees the background too.

    T_read^n = (1 - m - o) T^n + m T_background^n + o T_opposite^n,    m = m_0 + w |e|, n = 4.5

The background is at the air's temperature or, with thermal mass of the matrix, the silicone's. w:
the wire moves out of the spot as the beam bends (e: contraction that bends it, in percent); o:
share of the spot that shows wires of the other side.
Source: radiance of a grey body in the 8 to 14 um band, about T^4.5 near 330 K."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.effects.side_heat_coupling import opposite_temperature

ACROSS = "opposite"  # the form that needs wires on two sides
_EXPONENT = 4.5
_PER_CENT = 0.01
_MOST = 0.95  # largest share of a spot without the wire


@borrowing
def spot_temperature(wires, i, background, bent):
    """Reading [K] of a spot on wire i if the contraction `bent` bends the beam."""
    missing = wires[i, at.MISSING_SPOT]
    missing = min(missing + wires[i, at.WALKING_SPOT] * abs(bent) / _PER_CENT, _MOST)
    across = min(wires[i, at.OPPOSITE_SPOT], _MOST - missing)
    seen = (1.0 - missing - across) * (wires[i, at.TEMPERATURE] / background) ** _EXPONENT + missing
    if across > 0.0:
        seen += across * (opposite_temperature(wires, i, background) / background) ** _EXPONENT
    return background * seen ** (1.0 / _EXPONENT)

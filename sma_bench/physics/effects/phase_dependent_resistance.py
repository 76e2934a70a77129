"""Resistance that depends on phase and temperature.

    R(xi, T) = R [1 + a (1 - xi) + 4 w xi (1 - xi)] [1 + (b + b_M xi) (T - T_inf)]

R is that of martensite at ambient temperature; the brackets stay above 0. w: an intermediate phase
(R-phase); b_M: additional temperature coefficient of martensite.
Source: mixture rule of the phases' resistivities (Ikuta 1990; Furst and Seelecke 2012); a includes
the change of geometry with the recovered strain."""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at

_LEAST = 0.05  # lower limit of both brackets


@borrowing
def resistance(wires, i):
    """R of wire i [ohm] at the start of a step."""
    xi, rise = wires[i, at.FRACTION], wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
    of_phase = 1.0 + wires[i, at.AUSTENITE_RESISTANCE] * (1.0 - xi)
    of_phase = max(of_phase + 4.0 * wires[i, at.RESISTANCE_HUMP] * xi * (1.0 - xi), _LEAST)
    slope = wires[i, at.RESISTANCE_SLOPE] + wires[i, at.MARTENSITE_RESISTANCE_SLOPE] * xi
    return wires[i, at.RESISTANCE] * of_phase * max(1.0 + slope * rise, _LEAST)

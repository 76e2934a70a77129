"""Free convection and radiation of a wire in still air, `wire.convection: free`.

    h A_c = C [(x^2 + 2^2)/(60^2 + 2^2)]^(n/2) + e s A_c (T + T_inf)(T^2 + T_inf^2)

x = T - T_inf in K, rounded within 2 K; n by the wire's diameter (parameters/parameters.py); e =
0.4, s Stefan and Boltzmann's constant. C is what is left of `wire.heat_transfer_coefficient` A_c,
which holds 60 K above ambient. Source: Churchill and Chu 1975; Morgan 1975 has n of 0.15 for wires
as thin.
"""


from sma_bench.arrays import Array
from sma_bench.compiled import borrowing
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import OXIDISED, REFERENCE_EXCESS, free_exponent, radiation
from sma_bench.physics import columns as at
from sma_bench.physics.material import heat_loss

_ROUNDED = 2.0  # K
_MOST = 0.9  # of a small coefficient, that radiation can be


def note_free(row: Array, p: Parameters) -> None:
    """Write the loss of free convection into the row of a wire."""
    ambient, total = p["environment.ambient_temperature"], heat_loss(p)
    area, hot = p["wire.surface_area"], ambient + REFERENCE_EXCESS
    radiated = min(radiation(OXIDISED, hot, ambient) * area, _MOST * total)
    row[at.RADIATION] = radiated / ((hot + ambient) * (hot**2 + ambient**2))
    exponent = free_exponent(p["wire.diameter"], ambient)
    row[at.CONVECTION_EXPONENT] = 0.5 * exponent
    reference = REFERENCE_EXCESS**2 + _ROUNDED**2
    row[at.CONVECTION] = (total - radiated) / reference ** (0.5 * exponent)
    row[at.HEATED_OTHERWISE] = 1.0


@borrowing
def free_loss(wires, i, excess):
    """Heat loss of wire i [W/K] at a surface `excess` K above the air."""
    power = (excess * excess + _ROUNDED * _ROUNDED) ** wires[i, at.CONVECTION_EXPONENT]
    air = wires[i, at.AMBIENT]
    surface = air + excess
    radiated = wires[i, at.RADIATION] * (surface + air) * (surface * surface + air * air)
    return wires[i, at.CONVECTION] * power + radiated

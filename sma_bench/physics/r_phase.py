"""The R-phase, between austenite and martensite: an option beside every law, off by default.

Of what is not martensite a part is R-phase, which is longer than austenite by eps_R:

    xi_R = (1 - xi) sin^2[pi/2 (T_R + w/2 - T + sigma/C_R)/w]

It shows on cooling, before martensite forms, and where A_s lies below T_R on heating too. C_R is so
steep, and its hysteresis of 1 to 5 K so narrow (left out here), that it moves with T alone. Its
heat (5 J/g) and its resistance are not modelled.

Source: Otsuka and Ren 2005. Parameters: eps_R (`wire.r_phase_strain`; 0: none), T_R
(`wire.r_phase_temperature`), w (`wire.r_phase_range`).
"""

from sma_bench.compiled import borrowing
from sma_bench.physics import columns as at
from sma_bench.physics.laws.cosine import ramp

STRESS_INFLUENCE = 16e6  # C_R, Pa/K: 13 to 20 MPa/K


@borrowing
def strain(wires, i):
    """Strain by which R-phase lengthens wire i, at the temperature that its step leads to."""
    temperature = wires[i, at.START] + wires[i, at.LAG] * wires[i, at.FRACTION]
    colder = wires[i, at.R_END] - temperature + wires[i, at.STRESS] / STRESS_INFLUENCE
    share = ramp(colder / wires[i, at.R_RANGE])[0]
    return wires[i, at.R_STRAIN] * share * (1.0 - wires[i, at.FRACTION])

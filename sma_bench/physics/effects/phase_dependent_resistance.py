"""Resistance that depends on phase and temperature.

    R(xi, T) = R [1 + a (1 - xi) + 4 w xi (1 - xi)] [1 + (b + b_M xi) (T - T_inf)]

R is the martensite's at ambient temperature; the brackets stay above 0. w: an intermediate phase
(R-phase); b_M: martensite's own rise.
Source: mixture rule of the phases' resistivities (Ikuta 1990; Furst and Seelecke 2012); the
strain's part of the geometry is within a.
"""

from sma_bench.compiled import borrowing
from sma_bench.parameters.parameter import Effect, Parameter
from sma_bench.physics import columns as at

EFFECT = Effect(
    "electrical",
    (Parameter("austenite_change", "1", 0.0,
               "R of austenite over R of martensite, less 1; 0 is off.",
               "assumed: resistivities of NiTi differ by up to 25 %, either way", -0.5, 1.0,
               uncertainty=0.12),
     Parameter("temperature_coefficient", "1/K", 0.0, "Relative rise of R a kelvin above ambient.",
               "assumed: below that of pure metals", -2e-3, 5e-3, uncertainty=2e-4),
     Parameter("hump", "1", 0.0, "What R has more half way, of martensite's; 0 is off.",
               "assumed: R-phase, to 20 %", -0.5, 1.0, uncertainty=0.1),
     Parameter("martensite_coefficient", "1/K", 0.0,
               "Relative rise of R a kelvin above ambient that martensite has alone.",
               "assumed: below that of pure metals", -5e-3, 1e-2, uncertainty=5e-4)),
    shows="current at the same voltage changes while the wire transforms, and with it the heating; "
    "V over I runs a loop over temperature",
    acts_on=("current", "temperature", "deflection"), marks=("HEATED_OTHERWISE",),
    forms={"mixture": ("austenite_change", "temperature_coefficient"),
           "intermediate": ("austenite_change", "hump"),
           "warm_martensite": ("austenite_change", "martensite_coefficient")},
    columns={"austenite_change": "AUSTENITE_RESISTANCE", "hump": "RESISTANCE_HUMP",
             "temperature_coefficient": "RESISTANCE_SLOPE",
             "martensite_coefficient": "MARTENSITE_RESISTANCE_SLOPE"},
)


LEAST = 0.05  # of R, where a falling line would leave its physics


@borrowing
def resistance(wires, i):
    """R of wire i [ohm] at the start of a step."""
    xi, rise = wires[i, at.FRACTION], wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
    of_phase = 1.0 + wires[i, at.AUSTENITE_RESISTANCE] * (1.0 - xi)
    if wires[i, at.RESISTANCE_HUMP] != 0.0:
        of_phase = max(of_phase + 4.0 * wires[i, at.RESISTANCE_HUMP] * xi * (1.0 - xi), LEAST)
    slope = wires[i, at.RESISTANCE_SLOPE] + wires[i, at.MARTENSITE_RESISTANCE_SLOPE] * xi
    return wires[i, at.RESISTANCE] * of_phase * max(1.0 + slope * rise, LEAST)

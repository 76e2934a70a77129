"""Resistance that depends on phase and temperature.

    R(xi, T) = R [1 + a (1 - xi)] [1 + b (T - T_inf)]

R is the martensite's at ambient temperature; the second bracket stays above 0.
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
               "assumed: below that of pure metals", -2e-3, 5e-3, uncertainty=2e-4)),
    shows="current at the same voltage changes while the wire transforms, and with it the heating; "
    "V over I runs a loop over temperature",
    acts_on=("current", "temperature", "deflection"), marks=("HEATED_OTHERWISE",),
    columns={"austenite_change": "AUSTENITE_RESISTANCE",
             "temperature_coefficient": "RESISTANCE_SLOPE"},
)


LEAST = 0.05  # of R, where a falling line would leave its physics


@borrowing
def resistance(wires, i):
    """R of wire i [ohm] at the start of a step."""
    of_phase = 1.0 + wires[i, at.AUSTENITE_RESISTANCE] * (1.0 - wires[i, at.FRACTION])
    rise = wires[i, at.TEMPERATURE] - wires[i, at.AMBIENT]
    of_heat = max(1.0 + wires[i, at.RESISTANCE_SLOPE] * rise, LEAST)
    return wires[i, at.RESISTANCE] * of_phase * of_heat

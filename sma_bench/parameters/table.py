"""Every parameter of the bench contract, with its number and where the number comes from: what
parameters.yaml declares, and the effects' numbers."""

from sma_bench.parameters.parameter import EFFECT_TABLE, Parameter, declared, read_declarations

TABLE: tuple[Parameter, ...] = (*declared(read_declarations("parameters.yaml")), *EFFECT_TABLE)
BY_NAME: dict[str, Parameter] = {parameter.name: parameter for parameter in TABLE}
# Uncertainties of sensors whose scales are known, as those of a simulated bench are.
EXACT_SENSORS = {
    p.name: 0.0 for p in TABLE if p.name.startswith("sensor.") and not p.name.endswith(".lag")
}


# --- Numbers that the paper prints beside those of the table.

# Table II, heat cycles 1 and 2 [K]; the parameter table holds cycle 2.
DSC_CYCLES = (
    {"A_s": 351.29, "A_f": 371.05, "M_s": 355.49, "M_f": 324.93},
    {"A_s": 331.81, "A_f": 353.61, "M_s": 353.39, "M_f": 325.09},
)
# Below Fig. 8, mean and deviation [K] under a holding force of 1 N.
UPFR_START = (350.65, 1.06)
UPFR_FINISH = (361.35, 1.49)
HOLDING_FORCE = 1.0  # N
# Section II.B.1 [ohm]; Table I has that of heating.
RESISTANCE_COOLING = 2.6901
# Section III.B.3, printed as "23.91 MPa" [Pa/K if "/K" is what is missing].
THERMAL_EXPANSION = 23.91e6
# Table III [K].
MARTENSITE_TEST_TEMPERATURE = 293.15
AUSTENITE_TEST_TEMPERATURE = 403.15
# Section III.B.2: martensite detwins up to this strain.
DETWINNED_AT = 0.04

TRANSITIONS = {
    "A_s": "wire.austenite_start_temperature",
    "A_f": "wire.austenite_finish_temperature",
    "M_s": "wire.martensite_start_temperature",
    "M_f": "wire.martensite_finish_temperature",
}

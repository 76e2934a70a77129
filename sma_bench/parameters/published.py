"""Numbers that the paper prints besides those of the parameter table."""

# Table II, heat cycles 1 and 2 [K]; the table holds cycle 2.
DSC_CYCLES = (
    {"A_s": 351.29, "A_f": 371.05, "M_s": 355.49, "M_f": 324.93},
    {"A_s": 331.81, "A_f": 353.61, "M_s": 353.39, "M_f": 325.09},
)
# Below Fig. 8, mean and deviation [K] under a holding force of 1 N.
UPFR_START = (350.65, 1.06)
UPFR_FINISH = (361.35, 1.49)
HOLDING_FORCE = 1.0  # N
# Section III.B.3, printed as "23.91 MPa" [Pa/K if "/K" is what is missing].
THERMAL_EXPANSION = 23.91e6
# Table III [K].
MARTENSITE_TEST_TEMPERATURE = 293.15
AUSTENITE_TEST_TEMPERATURE = 403.15
# Section III.B.2: martensite detwins up to this strain.
DETWINNED_AT = 0.04

"""The words of the contract that a case's label and an answer share."""

STAGES = ("electrical", "thermal", "transformation", "mechanical", "sensor")
PHASES = ("drive", "rest", "initial")
VERDICTS = ("effect", "recalibration", "no_gap", "ambiguous", "unexplained")

NO_GAP, RECALIBRATION, UNEXPLAINED = "no_gap", "recalibration", "unexplained"
# Candidates that are no effect and so have no stage.
NO_EFFECT = (RECALIBRATION, NO_GAP, UNEXPLAINED)

# Every effect name of the contract and the stage in which it acts.
STAGE_OF = {
    "phase_dependent_resistance": "electrical",
    "supply_drop": "electrical",
    "latent_heat": "thermal",
    "temperature_dependent_convection": "thermal",
    "matrix_thermal_mass": "thermal",
    "side_heat_coupling": "thermal",
    "ambient_drift": "thermal",
    "partial_transformation": "transformation",
    "transition_drift": "transformation",
    "stress_dependent_transition": "transformation",
    "residual_strain": "mechanical",
    "viscoelastic_matrix": "mechanical",
    "opposing_wires": "mechanical",
    "side_asymmetry": "mechanical",
    "slack": "mechanical",
    "temperature_underfill": "sensor",
    "temperature_lag": "sensor",
    "deflection_drift": "sensor",
}

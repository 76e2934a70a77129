"""Numbers of the effects that the paper's model leaves out; with every default they are off.

`effect.<name>.<number>`; the first number of an effect is its size. An effect's equation, and how
it shows at the bench, is in `physics/effects/<name>.py`.
"""

from sma_bench.parameters.parameter import Parameter

EFFECT_PREFIX = "effect."

ELECTRICAL = (
    Parameter(
        "effect.phase_dependent_resistance.austenite_change", "1", 0.0,
        "R of austenite over R of martensite, less 1; 0 is off.",
        "assumed: resistivities of NiTi differ by up to 25 %, either way", -0.5, 1.0,
        uncertainty=0.12,
    ),
    Parameter(
        "effect.phase_dependent_resistance.temperature_coefficient", "1/K", 0.0,
        "Relative rise of R a kelvin above ambient.",
        "assumed: below that of pure metals", -2e-3, 5e-3, uncertainty=2e-4,
    ),
    Parameter(
        "effect.supply_drop.resistance", "ohm", 0.0,
        "R_s of leads and contacts between the measured voltage and the wire; 0 is off.",
        "assumed: thin leads and crimps", 0.0, 5.0, uncertainty=0.2,
    ),
)

THERMAL = (
    Parameter(
        "effect.latent_heat.heat", "J/kg", 0.0,
        "Heat of transformation, the term of eq. (1) that the paper drops; 0 is off.",
        "assumed: 4 to 25 J/g by DSC", 0.0, 60e3, uncertainty=10e3,
    ),
    Parameter(
        "effect.temperature_dependent_convection.rise", "1/K", 0.0,
        "Relative rise of h a kelvin above ambient; 0 is off.",
        "assumed: natural convection and radiation, +25 % from 320 to 420 K", -2e-3, 2e-2,
        uncertainty=2.5e-3,
    ),
    Parameter(
        "effect.matrix_thermal_mass.heat_capacity", "J/K", 0.0,
        "C_e, heat capacity of the silicone that a wire warms; 0 is off.",
        "assumed: 1 to 90 times the wire's", 0.0, 20.0, uncertainty=0.5,
    ),
    Parameter(
        "effect.matrix_thermal_mass.inner_share", "1", 0.5,
        "Share of the resistance from wire to air that lies between wire and silicone.",
        "assumed: half", 0.02, 0.98, uncertainty=0.2,
    ),
    Parameter(
        "effect.side_heat_coupling.conductance", "W/K", 0.0,
        "G, heat from a wire to those of the other side, a kelvin; 0 is off.",
        "assumed: 0.15 to 0.24 W/(m K) of wire length", 0.0, 0.5, uncertainty=0.01,
    ),
    Parameter(
        "effect.ambient_drift.rate", "K/s", 0.0,
        "Rise of the air around the wires; 0 is off.",
        "assumed: 0.2 to 5 K in ten minutes", -0.2, 0.2, uncertainty=0.01,
    ),
    Parameter(
        "effect.ambient_drift.bend", "K/s2", 0.0,
        "Growth of that rise.",
        "assumed: of the order of the rise over some minutes", -2e-3, 2e-3, uncertainty=8e-5,
    ),
)

TRANSFORMATION = (
    Parameter(
        "effect.partial_transformation.memory", "1", 0.0,
        "0: loops start at once where they are turned (contract); 1: they stay flat until they "
        "meet the full loop.",
        "assumed: between the two", -0.5, 1.0, uncertainty=0.4,
    ),
    Parameter(
        "effect.partial_transformation.return_point", "1", 0.0,
        "0: inner loops run on to the origin (contract); 1: they close where they were opened.",
        "assumed: between the two", 0.0, 1.0, uncertainty=0.4,
    ),
    Parameter(
        "effect.transition_drift.shift", "K", 0.0,
        "Shift of all transition temperatures after many cycles; 0 is off.",
        "assumed: fatigue, up to 10 K", -30.0, 30.0, uncertainty=5.0,
    ),
    Parameter(
        "effect.transition_drift.cycles", "1", 3.0,
        "n_0, transformations there and back after which 63 % of the shift is done.",
        "assumed: the first cycles shift most", 0.2, 1000.0, uncertainty=2.0,
    ),
    Parameter(
        "effect.transition_drift.plastic_strain", "1", 0.0,
        "Elongation that grows with the shift.",
        "assumed: up to 0.5 %", -0.02, 0.02, uncertainty=5e-4,
    ),
    Parameter(
        "effect.stress_dependent_transition.austenite", "K/Pa", 0.0,
        "Added to 1/C_A; 0 is off.",
        "assumed: C of 5 to 15 MPa/K, wrong or absent", -2e-6, 2e-6, uncertainty=6e-8,
    ),
    Parameter(
        "effect.stress_dependent_transition.martensite", "K/Pa", 0.0,
        "Added to 1/C_M; 0 is off.",
        "assumed: C of 5 to 15 MPa/K, wrong or absent", -2e-6, 2e-6, uncertainty=6e-8,
    ),
)

MECHANICAL = (
    Parameter(
        "effect.residual_strain.share", "1", 0.0,
        "Share of the strain recovered so far that stays when the wire cools; 0 is off.",
        "assumed: 1 to 30 % of the stroke", -0.2, 0.8, uncertainty=0.1,
    ),
    Parameter(
        "effect.viscoelastic_matrix.relaxation", "1", 0.0,
        "Stiffness that relaxes over the stiffness that stays; 0 is off.",
        "assumed: 5 to 20 % of silicones", 0.0, 3.0, uncertainty=0.2,
    ),
    Parameter(
        "effect.viscoelastic_matrix.time_constant", "s", 20.0,
        "Time constant of the relaxation.",
        "assumed: 1 to 300 s", 0.2, 2000.0, uncertainty=15.0,
    ),
    Parameter(
        "effect.opposing_wires.engagement", "1", 0.0,
        "Share of the other side's bending that reaches a wire; 0 is off.",
        "assumed: 1 where the wires neither slip nor buckle", 0.0, 1.0, uncertainty=0.2,
    ),
    Parameter(
        "effect.opposing_wires.detwinning_stress", "Pa", 100e6,
        "Stress at which the passive martensite gives way.",
        "assumed: 50 to 200 MPa", 1e6, 1e9, uncertainty=60e6,
    ),
    Parameter(
        "effect.side_asymmetry.ratio", "1", 0.0,
        "The front is stiffer and the back softer by this share; 0 is off.",
        "assumed: to 50 %", -0.9, 0.9, uncertainty=0.25,
    ),
    Parameter(
        "effect.slack.strain", "1", 0.0,
        "Contraction that a wire takes up before it pulls; 0 is off.",
        "assumed: to 1 %", 0.0, 0.03, uncertainty=3e-3,
    ),
)

SENSOR = (
    Parameter(
        "effect.temperature_underfill.missing", "1", 0.0,
        "Share of the infrared spot that sees the background instead of the wire; 0 is off.",
        "assumed: wire as thin as a pixel, up to 0.6", 0.0, 0.9, uncertainty=0.2,
    ),
    Parameter(
        "effect.temperature_lag.time_constant", "s", 0.0,
        "Time constant of the temperature reading; 0 is off.",
        "assumed: 0.05 to 2 s", 0.0, 20.0, uncertainty=0.5,
    ),
    Parameter(
        "effect.deflection_drift.rate", "m/s", 0.0,
        "Drift of the deflection reading; 0 is off.",
        "assumed: to 5 % of the stroke", -1e-3, 1e-3, uncertainty=1e-5,
    ),
    Parameter(
        "effect.deflection_drift.bend", "m/s2", 0.0,
        "Growth of that drift.",
        "assumed: of the order of the drift over some minutes", -1e-5, 1e-5, uncertainty=1e-7,
    ),
)

EFFECT_TABLE: tuple[Parameter, ...] = (
    *ELECTRICAL, *THERMAL, *TRANSFORMATION, *MECHANICAL, *SENSOR,
)
EFFECT_NAMES = tuple(dict.fromkeys(parameter.name.split(".")[1] for parameter in EFFECT_TABLE))

"""Every parameter of the bench contract, with its number and where the number comes from."""

from sma_bench.parameters.parameter import EFFECT_TABLE, Parameter

# R, h, c_p and the room of Table I are known as far as the sensors of the data sheets tell them.
_ACTUATOR_WIRES = (
    "actuator wires are sold as 70 and 90 degC grades, others from below the room up; composition, "
    "cold work and ageing move one grade by 10 K and more"
)
WIRE = (
    Parameter(
        "wire.resistance", "ohm", 2.6987,
        "Electrical resistance of one wire (eq. 3).",
        "Table I", 0.01, 1000.0, uncertainty=0.05, spread=4.0,
        spread_source="wires of 0.05 to 0.5 mm, some centimetres to 2 m, have 0.3 to 40 ohm",
    ),
    Parameter(
        "wire.heat_transfer_coefficient", "W/(m2 K)", 403.26,
        "Heat loss per area and kelvin, referred to wire.surface_area (eq. 4).",
        "Table I; suspect, see the audit", 1.0, 5000.0,
        uncertainty=15.0, spread=500.0,
        spread_source="free convection and radiation give 50 to 60 at 0.5 mm and 150 to 250 at "
        "0.1 mm (Churchill-Chu), moving air or a matrix several times that",
    ),
    Parameter(
        "wire.specific_heat", "J/(kg K)", 343.2,
        "Specific heat of the alloy (eq. 5).",
        "Table I", 50.0, 2000.0, uncertainty=13.0, spread=120.0,
        spread_source="data sheets and calorimetry of NiTi print 322 to 550",
    ),
    Parameter(
        "wire.mass", "kg", 0.091e-3,
        "Mass of the heated wire.",
        "Table I", 1e-7, 1e-2, uncertainty=0.5e-6, spread=0.15e-3,
        spread_source="wires of 0.1 to 0.5 mm and 0.1 to 1 m weigh 0.005 to 1.3 g",
    ),
    Parameter(
        "wire.surface_area", "m2", 395.84e-6,
        "Area of the wire that loses heat.",
        "Table I; suspect, see the audit", 1e-7, 1e-1, uncertainty=4e-6, spread=400e-6,
        spread_source="wires of 0.1 to 0.5 mm and 0.1 to 1 m have 30 to 1600 mm2",
    ),
    Parameter(
        "wire.diameter", "m", 0.3e-3,
        "Diameter of the wire.",
        "section II.B", 1e-5, 5e-3, uncertainty=3e-6, spread=0.15e-3,
        spread_source="actuator wires are sold from 0.025 to 0.5 mm",
    ),
    Parameter(
        "wire.length", "m", 0.0,
        "Length of the wires between their clamps; 0 means derived from mass and diameter.",
        "mass over the density of NiTi, 6450 kg/m3", 0.0, 100.0,
    ),
    Parameter(
        "wire.count", "1", 1,
        "Equal wires in parallel on one channel; wire.resistance and wire.mass are those of one.",
        "Fig. 1: one wire", 1, 1000, kind="integer", read_only=True,
    ),
    Parameter(
        "wire.austenite_start_temperature", "K", 331.81,
        "A_s, stress free.",
        "Table II, cycle 2", 150.0, 900.0, uncertainty=1.1, spread=25.0,
        spread_source=_ACTUATOR_WIRES,
    ),
    Parameter(
        "wire.austenite_finish_temperature", "K", 353.61,
        "A_f, stress free.",
        "Table II, cycle 2", 150.0, 900.0, uncertainty=1.5, spread=25.0,
        spread_source=_ACTUATOR_WIRES,
    ),
    Parameter(
        "wire.martensite_start_temperature", "K", 353.39,
        "M_s, stress free (above A_s in the paper's own data).",
        "Table II, cycle 2", 150.0, 900.0, uncertainty=1.5, spread=25.0,
        spread_source=_ACTUATOR_WIRES,
    ),
    Parameter(
        "wire.martensite_finish_temperature", "K", 325.09,
        "M_f, stress free.",
        "Table II, cycle 2", 150.0, 900.0, uncertainty=1.5, spread=25.0,
        spread_source=_ACTUATOR_WIRES,
    ),
    Parameter(
        "wire.transition_spread", "K", 0.0,
        "Standard deviation of the transition temperatures over the grains; 0 for the ramps of "
        "eqs. (10), (11) as they are.",
        "assumed: a polycrystal transforms more smoothly than a cosine", 0.0, 30.0,
        uncertainty=1.5,
    ),
    Parameter(
        "wire.transition_tail", "1", 0.0,
        "Share of every grain whose ramp is a normal distribution, with the mean and the deviation "
        "of the cosine's.",
        "assumed: a polycrystal transforms more smoothly than a cosine", 0.0, 1.0,
        uncertainty=0.3,
    ),
    Parameter(
        "wire.martensite_modulus", "Pa", 22.8e9,
        "E_M, Young's modulus of martensite at 293.15 K (eq. 7).",
        "Table III", 1e9, 200e9, uncertainty=1.2e9, spread=10e9,
        spread_source="data sheets of NiTi print 20 to 41 GPa",
    ),
    Parameter(
        "wire.austenite_modulus", "Pa", 55.4e9,
        "E_A, Young's modulus of austenite at 403.15 K (eq. 7).",
        "Table III", 1e9, 200e9, uncertainty=2.5e9, spread=15e9,
        spread_source="data sheets of NiTi print 40 to 83 GPa",
    ),
    Parameter(
        "wire.maximum_recoverable_strain", "1", 0.044,
        "eps_L, strain recovered on heating (eq. 9).",
        "section III.B.1, Fig. 8", 1e-4, 0.15, uncertainty=0.002, spread=0.012,
        spread_source="trained actuator wires recover 3 to 5 %, NiTi at most 8 %",
    ),
    Parameter(
        "wire.thermal_expansion_factor", "Pa/K", -0.15e6,
        "Theta_T, stress per kelvin of a clamped wire below A_s (eq. 8).",
        "assumed: -alpha E_M with alpha = 6.6e-6 1/K of martensite; the printed 23.91 MPa lacks "
        "1/K and is two orders above alpha E",
        -50e6, 50e6, uncertainty=0.05e6, spread=0.15e6,
        spread_source="alpha of 6.6e-6 to 11e-6 1/K and E_M of 20 to 41 GPa",
    ),
    Parameter(
        "wire.stress_influence_austenite", "Pa/K", 7.0e6,
        "C_A, shift of A_s and A_f with stress (eq. 10).",
        "assumed: middle of 5 to 8 MPa/K measured on NiTi; the paper gives none",
        0.5e6, 50e6, uncertainty=1.0e6, spread=1.5e6,
        spread_source="5 to 10 MPa/K on NiTi wires",
    ),
    Parameter(
        "wire.stress_influence_martensite", "Pa/K", 7.0e6,
        "C_M, shift of M_s and M_f with stress (eq. 11).",
        "assumed: equal to C_A; the paper gives none",
        0.5e6, 50e6, uncertainty=1.0e6, spread=1.5e6,
        spread_source="5 to 10 MPa/K on NiTi wires",
    ),
)

ENVIRONMENT = (
    Parameter(
        "environment.ambient_temperature", "K", 296.15,
        "T_inf, temperature of the surrounding air.",
        "Table I", 230.0, 373.0, uncertainty=1.2, spread=4.0,
        spread_source="rooms of 16 to 30 degC",
    ),
)

COMPOSITE = (
    Parameter(
        "composite.length", "m", 0.12,
        "l, distance from the clamping to the point where the deflection is measured.",
        "assumed: a hand-sized specimen; the paper gives no geometry",
        1e-3, 2.0, uncertainty=0.001, spread=0.06,
        spread_source="hand-sized specimens",
    ),
    Parameter(
        "composite.thickness", "m", 6e-3,
        "h_c, thickness of the elastomer matrix.",
        "assumed: the paper gives no geometry", 1e-4, 0.1, uncertainty=0.2e-3, spread=3e-3,
        spread_source="hand-sized specimens",
    ),
    Parameter(
        "composite.width", "m", 0.03,
        "w_c, width of the beam.",
        "assumed: the paper gives no geometry", 1e-3, 0.5, uncertainty=0.5e-3, spread=0.015,
        spread_source="hand-sized specimens",
    ),
    Parameter(
        "composite.modulus", "Pa", 1.0e6,
        "E_c, Young's modulus of the elastomer matrix.",
        "assumed: silicone of Shore A 25 to 35", 1e4, 1e9, uncertainty=0.2e6, spread=1.0e6,
        spread_source="silicones of Shore A 10 to 60",
    ),
    Parameter(
        "composite.wire_offset", "m", 3e-3,
        "a, distance of the wires from the centre line (eq. 12).",
        "assumed: the wires lie at the faces of the matrix", 1e-4, 0.05,
        uncertainty=0.2e-3, spread=1.5e-3,
        spread_source="half the thickness of hand-sized specimens",
    ),
    Parameter(
        "composite.wire_layer_thickness", "m", 0.3e-3,
        "h, thickness of the active layer (eqs. 14, 16).",
        "assumed: one wire diameter", 1e-6, 0.01, uncertainty=0.03e-3, spread=0.15e-3,
        spread_source="as the wire's diameter",
    ),
    Parameter(
        "composite.wire_layer_width", "m", 0.0,
        "Width of the active layer (eqs. 14 to 17); 0 means the section of a side's wires over "
        "composite.wire_layer_thickness.",
        "corrected eqs. (14), (16): the text gives each layer a width, the equations print one",
        0.0, 0.5,
    ),
    Parameter(
        "composite.deflection_per_strain", "m", 0.0,
        "alpha (eq. 22), deflection per contraction strain; 0 means derived from the geometry.",
        "corrected eq. (16)", 0.0, 100.0, uncertainty=0.05,
    ),
    Parameter(
        "composite.stress_per_deflection_front", "Pa/m", 0.0,
        "beta (eq. 23) when bending to the front; 0 means derived from the geometry.",
        "eq. (23) with the corrected EI", 0.0, 1e13, uncertainty=2e8,
    ),
    Parameter(
        "composite.stress_per_deflection_back", "Pa/m", 0.0,
        "beta (eq. 23) when bending to the back; 0 means derived from the geometry.",
        "eq. (23) with the corrected EI", 0.0, 1e13, uncertainty=2e8,
    ),
)

LOAD = (
    Parameter(
        "load.kind", "", "",
        "What the wires pull against: clamped (no motion), force (a weight, or a frame that holds "
        "load.force), spring, antagonist (front and back wires on one slider) or beam; empty: "
        "clamped for one channel, beam for several.",
        "Fig. 1: clamped; Figs. 11, 12: a beam", kind="string", read_only=True,
    ),
    Parameter(
        "load.force", "N", 0.0,
        "Held force; beside a spring or on an antagonists' slider (to the back) a weight.",
        "none; the paper's E6 holds 1 N", -1e4, 1e4, uncertainty=0.02, spread=2.0,
        spread_source="weights of 0 to 400 g",
    ),
    Parameter(
        "load.stiffness", "N/m", 0.0,
        "Of the spring, or of the slider's own.",
        "assumed: none", 0.0, 1e8, uncertainty=20.0, spread=200.0,
        spread_source="springs beside an actuator wire have 50 to 1000 N/m",
    ),
    Parameter(
        "load.preload", "N", 0.0,
        "Of the spring at the reference position, or of each side of an antagonist at rest.",
        "assumed: none", -1e4, 1e4, uncertainty=0.2, spread=2.0,
        spread_source="what keeps a wire of 0.1 to 0.5 mm straight",
    ),
    Parameter(
        "load.lever", "m/rad", 0.0,
        "Movement a radian where a table's output is an angle: import turns it into movement; 0: "
        "the output is a length.",
        "none", 0.0, 100.0,
    ),
)

BENCH = (
    Parameter(
        "bench.channels", "", ("wire",),
        "Power channels, in the order of voltage_command.",
        "Fig. 1: one clamped wire", kind="strings", read_only=True,
    ),
    Parameter(
        "bench.channel_sides", "", ("front",),
        "Side of the beam (front or back) of every channel.",
        "Fig. 1: one clamped wire", kind="strings", read_only=True,
    ),
    Parameter(
        "bench.drive", "", "voltage",
        "How a command of V volts heats: voltage, V reach the wire; duty, bench.supply_voltage is "
        "on for V over it of the time; current, V over wire.resistance and per wire.",
        "section IV: 0 to 10 V", kind="string", read_only=True,
    ),
    Parameter(
        "bench.supply_voltage", "V", 10.0,
        "What a duty switches.",
        "section IV: 0 to 10 V", 0.1, 60.0, uncertainty=0.1, spread=6.0,
        spread_source="supplies of 5, 6, 12 and 24 V",
    ),
    Parameter(
        "bench.lead_resistance", "ohm", 0.0,
        "Known resistance of leads between the voltmeter and the wires of a channel.",
        "assumed: measured at the wire", 0.0, 100.0, uncertainty=0.01, spread=0.05,
        spread_source="0.3 m of copper leads and their clips",
    ),
    Parameter(
        "bench.maximum_voltage", "V", 10.0,
        "No command above it is accepted.",
        "section IV: 0 to 10 V", 0.1, 60.0,
    ),
    Parameter(
        "bench.maximum_current", "A", 3.0,
        "A larger current through a wire switches the outputs off.",
        "section IV: 0 to 3 A", 0.01, 30.0,
    ),
    Parameter(
        "bench.maximum_temperature", "K", 423.15,
        "A hotter wire switches the outputs off: measured, or by eq. (1) where nothing measures.",
        "assumed: 70 K above A_f, below what silicone and camera window endure",
        300.0, 700.0,
    ),
    Parameter(
        "bench.command_timeout", "s", 0.5,
        "Silence of voltage_command after which the outputs go to 0 V.",
        "assumed: ten periods of a 20 Hz command", 0.02, 5.0,
    ),
    Parameter(
        "bench.maximum_power", "W", 30.0,
        "More power in a wire switches the outputs off.",
        "section IV: 10 V and 3 A", 0.01, 1000.0,
    ),
    Parameter(
        "bench.maximum_heating_rate", "K/s", 1500.0,
        "A wire that warms faster, over 50 ms, switches the outputs off.",
        "assumed: half above what 30 W give the wire of Table I", 1.0, 1e5,
    ),
    Parameter(
        "bench.voltage_tolerance", "V", 0.5,
        "A wire's voltage may differ from the commanded one by this at bench.maximum_voltage, by "
        "less below, by a fifth of it at 0 V.",
        "assumed: 5 % of the range", 0.05, 60.0,
    ),
    Parameter(
        "bench.resistance_tolerance", "1", 0.3,
        "A wire's current may differ from that of wire.resistance by this share, and 0.1 A.",
        "assumed: martensite to austenite changes it by 15 %; one of two wires off by 50 %",
        0.05, 10.0,
    ),
    Parameter(
        "bench.temperature_tolerance", "K", 60.0,
        "A wire's temperature may differ from that of eq. (1) by this.",
        "assumed: twice what latent heat and an under-filled camera spot make", 5.0, 500.0,
    ),
)

_CAMERA = "Optris PI and Xi: +-2 K or +-2 % of the degrees Celsius, limits of a rectangle"
SENSORS = (
    Parameter(
        "sensor.current.gain", "1", 1.0,
        "True current over the reading, its offset taken off.",
        "data sheet of the ACS712: total output error 1.5 %", 0.5, 2.0, uncertainty=0.015,
    ),
    Parameter(
        "sensor.voltage.gain", "1", 1.0,
        "True voltage over the reading, its offset taken off.",
        "data sheet: divider of resistors of 1 % before a converter whose reference is the supply",
        0.5, 2.0, uncertainty=0.01,
    ),
    Parameter(
        "sensor.temperature.gain", "1", 1.0,
        "True temperature over the reading, both in degrees Celsius.", _CAMERA, 0.5, 2.0,
        uncertainty=0.0115,
    ),
    Parameter(
        "sensor.deflection.gain", "1", 1.0,
        "True deflection over the reading.",
        "assumed: 1 % is left by a calibration against gauge blocks", 0.5, 2.0, uncertainty=0.01,
    ),
    Parameter(
        "sensor.current.offset", "A", 0.0,
        "True current where the reading is zero.",
        "data sheet of the ACS712: zero within 40 mV, set at every start", -1.0, 1.0,
        uncertainty=0.005,
    ),
    Parameter(
        "sensor.voltage.offset", "V", 0.0,
        "True voltage where the reading is zero.",
        "assumed: half a step of a 10 bit converter", -1.0, 1.0, uncertainty=0.005,
    ),
    Parameter(
        "sensor.temperature.offset", "K", 0.0,
        "True temperature less the reading at 0 degC.", _CAMERA, -50.0, 50.0, uncertainty=1.15,
    ),
    Parameter(
        "sensor.deflection.offset", "m", 0.0,
        "True deflection where the reading is zero.",
        "assumed: the tip at rest is zero", -0.1, 0.1, uncertainty=5e-4,
    ),
    Parameter(
        "sensor.temperature.emissivity", "1", 0.95,
        "Of the wire, as the camera was told; a wrong one scales what the wire is warmer by.",
        "matt black paint: 0.93 to 0.97", 0.05, 1.0, uncertainty=0.02,
    ),
    Parameter(
        "sensor.temperature.spot_share", "1", 1.0,
        "Of the camera's spot that is wire; the reading's excess over the room goes with it.",
        "assumed: the size of a pixel is known to 2 %", 0.05, 1.0, uncertainty=0.02,
    ),
    Parameter(
        "sensor.temperature.lag", "s", 0.0,
        "Time constant of the camera.",
        "assumed: a microbolometer of 10 ms", 0.0, 20.0, uncertainty=0.01,
    ),
)
# Uncertainties of sensors whose scales are known, as those of a simulated bench are.
EXACT_SENSORS = {p.name: 0.0 for p in SENSORS if not p.name.endswith(".lag")}

TABLE: tuple[Parameter, ...] = (
    *WIRE, *ENVIRONMENT, *COMPOSITE, *LOAD, *BENCH, *SENSORS, *EFFECT_TABLE
)
BY_NAME: dict[str, Parameter] = {parameter.name: parameter for parameter in TABLE}


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

"""The paper's experiments on synthetic specimens, as its instruments would record them."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.parameters.parameters import wire_section
from sma_bench.physics import Boundary, simulate
from sma_bench.physics.bending import bending_coefficients
from sma_bench.physics.kernel import cooled_fraction, heated_fraction
from sma_bench.physics.material import heat_loss, modulus
from sma_bench.records import instruments
from sma_bench.synthetic.bench_records import clamped_staircase_record, protocol_record

# Table II, heat cycles 1 and 2 [K]; the table holds cycle 2.
DSC_CYCLES = ({"A_s": 351.29, "A_f": 371.05, "M_s": 355.49, "M_f": 324.93},
              {"A_s": 331.81, "A_f": 353.61, "M_s": 353.39, "M_f": 325.09})
# Text below Fig. 8: mean and deviation [K] under a holding force of 1 N.
UPFR_START, UPFR_FINISH = (350.65, 1.06), (361.35, 1.49)
HOLDING_FORCE = 1.0  # N
_COLD_TEST, _HOT_TEST = 293.15, 403.15  # K, tests of martensite and of austenite, Table III
_DETWINNED_AT = 0.04  # strain up to which martensite detwins, section III.B.2

# --- E5, Fig. 7: heat into the sample is m (c_p dT/dt - L dxi/dt), eq. (1) with xi of eqs. (10),
# (11) at no stress, behind a start-up transient, a drifting baseline and noise, but no thermal lag.

COLDEST, HOTTEST = 273.15, 453.15  # K, section III.B.1
RATE = 5.0 / 60.0  # K/s, section III.B.1
SAMPLE_MASS = 8e-6  # kg, assumed: a few millimetres of wire
LATENT_HEAT = 20e3  # J/kg, assumed: NiTi has 10 to 25 kJ/kg
_SCAN_PERIOD, _START_UP = 0.5, 12.0  # s
_HEAT_FLOW_NOISE = 0.2e-6  # W, sensitivity of the Q2000
_DRIFT = (25e-6, 12e-6)  # W, linear and quadratic over a scan


def dsc_run(parameters: Parameters, seed: int = 5) -> instruments.DscRecord:
    """A heating and a cooling for each cycle of Table II; two equal cycles of any other wire."""
    cycles = [parameters, parameters]
    if _is_papers_wire(parameters):
        cycles = [parameters.replace({TRANSITIONS[end]: kelvin for end, kelvin in cycle.items()})
                  for cycle in DSC_CYCLES]
    random = np.random.default_rng(seed)
    segments: list[instruments.DscSegment] = []
    time = np.arange(0.0, (HOTTEST - COLDEST) / RATE, _SCAN_PERIOD)
    for wire in cycles:
        for sign in (1.0, -1.0):
            temperature = (COLDEST if sign > 0.0 else HOTTEST) + sign * RATE * time
            xi = (heated_fraction if sign > 0.0 else cooled_fraction)(temperature, 0.0, wire)
            settled = sign * RATE * (1.0 - np.exp(-time / _START_UP))
            sensible = wire["wire.specific_heat"] * settled
            heat = SAMPLE_MASS * (sensible - LATENT_HEAT * np.gradient(xi, time))
            share = (temperature - COLDEST) / (HOTTEST - COLDEST)
            drift = _DRIFT[0] * share + _DRIFT[1] * share**2
            noise = _HEAT_FLOW_NOISE * random.standard_normal(len(time))
            began = len(segments) * (HOTTEST - COLDEST) / RATE
            rest = (heat + drift + noise, np.zeros(len(time)), temperature, temperature)
            number = len(segments) + 1
            segments.append(instruments.DscSegment(number, sign * RATE, began + time, *rest))
    path, header = Path("synthetic DSC run of 2 cycles"), {"Sample ID": "synthetic NiTi wire"}
    return instruments.DscRecord(path, SAMPLE_MASS, header, tuple(segments), instrument="synthetic")


# --- E6, Fig. 8: the simulated wire in a slow triangle of temperature under a held force.

_RATE, _ABOVE_FINISH, _FRAME_PERIOD = 0.5, 25.0, 0.2  # K/s; K, of the peak above A_f; s
_TEMPERATURE_NOISE = 0.05  # K, a thermocouple in a chamber
_STRAIN_NOISE = 2e-5  # 4 micrometres of traverse on 0.2 m of wire
_COSINE_WIDTH = 0.5 * math.pi  # width of a cosine ramp over that of its steepest tangent


def isobaric_test(parameters: Parameters, stress: float, name: str,
                  seed: int = 1) -> instruments.IsobaricRecord:
    """One heating and cooling of the wire of `parameters` under a held stress [Pa]."""
    random = np.random.default_rng(seed)
    shift = stress / parameters["wire.stress_influence_austenite"]
    hottest = parameters["wire.austenite_finish_temperature"] + shift + _ABOVE_FINISH
    rise = (hottest - parameters["environment.ambient_temperature"]) / _RATE
    time = np.arange(0.0, 2.0 * rise, _FRAME_PERIOD)
    above = _RATE * np.minimum(time, 2.0 * rise - time)
    rate = np.where(time < rise, _RATE, -_RATE)
    capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    power = np.maximum(heat_loss(parameters) * above + capacity * rate, 0.0)
    voltage = np.sqrt(power * parameters["wire.resistance"])
    run = simulate(parameters, time, voltage, boundary=Boundary.held_stress(stress))
    strain = -run.contraction[:, 0] + _STRAIN_NOISE * random.standard_normal(len(time))
    temperature = run.temperature[:, 0] + _TEMPERATURE_NOISE * random.standard_normal(len(time))
    held = np.full(len(time), stress)
    cycles, findings = instruments.find_cycles(temperature, strain, held, name)
    return instruments.IsobaricRecord(Path(name), name, stress, "1", cycles, tuple(findings))


# --- E7, Fig. 9: austenite follows the package's law, eps = sigma/E(xi) + eps_L xi, eq. (11) under
# load. Martensite, whose detwinning is outside the law, is a test curve: a rise with E_M, a plateau
# up to 4 % of strain, again a rise with E_M, rounded corners. Both begin with a toe.

_DETWINNING_STRESS = 130e6  # Pa, assumed: 100 to 200 MPa on NiTi
_DETWINNING_SLOPE = 0.6e9  # Pa, assumed
_LARGEST_STRAIN, _TOE, _ROUNDING, _POINTS = 0.06, 0.0015, 0.0008, 1500
_STRESS_NOISE = 0.6e6  # Pa, 0.04 N of a 500 N load cell on a 0.3 mm wire


def tensile_test(parameters: Parameters, temperature: float, name: str,
                 seed: int) -> instruments.TensileRecord:
    """One test of a wire at a temperature [K]: of martensite below M_f, else of austenite."""
    phase: instruments.Phase = "austenite"
    if temperature <= parameters["wire.martensite_finish_temperature"]:
        phase, e_m = "martensite", parameters["wire.martensite_modulus"]
        begins, last = _DETWINNING_STRESS / e_m, 2.0 * _LARGEST_STRAIN
        ends = _DETWINNING_STRESS + _DETWINNING_SLOPE * (_DETWINNED_AT - begins)
        curve = np.array([0.0, begins, _DETWINNED_AT, last])
        load = np.array([0.0, _DETWINNING_STRESS, ends, ends + e_m * (last - _DETWINNED_AT)])
    else:  # eqs. (6), (7), (9), (11) loaded from austenite
        load = np.linspace(0.0, 2e9, 20001)
        xi = cooled_fraction(temperature, load, parameters)
        curve = load / modulus(xi, parameters) + parameters["wire.maximum_recoverable_strain"] * xi
    fine = np.linspace(0.0, 1.5 * _LARGEST_STRAIN, 20001)
    width = int(_ROUNDING / (fine[1] - fine[0]))
    padded = np.pad(np.interp(fine, curve, load), width, mode="reflect", reflect_type="odd")
    rounded = np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid")
    strain = np.linspace(0.0, _LARGEST_STRAIN, _POINTS)
    stress = np.interp(np.maximum(strain - _TOE, 0.0), fine, rounded)
    noise = _STRESS_NOISE * np.random.default_rng(seed).standard_normal(_POINTS)
    return instruments.TensileRecord(Path(name), strain, stress + noise, temperature, phase=phase)


COMPOSITE = {"bench.channels": ("front_1", "front_2", "back_1", "back_2"),
             "bench.channel_sides": ("front", "front", "back", "back")}  # fmt: skip
# The paper says that its specimen is stiffer on one side, but not by how much.
BACK_STIFFNESS = 3.0
REPEATS = (-1.0, 0.0, 1.0)  # specimens, in standard deviations: their sample deviation is 1
_WELL_INSIDE = 15.0  # K beyond M_f or A_f
STRESSES = (10e6, 50e6, 100e6, 150e6, 200e6)
_PLAYED = {"thermal": (("staircase", 1), ("ramp", 2)), "validation": (("triangle", 3),),
           "composite": (("composite_triangle", 40), ("composite_step", 41))}  # with seeds


def _is_papers_wire(parameters: Parameters) -> bool:
    """Whether the transition temperatures are those of Table II, cycle 2."""
    return all(parameters[name] == DSC_CYCLES[1][end] for end, name in TRANSITIONS.items())


def wire_rig(parameters: Parameters) -> Parameters:
    """One clamped wire (Fig. 1)."""
    return parameters.replace({"bench.channels": ("wire",), "bench.channel_sides": ("front",),
                               "load.kind": "clamped"})


def composite_rig(parameters: Parameters) -> Parameters:
    """Four wires, two per side (Figs. 11, 12); the back stiffer unless it is given."""
    rig = parameters.replace({**COMPOSITE, "load.kind": "beam"})
    if "composite.stress_per_deflection_back" in parameters.given:
        return rig
    _, _, back = bending_coefficients(rig)
    return rig.replace({"composite.stress_per_deflection_back": BACK_STIFFNESS * back})


def papers_records(group: str, parameters: Parameters) -> tuple[Any, ...]:
    """Records of this wire: "thermal" (E1 to E3: staircase, ramps), "validation" (E4: triangle),
    "dsc" (E5), "upfr" (E6), "isobaric" (E9: several stresses), "tensile" (E7: two phases),
    "clamped" (E8: temperature staircase below A_s) or "composite" (E12: triangle and step)."""
    wire = wire_rig(parameters)
    if group == "dsc":
        return (dsc_run(parameters),)
    if group == "upfr":
        return _upfr_tests(wire)
    if group == "isobaric":
        tests = [(x, f"synthetic isobaric test at {x / 1e6:.0f} MPa") for x in STRESSES]
        return tuple(isobaric_test(wire, *test, 10 + k) for k, test in enumerate(tests))
    if group == "tensile":
        return _tensile_tests(parameters)
    if group == "clamped":
        return (clamped_staircase_record(wire, seed=30),)
    rig = composite_rig(parameters) if group == "composite" else wire
    return tuple(protocol_record(name, rig, seed) for name, seed in _PLAYED[group])


def _upfr_tests(wire: Parameters) -> tuple[instruments.IsobaricRecord, ...]:
    """E6, first cycle: specimens with the paper's mean and deviation of the tangents' crossings
    under the holding force; for another wire, with the same deviation about its own."""
    stress = HOLDING_FORCE / wire_section(wire)
    shift = stress / wire["wire.stress_influence_austenite"]
    start, finish = UPFR_START[0], UPFR_FINISH[0]
    if _is_papers_wire(wire):
        wire = wire.replace({TRANSITIONS[end]: DSC_CYCLES[0][end] for end in ("M_s", "M_f")})
    else:
        start, finish = wire[TRANSITIONS["A_s"]], wire[TRANSITIONS["A_f"]]
        inward = (0.5 - 1.0 / math.pi) * (finish - start)
        start, finish = float(start + inward + shift), float(finish - inward + shift)
    tests = []
    for k, deviation in enumerate(REPEATS):
        # The cosine of eq. (10) with these tangents is wider at both ends.
        a_s, a_f = start + UPFR_START[1] * deviation, finish + UPFR_FINISH[1] * deviation
        middle, half = 0.5 * (a_s + a_f) - shift, 0.5 * (a_f - a_s) * _COSINE_WIDTH
        ends = {TRANSITIONS["A_s"]: middle - half, TRANSITIONS["A_f"]: middle + half}
        specimen = wire.replace(ends)
        tests.append(isobaric_test(specimen, stress, f"synthetic UPFR test {k + 1}", seed=k))
    return tuple(tests)


def _tensile_tests(parameters: Parameters) -> tuple[instruments.TensileRecord, ...]:
    """E7: specimens with the deviations of Table III, at its temperatures or well in the phase."""
    cold = float(parameters["wire.martensite_finish_temperature"]) - _WELL_INSIDE
    hot = float(parameters["wire.austenite_finish_temperature"]) + _WELL_INSIDE
    temperatures = {"martensite": min(_COLD_TEST, cold), "austenite": max(_HOT_TEST, hot)}
    tests = []
    for k, deviation in enumerate(REPEATS):
        moduli = [f"wire.{phase}_modulus" for phase in temperatures]
        own = {name: parameters[name] + deviation * parameters.std(name) for name in moduli}
        for phase, kelvin in temperatures.items():
            name = f"synthetic {phase} {k + 1} at {kelvin:.2f} K"
            tests.append(tensile_test(parameters.replace(own), kelvin, name, 20 + k))
    return tuple(tests)

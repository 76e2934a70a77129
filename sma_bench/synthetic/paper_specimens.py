"""The paper's experiments on synthetic specimens, and what its instruments would write down of the
model's wire (E5 to E7): protocols, cycles and repeats as it did them.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.table import (
    AUSTENITE_TEST_TEMPERATURE,
    DETWINNED_AT,
    DSC_CYCLES,
    HOLDING_FORCE,
    MARTENSITE_TEST_TEMPERATURE,
    TRANSITIONS,
    UPFR_FINISH,
    UPFR_START,
)
from sma_bench.physics import Boundary, simulate
from sma_bench.physics.bending import bending_coefficients, wire_section
from sma_bench.physics.heat import heat_loss
from sma_bench.physics.material import cooled_fraction, heated_fraction, modulus
from sma_bench.records.dsc import DscRecord, DscSegment
from sma_bench.records.isobaric import IsobaricRecord, find_cycles
from sma_bench.records.record import Record
from sma_bench.records.tensile import Phase, TensileRecord
from sma_bench.synthetic.bench_records import clamped_staircase_record, protocol_record

# --- Synthetic DSC run: what the model's wire would do to a calorimeter (E5, Fig. 7).
#
# Heat into the sample is m (c_p dT/dt - L dxi/dt), eq. (1) with xi of eqs. (10), (11) at no
# stress. The instrument adds a start-up transient, a baseline that drifts, and noise. Thermal
# lag is left out, so that the onsets are those of the material.

Array = NDArray[np.float64]

COLDEST, HOTTEST = 273.15, 453.15  # K, section III.B.1
RATE = 5.0 / 60.0  # K/s, section III.B.1
SAMPLE_MASS = 8e-6  # kg, assumed: a few millimetres of wire
LATENT_HEAT = 20e3  # J/kg, assumed: NiTi has 10 to 25 kJ/kg
_SCAN_PERIOD = 0.5  # s
_HEAT_FLOW_NOISE = 0.2e-6  # W, sensitivity of the Q2000
_DRIFT = (25e-6, 12e-6)  # W, linear and quadratic over a scan
_START_UP = 12.0  # s


def dsc_run(cycles: Sequence[Parameters], seed: int = 1) -> DscRecord:
    """One heating and one cooling for each cycle, with that cycle's transition temperatures."""
    random = np.random.default_rng(seed)
    segments: list[DscSegment] = []
    for parameters in cycles:
        for sign in (1.0, -1.0):
            segments.append(_scan(parameters, sign, len(segments) + 1, random))
    header = {"Sample ID": "synthetic NiTi wire"}
    path = Path(f"synthetic DSC run of {len(cycles)} cycles")
    return DscRecord(path, SAMPLE_MASS, header, tuple(segments), instrument="synthetic")


def _scan(
    parameters: Parameters, sign: float, number: int, random: np.random.Generator
) -> DscSegment:
    time = np.arange(0.0, (HOTTEST - COLDEST) / RATE, _SCAN_PERIOD)
    temperature = (COLDEST if sign > 0.0 else HOTTEST) + sign * RATE * time
    fraction = heated_fraction if sign > 0.0 else cooled_fraction
    xi = fraction(temperature, 0.0, parameters)
    settled = sign * RATE * (1.0 - np.exp(-time / _START_UP))
    heat = SAMPLE_MASS * (
        parameters["wire.specific_heat"] * settled - LATENT_HEAT * np.gradient(xi, time)
    )
    share = (temperature - COLDEST) / (HOTTEST - COLDEST)
    drift = _DRIFT[0] * share + _DRIFT[1] * share**2
    noise = _HEAT_FLOW_NOISE * random.standard_normal(len(time))
    began = (number - 1) * (HOTTEST - COLDEST) / RATE
    return DscSegment(
        number, "heating" if sign > 0.0 else "cooling", sign * RATE, began + time,
        heat + drift + noise, np.zeros(len(time)), temperature, temperature,
    )


# --- Synthetic isobaric tests: the simulated wire heated and cooled while a load is held (E6,
# Fig. 8).
#
# The frame keeps the force and records the travel; the wire is led through a triangle of
# temperature that is slow against its time constant. Not a measurement: the model behind
# instruments.

_RATE = 0.5  # K/s
_ABOVE_FINISH = 25.0  # K
_FRAME_PERIOD = 0.2  # s
_TEMPERATURE_NOISE = 0.05  # K, a thermocouple in a chamber
_STRAIN_NOISE = 2e-5  # 4 micrometres of traverse on 0.2 m of wire
# Of a cosine ramp the steepest tangent takes 2/pi of its width.
_COSINE_WIDTH = 0.5 * math.pi


def isobaric_test(
    parameters: Parameters, stress: float, name: str, seed: int = 1
) -> IsobaricRecord:
    """One heating and cooling of the wire of `parameters` under a held stress [Pa]."""
    random = np.random.default_rng(seed)
    shift = stress / parameters["wire.stress_influence_austenite"]
    hottest = parameters["wire.austenite_finish_temperature"] + shift + _ABOVE_FINISH
    time, voltage = _triangle(parameters, hottest)
    run = simulate(parameters, time, voltage, boundary=Boundary.held_stress(stress))
    strain = -run.contraction[:, 0] + _STRAIN_NOISE * random.standard_normal(len(time))
    temperature = run.temperature[:, 0] + _TEMPERATURE_NOISE * random.standard_normal(len(time))
    held = np.full(len(time), stress)
    cycles, findings = find_cycles(temperature, strain, held, name)
    return IsobaricRecord(Path(name), name, stress, "1", cycles, tuple(findings))


def upfr_tests(
    parameters: Parameters,
    start: Sequence[float],
    finish: Sequence[float],
) -> tuple[IsobaricRecord, ...]:
    """Repeats of a UPFR test on specimens whose tangents meet at given temperatures.

    Args:
        parameters: the wire; A_s and A_f are replaced for each specimen.
        start, finish: K under the holding force, one a specimen, as tangents tell them. The
            cosine of eq. (10) with these tangents reaches further out at both ends.
    """
    stress = HOLDING_FORCE / wire_section(parameters)
    shift = stress / parameters["wire.stress_influence_austenite"]
    tests = []
    for k, (a_s, a_f) in enumerate(zip(start, finish, strict=True)):
        middle, half = 0.5 * (a_s + a_f) - shift, 0.5 * (a_f - a_s) * _COSINE_WIDTH
        specimen = parameters.replace(
            {
                "wire.austenite_start_temperature": middle - half,
                "wire.austenite_finish_temperature": middle + half,
            }
        )
        tests.append(isobaric_test(specimen, stress, f"synthetic UPFR test {k + 1}", seed=k))
    return tuple(tests)


def _triangle(parameters: Parameters, hottest: float) -> tuple[Array, Array]:
    """Time (n,) s and the voltage (n,) V that eq. (2) asks for a triangle of temperature."""
    ambient = parameters["environment.ambient_temperature"]
    rise = (hottest - ambient) / _RATE
    time = np.arange(0.0, 2.0 * rise, _FRAME_PERIOD)
    above = _RATE * np.minimum(time, 2.0 * rise - time)
    rate = np.where(time < rise, _RATE, -_RATE)
    capacity = parameters["wire.mass"] * parameters["wire.specific_heat"]
    power = np.maximum(heat_loss(parameters) * above + capacity * rate, 0.0)
    return time, np.sqrt(power * parameters["wire.resistance"])


# --- Synthetic tensile tests at constant temperature (E7, Fig. 9).
#
# Austenite follows the package's own law: under load the range of eq. (11) rises until the wire
# turns to martensite, eps = sigma/E(xi) + eps_L xi. Martensite is a test curve, not a model:
# the paper's law starts from detwinned martensite and knows no detwinning, so the curve is an
# elastic rise E_M, a plateau up to 4 % of strain as Fig. 9 is described, and a rise E_M again,
# its corners rounded. Both begin with a toe, as a specimen that is not quite straight gives.

_DETWINNING_STRESS = 130e6  # Pa, assumed: 100 to 200 MPa on NiTi
_DETWINNING_SLOPE = 0.6e9  # Pa, assumed
_LARGEST_STRAIN = 0.06
_TOE = 0.0015
_ROUNDING = 0.0008
_STRESS_NOISE = 0.6e6  # Pa, 0.04 N of a 500 N load cell on a 0.3 mm wire
_POINTS = 1500


def tensile_test(parameters: Parameters, temperature: float, name: str, seed: int) -> TensileRecord:
    """One test of the wire of `parameters`: martensite below M_f, austenite above A_f.

    Args:
        temperature: K.
        name: of the specimen.
    """
    strain = np.linspace(0.0, _LARGEST_STRAIN, _POINTS)
    cold = temperature <= parameters["wire.martensite_finish_temperature"]
    curve = _martensite(parameters) if cold else _austenite(parameters, temperature)
    stress = np.interp(np.maximum(strain - _TOE, 0.0), *_rounded(*curve))
    noise = _STRESS_NOISE * np.random.default_rng(seed).standard_normal(_POINTS)
    phase: Phase = "martensite" if cold else "austenite"
    return TensileRecord(Path(name), strain, stress + noise, temperature, phase=phase)


def _austenite(parameters: Parameters, temperature: float) -> tuple[Array, Array]:
    """Strain and stress (Pa) of eqs. (6), (7), (9), (11) loaded from austenite."""
    stress = np.linspace(0.0, 2e9, 20001)
    xi = cooled_fraction(temperature, stress, parameters)
    transformed = parameters["wire.maximum_recoverable_strain"] * xi
    return stress / modulus(xi, parameters) + transformed, stress


def _martensite(parameters: Parameters) -> tuple[Array, Array]:
    e_m = parameters["wire.martensite_modulus"]
    begins = _DETWINNING_STRESS / e_m
    ends = _DETWINNING_STRESS + _DETWINNING_SLOPE * (DETWINNED_AT - begins)
    last = 2.0 * _LARGEST_STRAIN
    strain = np.array([0.0, begins, DETWINNED_AT, last])
    stress = np.array([0.0, _DETWINNING_STRESS, ends, ends + e_m * (last - DETWINNED_AT)])
    return strain, stress


def _rounded(strain: Array, stress: Array) -> tuple[Array, Array]:
    """The curve with its corners rounded by a moving mean over `_ROUNDING`."""
    fine = np.linspace(0.0, 1.5 * _LARGEST_STRAIN, 20001)
    width = int(_ROUNDING / (fine[1] - fine[0]))
    padded = np.pad(np.interp(fine, strain, stress), width, mode="reflect", reflect_type="odd")
    window = np.ones(2 * width + 1) / (2 * width + 1)
    return fine, np.convolve(padded, window, mode="valid")


COMPOSITE_CHANNELS = ("front_1", "front_2", "back_1", "back_2")
COMPOSITE_SIDES = ("front", "front", "back", "back")
# The paper says that its specimen is stiffer on one side, not by how much.
BACK_STIFFNESS = 3.0
REPEATS = (-1.0, 0.0, 1.0)  # in standard deviations: their sample deviation is 1
_WELL_INSIDE = 15.0  # K beyond M_f or A_f
STRESSES = (10e6, 50e6, 100e6, 150e6, 200e6)


def is_papers_wire(parameters: Parameters) -> bool:
    """Whether the transition temperatures are those of Table II, cycle 2."""
    return all(parameters[name] == DSC_CYCLES[1][symbol] for symbol, name in TRANSITIONS.items())


def wire_rig(parameters: Parameters) -> Parameters:
    """One clamped wire (Fig. 1)."""
    return parameters.replace({
        "bench.channels": ("wire",), "bench.channel_sides": ("front",), "load.kind": "clamped",
    })


def composite_rig(parameters: Parameters) -> Parameters:
    """Four wires, two a side (Figs. 11, 12); the back stiffer unless both are given."""
    rig = parameters.replace({
        "bench.channels": COMPOSITE_CHANNELS, "bench.channel_sides": COMPOSITE_SIDES,
        "load.kind": "beam",
    })
    if "composite.stress_per_deflection_back" in parameters.given:
        return rig
    _, _, back = bending_coefficients(rig)
    return rig.replace({"composite.stress_per_deflection_back": BACK_STIFFNESS * back})


def thermal_records(parameters: Parameters) -> tuple[Record, Record]:
    """E1, E2 (staircase) and E3 (ramps)."""
    wire = wire_rig(parameters)
    return protocol_record("staircase", wire, 1), protocol_record("ramp", wire, 2)


def validation_record(parameters: Parameters) -> Record:
    """E4: triangular voltage."""
    return protocol_record("triangle", wire_rig(parameters), 3)


def dsc_record(parameters: Parameters) -> DscRecord:
    """E5: two heating cycles, of Table II; of another wire both are its own."""
    if not is_papers_wire(parameters):
        return dsc_run([parameters, parameters], 5)
    cycles = [
        parameters.replace({TRANSITIONS[symbol]: value for symbol, value in cycle.items()})
        for cycle in DSC_CYCLES
    ]
    return dsc_run(cycles, 5)


def upfr_records(parameters: Parameters) -> tuple[IsobaricRecord, ...]:
    """E6: three specimens with the paper's mean and deviation; first cycle, as prestrained. Those
    of another wire deviate as much from its own temperatures."""
    wire, means = wire_rig(parameters), (UPFR_START[0], UPFR_FINISH[0])
    if is_papers_wire(parameters):
        wire = wire.replace({TRANSITIONS[end]: DSC_CYCLES[0][end] for end in ("M_s", "M_f")})
    else:
        means = _tangent_ends(wire)
    return upfr_tests(
        wire,
        [means[0] + UPFR_START[1] * k for k in REPEATS],
        [means[1] + UPFR_FINISH[1] * k for k in REPEATS],
    )


def _tangent_ends(wire: Parameters) -> tuple[float, float]:
    """Where the tangents of a heating under the holding force meet, K: start and finish."""
    start = wire["wire.austenite_start_temperature"]
    finish = wire["wire.austenite_finish_temperature"]
    shift = HOLDING_FORCE / wire_section(wire) / wire["wire.stress_influence_austenite"]
    inward = (0.5 - 1.0 / math.pi) * (finish - start)
    return float(start + inward + shift), float(finish - inward + shift)


def isobaric_records(parameters: Parameters) -> tuple[IsobaricRecord, ...]:
    """E9: one test at each of several stresses."""
    wire = wire_rig(parameters)
    return tuple(
        isobaric_test(wire, stress, f"synthetic isobaric test at {stress / 1e6:.0f} MPa", 10 + k)
        for k, stress in enumerate(STRESSES)
    )


def tensile_records(parameters: Parameters) -> tuple[TensileRecord, ...]:
    """E7: three specimens of each phase that deviate as Table III says."""
    tests = []
    for k, deviation in enumerate(REPEATS):
        specimen = parameters.replace(
            {
                name: parameters[name] + deviation * parameters.std(name)
                for name in ("wire.martensite_modulus", "wire.austenite_modulus")
            }
        )
        for phase, kelvin in _test_temperatures(parameters).items():
            name = f"synthetic {phase} {k + 1} at {kelvin:.2f} K"
            tests.append(tensile_test(specimen, kelvin, name, 20 + k))
    return tuple(tests)


def _test_temperatures(parameters: Parameters) -> dict[str, float]:
    """Of Table III, as far as this wire is martensite and austenite there."""
    cold = float(parameters["wire.martensite_finish_temperature"]) - _WELL_INSIDE
    hot = float(parameters["wire.austenite_finish_temperature"]) + _WELL_INSIDE
    return {
        "martensite": min(MARTENSITE_TEST_TEMPERATURE, cold),
        "austenite": max(AUSTENITE_TEST_TEMPERATURE, hot),
    }


def clamped_record(parameters: Parameters) -> Record:
    """E8: temperature staircase below A_s of the clamped wire."""
    return clamped_staircase_record(wire_rig(parameters), seed=30)


def composite_records(parameters: Parameters) -> tuple[Record, Record]:
    """E12: triangular and step voltage."""
    rig = composite_rig(parameters)
    return (
        protocol_record("composite_triangle", rig, 40),
        protocol_record("composite_step", rig, 41),
    )

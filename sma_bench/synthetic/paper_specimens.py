"""The paper's experiments on synthetic specimens: protocols, cycles and repeats as it did them."""

import math

from sma_bench.parameters import Parameters
from sma_bench.parameters.table import (
    AUSTENITE_TEST_TEMPERATURE,
    DSC_CYCLES,
    HOLDING_FORCE,
    MARTENSITE_TEST_TEMPERATURE,
    TRANSITIONS,
    UPFR_FINISH,
    UPFR_START,
)
from sma_bench.physics.bending import bending_coefficients, wire_section
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import IsobaricRecord
from sma_bench.records.record import Record
from sma_bench.records.tensile import TensileRecord
from sma_bench.synthetic.bench_records import clamped_staircase_record, protocol_record
from sma_bench.synthetic.instruments import dsc_run, isobaric_test, tensile_test, upfr_tests

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
    if not is_papers_wire(parameters):
        wire = wire_rig(parameters)
        ends = [_tangent_ends(wire, end) for end in (0, 1)]
        return upfr_tests(
            wire, *(
                [end + deviation * k for k in REPEATS]
                for end, (_, deviation) in zip(ends, (UPFR_START, UPFR_FINISH), strict=True)
            ),
        )
    cooling = {TRANSITIONS[symbol]: DSC_CYCLES[0][symbol] for symbol in ("M_s", "M_f")}
    return upfr_tests(
        wire_rig(parameters).replace(cooling),
        [UPFR_START[0] + UPFR_START[1] * k for k in REPEATS],
        [UPFR_FINISH[0] + UPFR_FINISH[1] * k for k in REPEATS],
    )


def _tangent_ends(wire: Parameters, end: int) -> float:
    """Where the tangents of a heating under the holding force meet, K: start (0) or finish (1)."""
    start, finish = (
        wire[f"wire.austenite_{which}_temperature"] for which in ("start", "finish")
    )
    shift = HOLDING_FORCE / wire_section(wire) / wire["wire.stress_influence_austenite"]
    inward = (0.5 - 1.0 / math.pi) * (finish - start)
    return float((start + inward, finish - inward)[end] + shift)


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

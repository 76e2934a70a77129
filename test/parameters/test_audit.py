"""The audit finds what is wrong with the paper's own numbers, and nothing where all is well."""

import math
from pathlib import Path

import pytest
import yaml

from sma_bench.cli import main
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.audit import audit

PAPER = Parameters.defaults().replace({"wire.thermal_expansion_factor": 23.91e6})
H, CP = "wire.heat_transfer_coefficient", "wire.specific_heat"
SOUND = Parameters.defaults().replace({"wire.mass": 6450.0 * math.pi * 0.3e-3**2 / 4 * 0.2,
                                       "wire.surface_area": math.pi * 0.3e-3 * 0.2, H: 68.0,
                                       CP: 450.0, "wire.martensite_start_temperature": 330.0,
                                       "wire.martensite_finish_temperature": 318.0,
                                       "bench.maximum_voltage": 8.0})  # fmt: skip
FORCE = {"load.kind": "force", "load.force": 5.0}
AUDITED = yaml.safe_load(Path(__file__).with_name("audited.yaml").read_text())


def by_subject(parameters):
    return {finding.subject: finding for finding in audit(parameters)}


def test_what_is_wrong_with_the_papers_numbers_is_found_and_others_are_judged_anew():
    found = by_subject(PAPER)
    for subject, number, value, near in AUDITED["errata"]:
        assert found[subject].severity == "warning"
        assert found[subject].numbers[number] == pytest.approx(value, abs=near)
    resistivity = found["resistivity"].numbers["resistivity_from_mass_length"]
    assert resistivity * 1e8 == pytest.approx(95, abs=1)
    for changed, subject, said in AUDITED["judged"]:
        assert said in by_subject(PAPER.replace(changed))[subject].text
    leads = by_subject(PAPER.replace({"bench.lead_resistance": 1.0}))
    assert leads["current"].severity == "info"
    # A held force is compared with the stress that a wire can carry.
    held = by_subject(PAPER.replace(FORCE))["force"]
    assert held.severity == "info" and "force" not in found
    assert held.numbers["stress"] == pytest.approx(5.0 / (math.pi * 0.15e-3**2))
    # A weight too small to stretch the cold wire may be one in kg.
    light = by_subject(PAPER.replace(FORCE | {"load.force": 0.5}))["force"]
    assert light.severity == "warning" and "in kg, it is 4.91 N" in light.text


def test_numbers_that_fit_each_other_raise_no_warning():
    assert [str(finding) for finding in audit(SOUND) if finding.severity != "info"] == []


def test_a_gauge_length_and_swapped_moduli_are_found():
    stated = {"wire.length": 0.2, "wire.martensite_modulus": 28e9, "wire.austenite_modulus": 60e9}
    sound = by_subject(SOUND.replace(stated))
    assert "wire.length is 0.200 m: they agree" in sound["wire length"].text
    assert sound["moduli"].severity == "info"
    half = by_subject(SOUND.replace({"wire.length": 0.1}))["wire length"]
    assert half.severity == "warning" and "wire.length is 0.100 m" in half.text
    swapped = {"wire.martensite_modulus": 60e9, "wire.austenite_modulus": 28e9}
    moduli = by_subject(SOUND.replace(swapped))["moduli"]
    assert moduli.severity == "warning" and "swapped" in moduli.text


def test_the_papers_own_numbers_are_one_line_unless_asked_for(capsys, tmp_path):
    brief = audit(PAPER, papers_own=False)
    assert [f.subject for f in brief] == ["thermal expansion", "the paper's numbers"]
    assert "heat transfer" in brief[-1].text and brief[-1].severity == "info"
    # A default that does not suit another wire is named as one.
    other = by_subject(Parameters({"wire.diameter": 0.25e-3, "wire.length": 0.2}))
    assert "not stated" in other["heat transfer"].text and "not stated" in other["resistivity"].text
    half = Parameters({f"wire.austenite_{end}_temperature": 340.0 + (end == "finish")
                       for end in ("start", "finish")})
    assert "not stated: wire.martensite_start" in by_subject(half)["transition order"].text
    file = tmp_path / "lab.yaml"
    write_parameters(file, PAPER)
    for arguments, told in (([str(file)], False), ([str(file), "--paper"], True), ([], True)):
        assert main(["audit", *arguments]) == 0
        assert ("Churchill" in capsys.readouterr().out) == told

"""The audit finds what is wrong with the paper's own numbers, and nothing where all is well."""

import math

import pytest

from sma_bench.cli import main
from sma_bench.parameters import Parameters, audit, write_parameters

PAPER = Parameters.defaults().replace({"wire.thermal_expansion_factor": 23.91e6})
SOUND = Parameters.defaults().replace(
    {
        "wire.mass": 6450.0 * math.pi * 0.3e-3**2 / 4 * 0.2,
        "wire.surface_area": math.pi * 0.3e-3 * 0.2,
        "wire.heat_transfer_coefficient": 68.0,
        "wire.specific_heat": 450.0,
        "wire.martensite_start_temperature": 330.0,
        "wire.martensite_finish_temperature": 318.0,
        "bench.maximum_voltage": 8.0,
    }
)
# Subject, its number, and that number of the paper's wire: all of these are warnings.
ERRATA = [
    ("wire length", "length_from_mass", pytest.approx(0.200, abs=5e-4)),
    ("wire length", "length_from_area", pytest.approx(0.420, abs=5e-4)),
    ("wire length", "heat_transfer_coefficient_for_length_from_mass", pytest.approx(847, abs=2)),
    ("heat transfer", "still_air_low", pytest.approx(55, abs=1)),
    ("heat transfer", "still_air_high", pytest.approx(69, abs=1)),
    ("time constant", "time_constant", pytest.approx(0.196, abs=1e-3)),
    ("transition order", "overlap", pytest.approx(353.39 - 331.81)),
    ("thermal expansion", "factor", pytest.approx(23.91 / (11e-6 * 55.4e3), rel=1e-6)),
    ("specific heat", "factor", pytest.approx(343.2 / 400)),
    ("current", "current", pytest.approx(10.0 / 2.6987)),
    ("current", "largest_voltage", pytest.approx(8.0961)),
]
FORCE = {"load.kind": "force", "load.force": 1.0}
# Changes of the paper's numbers, and what is then said of a subject.
JUDGED = [
    ({}, "resistivity", "wire.mass (fits)"),
    ({}, "resistivity", "wire.area (does not fit)"),
    ({}, "thermal expansion", "other sign"),
    ({"wire.specific_heat": 900.0}, "specific heat", "times the highest"),
    (FORCE | {"load.force": 30.0}, "force", "lasts few cycles"),
    (FORCE | {"load.kind": "spring", "load.stiffness": 10e3}, "force", "slips"),
]


def by_subject(parameters):
    return {finding.subject: finding for finding in audit(parameters)}


def test_what_is_wrong_with_the_papers_numbers_is_found_and_others_are_judged_anew():
    found = by_subject(PAPER)
    for subject, number, value in ERRATA:
        assert found[subject].severity == "warning"
        assert found[subject].numbers[number] == value
    resistivity = found["resistivity"].numbers["resistivity_from_mass_length"]
    assert resistivity * 1e8 == pytest.approx(95, abs=1)
    for changed, subject, said in JUDGED:
        assert said in by_subject(PAPER.replace(changed))[subject].text
    leads = by_subject(PAPER.replace({"bench.lead_resistance": 1.0}))
    assert leads["current"].severity == "info"
    # A held force is set against the stress that a wire bears.
    held = by_subject(PAPER.replace(FORCE))["force"]
    assert held.severity == "info" and "force" not in found
    assert held.numbers["stress"] == pytest.approx(1.0 / (math.pi * 0.15e-3**2))


def test_numbers_that_fit_each_other_raise_no_warning():
    assert [str(finding) for finding in audit(SOUND) if finding.severity != "info"] == []


def test_suggestions_are_held_against_everything_they_change():
    """A camera that reads low scales h and c_p alike: it mends h, but neither the time constant
    nor c_p, which it puts further off."""
    finding = by_subject(PAPER)["heat transfer explained"]
    first = finding.text.split("; ")[0]
    assert first.startswith("a temperature read low by a factor")
    assert "mends heat transfer and leaves time constant and specific heat" in first
    assert "moving air" in finding.text and "leave specific heat" in finding.text
    assert "heat transfer explained" not in by_subject(SOUND)
    # A camera that reads low alone, on a wire that is sound: all is mended.
    low = SOUND.replace(
        {
            "wire.heat_transfer_coefficient": 68.0 * 3.0,
            "wire.specific_heat": 450.0 * 3.0,
        }
    )
    (mended,) = [
        t for t in by_subject(low)["heat transfer explained"].text.split("; ") if "read low" in t
    ]
    assert "mends heat transfer, time constant and specific heat and leaves nothing" in mended


def test_the_papers_own_numbers_are_one_line_unless_asked_for(capsys, tmp_path):
    brief = audit(PAPER, papers_own=False)
    assert [f.subject for f in brief] == ["thermal expansion", "the paper's numbers"]
    assert "heat transfer" in brief[-1].text and brief[-1].severity == "info"
    file = tmp_path / "lab.yaml"
    write_parameters(file, PAPER)
    for arguments, told in (([str(file)], False), ([str(file), "--paper"], True), ([], True)):
        assert main(["audit", *arguments]) == 0
        assert ("Churchill" in capsys.readouterr().out) == told

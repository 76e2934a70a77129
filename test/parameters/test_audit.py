"""The audit finds what is wrong with the paper's own numbers, and nothing where all is well."""

import math

import pytest

from sma_bench.cli import main
from sma_bench.parameters import Parameters, audit, write_parameters
from sma_bench.parameters.audit import natural_convection, radiation

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


def by_subject(parameters):
    return {finding.subject: finding for finding in audit(parameters)}


def test_the_papers_wire_lengths_clash_by_a_factor_of_two():
    finding = by_subject(PAPER)["wire length"]
    assert finding.severity == "warning"
    assert finding.numbers["length_from_mass"] == pytest.approx(0.200, abs=5e-4)
    assert finding.numbers["length_from_area"] == pytest.approx(0.420, abs=5e-4)
    h = finding.numbers["heat_transfer_coefficient_for_length_from_mass"]
    assert h == pytest.approx(847, abs=2)


def test_the_papers_resistance_fits_the_length_of_its_mass():
    finding = by_subject(PAPER)["resistivity"]
    assert finding.numbers["resistivity_from_mass_length"] * 1e8 == pytest.approx(95, abs=1)
    assert "wire.mass (fits)" in finding.text
    assert "wire.area (does not fit)" in finding.text


def test_the_papers_heat_transfer_is_several_times_still_air():
    finding = by_subject(PAPER)["heat transfer"]
    assert finding.severity == "warning"
    assert 55 < finding.numbers["still_air_low"] < finding.numbers["still_air_high"] < 85
    assert finding.numbers["factor"] == pytest.approx(403.26 / finding.numbers["still_air_high"])


def test_the_papers_time_constant_is_too_fast():
    finding = by_subject(PAPER)["time constant"]
    assert finding.numbers["time_constant"] == pytest.approx(0.196, abs=1e-3)
    assert finding.severity == "warning"


def test_the_papers_transition_temperatures_overlap():
    finding = by_subject(PAPER)["transition order"]
    assert finding.severity == "warning"
    assert finding.numbers["overlap"] == pytest.approx(353.39 - 331.81)


def test_the_printed_thermal_expansion_factor_has_wrong_size_and_sign():
    finding = by_subject(PAPER)["thermal expansion"]
    assert finding.severity == "warning"
    assert "other sign" in finding.text
    assert finding.numbers["factor"] == pytest.approx(23.91 / (11e-6 * 55.4e3), rel=1e-6)


def test_numbers_that_fit_each_other_raise_no_warning():
    assert [str(finding) for finding in audit(SOUND) if finding.severity != "info"] == []


def test_the_papers_specific_heat_is_low():
    finding = by_subject(PAPER)["specific heat"]
    assert finding.severity == "warning" and finding.numbers["factor"] == pytest.approx(343.2 / 400)
    high = by_subject(PAPER.replace({"wire.specific_heat": 900.0}))["specific heat"]
    assert "times the highest" in high.text


def test_ten_volts_over_the_papers_wire_are_more_than_three_amperes():
    finding = by_subject(PAPER)["current"]
    assert finding.severity == "warning"
    assert finding.numbers["current"] == pytest.approx(10.0 / 2.6987)
    assert finding.numbers["largest_voltage"] == pytest.approx(8.0961)
    leads = PAPER.replace({"bench.lead_resistance": 1.0})
    assert by_subject(leads)["current"].severity == "info"


def test_a_held_force_is_set_against_the_stress_that_a_wire_bears():
    newton = PAPER.replace({"load.kind": "force", "load.force": 1.0})
    finding = by_subject(newton)["force"]
    assert finding.severity == "info"
    assert finding.numbers["stress"] == pytest.approx(1.0 / (math.pi * 0.15e-3**2))
    heavy = newton.replace({"load.force": 30.0})
    assert "lasts few cycles" in by_subject(heavy)["force"].text
    spring = newton.replace({"load.kind": "spring", "load.stiffness": 10e3})
    assert "slips" in by_subject(spring)["force"].text
    assert "force" not in by_subject(PAPER)


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
    low = SOUND.replace({
        "wire.heat_transfer_coefficient": 68.0 * 3.0, "wire.specific_heat": 450.0 * 3.0})
    (mended,) = [t for t in by_subject(low)["heat transfer explained"].text.split("; ")
                 if "read low" in t]
    assert "mends heat transfer, time constant and specific heat and leaves nothing" in mended


def test_the_papers_own_numbers_are_one_line_unless_asked_for(capsys, tmp_path):
    lab = Parameters.defaults().replace({"wire.thermal_expansion_factor": 23.91e6})
    brief = audit(lab, papers_own=False)
    assert [f.subject for f in brief] == ["thermal expansion", "the paper's numbers"]
    assert "heat transfer" in brief[-1].text and brief[-1].severity == "info"
    file = tmp_path / "lab.yaml"
    write_parameters(file, lab)
    assert main(["audit", str(file)]) == 0
    assert "Churchill" not in capsys.readouterr().out
    assert main(["audit", str(file), "--paper"]) == 0
    assert "Churchill" in capsys.readouterr().out
    assert main(["audit"]) == 0
    assert "Churchill" in capsys.readouterr().out


def test_churchill_chu_on_a_thin_wire_in_still_air():
    # 57 to 70 W/(m2 K) for a 0.3 mm wire, between 30 and 90 K above the room.
    assert natural_convection(0.3e-3, 326.15, 296.15) == pytest.approx(62, abs=5)
    assert natural_convection(0.3e-3, 386.15, 296.15) == pytest.approx(70, abs=5)


def test_radiation_of_a_black_wire_at_small_differences_is_four_sigma_t_cubed():
    expected = 4 * 5.670e-8 * 300.0**3
    assert radiation(1.0, 300.01, 299.99) == pytest.approx(expected, rel=1e-6)

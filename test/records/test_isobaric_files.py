"""Reading isobaric and tensile instrument files, good and bad."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.identify.instruments.tensile import identify_tensile
from sma_bench.parameters import Parameters
from sma_bench.records import open_record
from sma_bench.records.isobaric import IsobaricRecord, find_cycles, read_isobaric, without_spikes
from sma_bench.records.tensile import TensileRecord, read_tensile


def loop(points: int = 60, step: float = 0.03) -> np.ndarray:
    """(n, 3) degC, strain, MPa of one cycle from 20 to 100 degC and back."""
    up = np.linspace(20.0, 100.0, points)
    fall = step / (1.0 + np.exp((up - 70.0) / 2.0))
    rise = step / (1.0 + np.exp((up - 50.0) / 2.0))
    t = np.concatenate([up, up[::-1]])
    return np.column_stack([t, np.concatenate([fall, rise[::-1]]), np.full(2 * points, 100.0)])


def write(folder: Path, rows: np.ndarray, separator: str = "\t", name: str = "100 MPa.txt") -> Path:
    path = folder / name
    path.write_text("\n".join(separator.join(f"{v:.9e}" for v in row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize("separator", ["\t", " ", ",", ";", "   "])
def test_three_columns_are_read_with_any_separator(tmp_path: Path, separator: str) -> None:
    record = read_isobaric(write(tmp_path, loop(), separator))
    assert record.stress == pytest.approx(100e6)
    (cycle,) = record.cycles
    assert [b.direction for b in cycle.branches] == ["heating", "cooling"]
    assert cycle.branches[0].temperature[0] == pytest.approx(293.15)
    assert cycle.branches[0].strain[0] == pytest.approx(0.03, rel=1e-6)


def test_unit_comes_from_the_note_beside_the_file(tmp_path: Path) -> None:
    rows = loop()
    rows[:, 1] *= 100.0
    (tmp_path / "Data Source.txt").write_text("Units\nStress = MPa\nStrain = %\n")
    record = read_isobaric(write(tmp_path, rows))
    assert np.ptp(record.cycles[0].branches[0].strain) == pytest.approx(0.03, rel=1e-3)
    assert record.findings == ()


def test_inferred_unit_is_said(tmp_path: Path) -> None:
    rows = loop()
    rows[:, 1] *= 100.0
    record = read_isobaric(write(tmp_path, rows))
    assert np.ptp(record.cycles[0].branches[0].strain) == pytest.approx(0.03, rel=1e-3)
    assert "taken as %" in record.findings[0].text


def test_wrong_unit_is_remarked(tmp_path: Path) -> None:
    rows = loop()
    rows[:, 1] *= 100.0
    record = read_isobaric(write(tmp_path, rows), strain_unit="mm/mm")
    assert any("is the unit percent?" in f.text for f in record.findings)


def test_unknown_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unit of strain is 'furlong'"):
        read_isobaric(write(tmp_path, loop()), strain_unit="furlong")


@pytest.mark.parametrize(
    ("bad", "line"),
    [("20.0\t0.01", 31), ("20.0\tabc\t100.0", 31), ("20.0\tnan\t100.0", 31)],
)
def test_malformed_line_is_named(tmp_path: Path, bad: str, line: int) -> None:
    path = write(tmp_path, loop())
    lines = path.read_text().splitlines()
    lines.insert(line - 1, bad)
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=rf"100 MPa.txt: line {line}"):
        read_isobaric(path)


def test_temperature_below_absolute_zero_is_named(tmp_path: Path) -> None:
    rows = loop()
    rows[7, 0] = -300.0
    with pytest.raises(InputError, match="line 8: temperature -26.85 K"):
        read_isobaric(write(tmp_path, rows))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "no columns of numbers"),
        ("just words\nand more\n", "no columns of numbers"),
        ("1\t2\t3\n" * 5, "5 rows of numbers, expected 20"),
        ("20.0\t0.01\t100.0\n" * 50, "strain is 0.01 throughout"),
        ("20.0\t0.01\n" * 50, "2 columns without titles"),
    ],
)
def test_what_is_no_test_is_refused_in_one_line(
    tmp_path: Path, content: str, message: str
) -> None:
    path = tmp_path / "x.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        read_isobaric(path)
    assert "\n" not in str(caught.value)


def test_test_without_a_cycle_is_refused(tmp_path: Path) -> None:
    rows = loop()
    rows[:, 0] = 20.0 + 0.01 * np.arange(len(rows))
    with pytest.raises(InputError, match="temperature changes by 1.19 K"):
        read_isobaric(write(tmp_path, rows))


def test_absent_and_binary_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_isobaric(tmp_path / "absent.txt")
    path = tmp_path / "binary.txt"
    path.write_bytes(b"\x00\x01\x02" * 100)
    with pytest.raises(InputError, match="expected a text file"):
        read_isobaric(path)


def test_titles_with_units_and_gauge_length_give_strain(tmp_path: Path) -> None:
    rows = loop()
    path = tmp_path / "frame.csv"
    body = "\n".join(f'"{t:.3f},{e * 50.0:.6f},{s:.3f}"' for t, e, s in rows)
    path.write_text('"Sample,""x"""\n\n"Temp (C),""Extension (mm)"",""Stress (MPa)"""\n\n' + body)
    record = read_isobaric(path, gauge_length=0.05)
    assert record.strain_unit == "1"
    assert np.ptp(record.cycles[0].branches[0].strain) == pytest.approx(0.03, rel=1e-3)
    relative = read_isobaric(path)
    assert relative.strain_unit == "relative"
    assert any("without a gauge length" in f.text for f in relative.findings)


def test_several_cycles_are_paired(tmp_path: Path) -> None:
    rows = np.vstack([loop(), loop(), loop()])
    cycles = read_isobaric(write(tmp_path, rows)).cycles
    assert [c.number for c in cycles] == [1, 2, 3]
    assert all([b.direction for b in c.branches] == ["heating", "cooling"] for c in cycles)


def test_noise_makes_no_cycles(tmp_path: Path) -> None:
    rows = loop(300)
    rows[:, 0] += 0.5 * np.random.default_rng(1).standard_normal(len(rows))
    (cycle,) = read_isobaric(write(tmp_path, rows)).cycles
    assert len(cycle.branches) == 2


def test_single_spike_is_left_out_but_corner_and_step_stay() -> None:
    t = np.concatenate([np.linspace(20.0, 100.0, 100), np.linspace(99.0, 30.0, 60)])
    t[120:] -= 15.0
    clean, _ = without_spikes(t)
    assert clean.all()
    t[40] += 9.0
    good, heights = without_spikes(t)
    assert np.flatnonzero(~good).tolist() == [40]
    assert heights[0] == pytest.approx(9.0, abs=1.0)


def test_loading_before_the_cycle_is_left_out(tmp_path: Path) -> None:
    rows = loop()
    ramp = np.column_stack([np.full(30, 20.0), np.full(30, 0.03), np.linspace(0.0, 95.0, 30)])
    record = read_isobaric(write(tmp_path, np.vstack([ramp, rows])))
    assert any("loading" in f.text for f in record.findings)
    assert record.cycles[0].branches[0].stress.min() > 90e6


@settings(max_examples=60, deadline=None)
@given(
    turns=st.lists(st.floats(30.0, 100.0), min_size=2, max_size=6),
    noise=st.floats(0.0, 0.5),
)
def test_branches_run_their_way_and_cover_what_they_say(turns: list[float], noise: float) -> None:
    path = [20.0]
    for i, turn in enumerate(turns):
        path.append(120.0 + turn if i % 2 == 0 else 20.0)
    t = np.concatenate([np.linspace(a, b, 50) for a, b in zip(path[:-1], path[1:], strict=True)])
    t = t + 273.15 + noise * np.random.default_rng(0).standard_normal(len(t))
    cycles, _ = find_cycles(t, np.arange(len(t)) * 1.0, np.ones(len(t)), "x")
    for cycle in cycles:
        directions = [b.direction for b in cycle.branches]
        assert len(directions) == len(set(directions))
        for b in cycle.branches:
            rises = b.temperature[-1] > b.temperature[0]
            assert rises == (b.direction == "heating")
            assert np.all(np.diff(b.strain) > 0.0)


def tensile(folder: Path, header: str, columns: np.ndarray, above: str = "") -> Path:
    path = folder / "pull.csv"
    rows = "\n".join(",".join(f"{v:.6g}" for v in row) for row in columns)
    path.write_text(f"{above}{header}\n{rows}\n")
    return path


def test_tensile_file_with_strain_and_stress(tmp_path: Path) -> None:
    columns = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 400, 50)])
    above = "Test temperature: 130 °C\n"
    record = read_tensile(tensile(tmp_path, "Strain (%),Stress (MPa)", columns, above))
    assert record.strain[-1] == pytest.approx(0.02)
    assert record.stress[-1] == pytest.approx(400e6)
    assert record.temperature == pytest.approx(403.15)


def test_tensile_file_with_force_is_divided_by_what_the_specimen_measures(tmp_path: Path) -> None:
    columns = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 30, 50)])
    path = tensile(tmp_path, "Extension (mm),Load (N)", columns)
    record = read_tensile(path)
    assert record.is_extension and record.is_force
    assert record.strain[-1] == pytest.approx(2e-3) and record.stress[-1] == pytest.approx(30.0)
    with pytest.raises(InputError, match="elongation instead of strain, give wire.length"):
        identify_tensile([record], phases={"*": "martensite"})
    of_wire = Parameters({"wire.length": 0.1})
    with pytest.raises(InputError, match="force instead of stress, give wire.diameter"):
        identify_tensile([record], of_wire, phases={"*": "martensite"})
    of_wire = of_wire.replace({"wire.diameter": 0.3e-3})
    found = identify_tensile([record], of_wire, phases={"*": "martensite"})
    modulus = 30.0 / (np.pi / 4.0 * 0.09e-6) / 0.02
    assert found.estimates["wire.martensite_modulus"].value == pytest.approx(modulus)
    record = read_tensile(path, gauge_length=0.1, area=7.07e-8)
    assert record.strain[-1] == pytest.approx(0.02)
    assert record.stress[-1] == pytest.approx(30.0 / 7.07e-8)
    assert record.temperature is None


def test_files_are_told_apart_by_their_content(tmp_path: Path) -> None:
    columns = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 400, 50)])
    pull = tensile(tmp_path, "Strain (%),Stress (MPa)", columns)
    heat = write(tmp_path, loop())
    words = tmp_path / "words.txt"
    words.write_text("no numbers here\n")
    assert isinstance(open_record(pull), TensileRecord)
    assert isinstance(open_record(heat), IsobaricRecord)
    with pytest.raises(InputError, match="neither a bag"):
        open_record(words)


def test_tensile_file_with_wrong_unit_is_named(tmp_path: Path) -> None:
    columns = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 400, 50)])
    with pytest.raises(InputError, match="line 51: strain 2 in SI units"):
        read_tensile(tensile(tmp_path, "Strain (mm/mm),Stress (MPa)", columns))
    with pytest.raises(InputError, match="no column of stress"):
        read_tensile(tensile(tmp_path, "Strain (%),Stress (furlong)", columns))


def test_all_isobaric_sets_are_read(measured_data: Path) -> None:
    folder = measured_data / "sma_react" / "input"
    directions = {"cal_sample_1": ["cooling", "heating"], "cal_sample_2": ["heating", "cooling"]}
    for sample, expected in directions.items():
        for path in sorted((folder / sample).glob("*MPa.txt")):
            record = read_isobaric(path)
            assert record.stress == pytest.approx(float(path.stem.split()[0]) * 1e6, rel=0.01)
            assert [b.direction for b in record.cycles[0].branches] == expected
            assert max(np.ptp(b.strain) for b in record.cycles[0].branches) < 0.04
            assert record.findings == ()


def test_seven_cycles_of_the_load_frame_are_found(measured_data: Path) -> None:
    path = measured_data / "sma_react/input/preprocessor_samples/isobaric_7cycle.txt"
    record = read_isobaric(path)
    assert len(record.cycles) == 7
    assert all(len(c.branches) == 2 for c in record.cycles)
    assert record.strain_unit == "relative"
    texts = " ".join(f.text for f in record.findings)
    assert "more than any NiTi endures" in texts
    assert "537 rows of loading" in texts
    scaled = read_isobaric(path, gauge_length=0.4)
    assert scaled.strain_unit == "1"
    assert scaled.cycles[0].branches[0].strain.max() == pytest.approx(0.0555, rel=0.02)

"""Isobaric and tensile tests of instruments' files, good and bad."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.identify.tensile import identify_tensile
from sma_bench.parameters import Parameters
from sma_bench.records import open_record
from sma_bench.records.instruments import IsobaricRecord, TensileRecord, find_cycles
from sma_bench.records.open import open_records


def loop(points=60, step=0.03):
    """(n, 3) degC, strain, MPa of one cycle from 20 to 100 degC and back."""
    up = np.linspace(20.0, 100.0, points)
    fall, rise = (step / (1.0 + np.exp((up - middle) / 2.0)) for middle in (70.0, 50.0))
    strain = np.concatenate([fall, rise[::-1]])
    return np.column_stack([np.concatenate([up, up[::-1]]), strain, np.full(2 * points, 100.0)])


def in_percent(rows):
    return rows * (1.0, 100.0, 1.0)


@pytest.fixture
def write(tmp_path):
    """Writes rows as text below a head: write(rows, head, separator)."""

    def write(rows, head="", separator=",", name="100 MPa.txt"):
        path = tmp_path / name
        lines = [separator.join(f"{v:.9e}" for v in row) for row in rows]
        path.write_text("\n".join([*head.splitlines(), *lines]) + "\n")
        return path

    return write


def heights(record):
    """Range of strain of the branches of the first cycle."""
    return [np.ptp(branch.strain) for branch in record.cycles[0].branches]


@pytest.mark.parametrize("separator", ["\t", "   "])
def test_three_columns_are_read_with_any_separator(write, separator):
    record = open_record(write(loop(), "", separator))
    assert record.stress == pytest.approx(100e6)
    (cycle,) = record.cycles
    assert [b.direction for b in cycle.branches] == ["heating", "cooling"]
    assert cycle.branches[0].temperature[0] == pytest.approx(293.15)
    assert cycle.branches[0].strain[0] == pytest.approx(0.03, rel=1e-6)


def test_units_come_from_titles_or_a_note_or_of_strain_its_span_else_are_asked(write, tmp_path):
    guessed = open_record(write(in_percent(loop())))
    assert "taken as %" in guessed.findings[0].text
    bare = open_record(write(loop(), "Temperature (C),Strain,Stress (MPa)"))
    assert "taken as mm/mm" in bare.findings[0].text and bare.stress == 100e6
    for titles, name in (("Temperature,Strain,Stress (MPa)", "Temperature"),
                         ("Temperature (C),Strain,Stress", "Stress")):  # fmt: skip
        with pytest.raises(InputError, match=f"{name} has no unit, values are .*: which one"):
            open_record(write(loop(), titles))
    for other, said in ((loop() + (273.15, 0.0, 0.0), "begins at 29.*: in degC or K"),
                        (loop() * (1.0, 1.0, 1e3), "stress is 1e.05: in MPa")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            open_record(write(other))
    # Of an extension without a gauge length only the shape is known.
    head = '"Sample"\n\n"Temp (C)","Extension (mm)","Stress (MPa)"'
    elongated = write(loop() * (1.0, 50.0, 1.0), head)
    relative = open_record(elongated)
    assert relative.strain_unit == "relative"
    assert any("without a gauge length" in f.text for f in relative.findings)
    scaled = open_record(elongated, stated={"gauge_length": 0.05})
    (tmp_path / "Data Source.txt").write_text("Units\nStress = MPa\nStrain = %\n")
    noted = open_record(write(in_percent(loop())))
    assert noted.findings == ()
    for record in (guessed, bare, scaled, noted):
        assert record.strain_unit == "1"
        assert heights(record) == pytest.approx([0.03, 0.03], rel=1e-3)
    wrong = open_record(write(in_percent(loop()), "Temperature (C),Strain (mm/mm),Stress (MPa)"))
    assert any("is the unit percent?" in f.text for f in wrong.findings)
    (tmp_path / "Data Source.txt").write_text("Strain = furlong\n")
    with pytest.raises(InputError, match="unit of strain is 'furlong'"):
        open_record(write(loop()))
    pulled = np.linspace(0, 6, 60)
    with pytest.raises(InputError, match="Strain has no unit, values are 0 to 6: which one"):
        open_record(write(np.column_stack([pulled, 80 * pulled]), "Strain,Stress (MPa)"))


TITLES = "Temperature (C),Strain (%),Stress (MPa)"
FLAT = np.column_stack([20.0 + 0.01 * np.arange(120), loop()[:, 1:]])
COLD = np.where(np.arange(360).reshape(120, 3) == 21, -300.0, loop())


@pytest.mark.parametrize(("content", "said"), [
    ("", "no columns of numbers"), ("just words\nand more\n", "no columns of numbers"),
    (b"\x00\x01\x02" * 100, "expected a text file"), (None, "no such file"),
    ("1\t2\t3\n" * 5, "3 columns without titles"),
    (f"{TITLES}\n20,1,9\n90,2,9\n20,1,9\n", "3 rows of numbers, expected 20"),
    (f"{TITLES}\n" + "20,0.01,100\n90,0.01,100\n" * 50, "is 0.01 throughout"),
    ("20.0\t0.01\n" * 50, "2 columns without titles"), (FLAT, "3 columns without titles"),
    (COLD, "line 8: temperature -26.85 K"), ("20.0,0.01", "100 MPa.txt: line 31"),
    ("20.0,abc,100.0", "100 MPa.txt: line 31"), ("20.0,nan,100.0", "100 MPa.txt: line 31"),
    *((f"{TITLES[:-5]}{unit}\n" + "20,1,90\n90,2,90\n20,3,90\n" * 50, "of Stress.* is not known")
      for unit in ("(mPa)", "(MPa) /10", "[x10 MPa]")),
    *((f"{titles}\n" + "20,1\n90,2\n20,3\n" * 50, f"no {what} column") for titles, what in (
        ("Temperature (C),Strain (%)", "stress"), ("Strain (%),time (s)", "stress"),
        ("Stress (MPa),time (s)", "strain"),
    )),
], ids=lambda value: value if isinstance(value, str) and " " in value else "")  # fmt: skip
def test_what_is_no_test_is_refused_in_one_line(write, content, said):
    path = write(content if isinstance(content, np.ndarray) else loop())
    if content is None:
        path.unlink()
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, str) and "line" in said:
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines[:30], content, *lines[30:]]))
    elif isinstance(content, str):
        path.write_text(content)
    with pytest.raises(InputError, match=said) as caught:
        open_record(path)
    assert "\n" not in str(caught.value)


def test_cycles_are_paired_noise_makes_none_and_loading_is_left_out(write):
    cycles = open_record(write(np.vstack([loop()] * 3))).cycles
    assert [c.number for c in cycles] == [1, 2, 3]
    assert all([b.direction for b in c.branches] == ["heating", "cooling"] for c in cycles)
    noisy = loop(300)
    noisy[:, 0] += 0.5 * np.random.default_rng(1).standard_normal(len(noisy))
    (cycle,) = open_record(write(noisy)).cycles
    assert len(cycle.branches) == 2
    ramp = np.column_stack([np.full(30, 20.0), np.full(30, 0.03), np.linspace(0.0, 95.0, 30)])
    loaded = open_record(write(np.vstack([ramp, loop()])))
    assert any("loading" in f.text for f in loaded.findings)
    assert loaded.cycles[0].branches[0].stress.min() > 90e6


@settings(max_examples=30, deadline=None)
@given(turns=st.lists(st.floats(30.0, 100.0), min_size=2, max_size=6),
       noise=st.floats(0.0, 0.5))  # fmt: skip
def test_branches_run_their_way_and_cover_what_they_say(turns, noise):
    ends = [20.0, *(120.0 + turn if i % 2 == 0 else 20.0 for i, turn in enumerate(turns))]
    t = np.concatenate([np.linspace(a, b, 50) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    t = t + 273.15 + noise * np.random.default_rng(0).standard_normal(len(t))
    cycles, _ = find_cycles(t, np.arange(len(t)) * 1.0, np.ones(len(t)), "x")
    for cycle in cycles:
        directions = [b.direction for b in cycle.branches]
        assert len(directions) == len(set(directions))
        for b in cycle.branches:
            rises = b.temperature[-1] > b.temperature[0]
            assert rises == (b.direction == "heating")
            assert np.all(np.diff(b.strain) > 0.0)


STRETCHED = np.column_stack([np.linspace(0, 2, 50), np.linspace(0, 400, 50)])


def test_tensile_file_with_strain_and_stress_and_files_told_apart_by_content(write):
    heated, pulled = write(loop()), write(STRETCHED, "Strain (%),Stress (MPa)", name="pull.csv")
    assert isinstance(open_record(heated), IsobaricRecord)
    assert isinstance(open_record(pulled), TensileRecord)
    head = "Test temperature: 130 °C\nStrain (%),Stress (MPa)"
    record = open_record(write(STRETCHED, head))
    assert record.strain[-1] == pytest.approx(0.02)
    assert record.stress[-1] == pytest.approx(400e6)
    assert record.temperature == pytest.approx(403.15)
    for head, said in (
        ("Strain (mm/mm),Stress (MPa)", "line 51: strain 2 in SI units"),
        ("Strain (%),Stress (furlong)", "no stress column"),
    ):
        with pytest.raises(InputError, match=said):
            open_record(write(STRETCHED, head))


def test_tensile_file_with_force_is_divided_by_what_the_specimen_measures(write):
    path = write(STRETCHED * (1.0, 0.075), "Extension (mm),Load (N)")
    record = open_record(path)
    assert record.is_extension and record.is_force and record.temperature is None
    assert record.strain[-1] == pytest.approx(2e-3) and record.stress[-1] == pytest.approx(30.0)
    cold = {"*": "martensite"}
    with pytest.raises(InputError, match="elongation instead of strain, give wire.length"):
        identify_tensile([record], phases=cold)
    of_wire = Parameters({"wire.length": 0.1})
    with pytest.raises(InputError, match="force instead of stress, give wire.diameter"):
        identify_tensile([record], of_wire, phases=cold)
    found = identify_tensile([record], of_wire.replace({"wire.diameter": 0.3e-3}), phases=cold)
    modulus = 30.0 / (np.pi / 4.0 * 0.09e-6) / 0.02
    assert found.estimates["wire.martensite_modulus"].value == pytest.approx(modulus)
    record = open_record(path, stated={"gauge_length": 0.1, "area": 7.07e-8})
    assert record.strain[-1] == pytest.approx(0.02)
    assert record.stress[-1] == pytest.approx(30.0 / 7.07e-8)


KSI = (1.0, 100.0, 1.0 / 6.894757)  # % and ksi of loop()
IN_KSI = "Temperature,Strain,Stress\nC,%,ksi"


@pytest.mark.parametrize("head", [
    f"{IN_KSI}\nwire A,,", "Temperature (C),Strain (%),Stress (ksi)\n[Data]",
    "Temperature (C),Strain (%),Stress (ksi)\nwire of batch 3 at 100 MPa stress",
])  # fmt: skip
def test_a_line_between_titles_and_numbers_leaves_titles_and_units(write, head):
    record = open_record(write(loop() * KSI, head))
    assert record.stress == pytest.approx(100e6, rel=1e-4)
    assert heights(record) == pytest.approx([0.03, 0.03], rel=1e-3)
    # Without titles that are known it is no title that lies above.
    record = open_record(write(loop(), "Operator,Smith,lab 3\n[Data]"))
    assert record.stress == pytest.approx(100e6)


def test_blocks_of_other_loads_or_units_are_tests_of_their_own(write):
    def block(rows):
        return "\n".join(",".join(f"{v:.9e}" for v in row) for row in rows)

    titles, rows = "Temperature (C),Strain (%)", in_percent(loop())[:, :2]
    blocks = (f"Stress: {load} MPa\n{titles}\n{block(rows)}" for load in (100, 200, 300))
    records = open_records(write([], "\n".join(blocks)))
    assert [r.stress for r in records] == pytest.approx([100e6, 200e6, 300e6])
    assert [len(r.cycles) for r in records] == [1, 1, 1]
    again = write([], f"Stress: 100 MPa\n{titles}\n{block(rows)}\n\n{titles}\n{block(rows)}")
    assert [len(r.cycles) for r in open_records(again)] == [2]
    other = IN_KSI.replace("%,ksi", "mm/mm,MPa")
    text = f"{IN_KSI}\n{block(loop() * KSI)}\n{other}\n{block(loop())}"
    for record in open_records(write([], text)):
        assert record.stress == pytest.approx(100e6, rel=1e-4)
        assert heights(record) == pytest.approx([0.03, 0.03], rel=1e-3)


def test_of_lines_that_differ_the_telling_one_counts_else_it_is_asked(write):
    pulled = "Extension (mm),Load (N)"
    force = STRETCHED * (1.0, 0.075)
    for lines, gauge in (("Gauge length: 60 mm", 60.0), ("Area: 0.1 mm2", None),
                         ("Gauge length (mm),60", 60.0),
                         ("Grip distance L0: 80 mm\nGauge length: 60 mm", 60.0)):  # fmt: skip
        record = open_record(write(force, f"{lines}\n{pulled}"))
        assert record.is_extension == (gauge is None)
        if gauge:
            assert record.strain[-1] == pytest.approx(2.0 / gauge)
    with pytest.raises(InputError, match="gauge_length is stated in lines that differ"):
        open_record(write(force, f"Gauge length: 60 mm\nGauge length 2: 50 mm\n{pulled}"))
    strained = "Strain (%),Stress (MPa)"
    lines = "Room temperature: 22 C\nTest temperature: 90 C"
    for head, celsius in ((lines, 90.0), (lines.partition("\n")[0], 22.0)):
        record = open_record(write(STRETCHED, f"{head}\n{strained}"))
        assert record.temperature == pytest.approx(celsius + 273.15)
    with pytest.raises(InputError, match="temperature is stated in lines that differ"):
        open_record(write(STRETCHED, f"{lines}\nTemperature of bath: 80 C\n{strained}"))
    # A load that is not the test's, and a decimal comma where commas part the columns.
    rows, heated = in_percent(loop())[:, :2], "Temperature (C),Strain (%)"
    for head, load in (("Preload stress: 7 MPa\nTest stress: 150 MPa", 150e6),
                       ("Stress: 12,5 MPa", 12.5e6)):  # fmt: skip
        assert open_record(write(rows, f"{head}\n{heated}")).stress == pytest.approx(load)
    with pytest.raises(InputError, match="no stress column"):
        open_record(write(rows, f"Stress limit: 800 MPa\n{heated}"))


@pytest.mark.parametrize("line", [
    "gauge length 50 mm, wire diameter 0.3 mm", "wire diameter 0.3 mm; gauge length 50 mm",
    "Diameter: 0.3 mm\nPre-load: 10 MPa\nTrained 20 cycles at 300 MPa stress",
    "Pulley diameter: 30 mm\nDiameter,0.3,mm",
    "Crosshead area limit 10 mm2\nSurface area: 47 mm2\nDiameter: 0.3 mm",
])  # fmt: skip
def test_what_is_stated_is_the_specimens_each_behind_its_own_key(write, line):
    newtons = in_percent(loop()) * (1.0, 1.0, 0.0707)
    record = open_record(write(newtons, f"{line}\nTemperature (C),Strain (%),Force (N)"))
    assert record.stress == pytest.approx(100e6, rel=1e-3)


@pytest.mark.parametrize(("rows", "titles", "said"), [
    (np.vstack([in_percent(loop()), in_percent(loop()) * (1, 1, 2)]),
     "Temperature (C),Strain (%),Stress (MPa)", "several levels \\(100 to 200 MPa"),
    (in_percent(loop()) * (1, 1, -1), "Temperature (C),Strain (%),Stress (MPa)", "in compression"),
    (np.column_stack([np.repeat([1, 2], 120), np.vstack([in_percent(loop())] * 2)]),
     "Specimen,Temperature (C),Strain (%),Stress (MPa)", "2 specimens by Specimen"),
])  # fmt: skip
def test_several_tests_in_one_column_and_those_in_compression_are_refused(
    write, rows, titles, said
):
    with pytest.raises(InputError, match=said):
        open_record(write(rows, titles))


@pytest.mark.parametrize("line", [
    "Annealing temperature: 500 C", "Austenite finish temperature: 15 C",
])  # fmt: skip
def test_a_temperature_of_the_alloy_is_not_the_tests(write, line):
    titles = "Strain (%),Stress (MPa),Test"
    counted = np.column_stack([STRETCHED, np.ones(len(STRETCHED))])
    assert open_record(write(counted, f"{line}\n{titles}")).temperature is None


def test_cells_that_overflow_part_no_table(write):
    path = write(in_percent(loop()), "Temperature (C),Strain (%),Stress (MPa)")
    lines = path.read_text().splitlines()
    lines[30:34] = [f"{line.partition(',')[0]},****,****" for line in lines[30:34]]
    path.write_text("\n".join(lines))
    record = open_record(path)
    assert record.account.rows == 116 and "4 lines of text" in str(record.account)
    assert [len(cycle.branches) for cycle in record.cycles] == [2]


def test_of_columns_alike_the_specimens_is_taken_and_another_is_named(write):
    rows = in_percent(loop())
    wide = np.column_stack([rows[:, 0] + 9.0, rows[:, 0], -0.4 * rows[:, 1], rows[:, 1:]])
    titles = "Chamber Temp (C),Wire TC (C),Transverse Strain (%),Axial Strain (%),Stress (MPa)"
    record = open_record(write(wide, titles))
    assert record.cycles[0].branches[0].temperature[0] == pytest.approx(293.15)
    assert heights(record) == pytest.approx([0.03, 0.03], rel=1e-3) and record.findings == ()
    twice = np.column_stack([rows, rows[:, 0], 1.1 * rows[:, 1], rows[:, 2]])
    both = ",".join([*["Temperature (C),Strain (%),Stress (MPa)"] * 2])
    (finding,) = open_record(write(twice, both)).findings
    assert "'Strain (%)' is taken, 'Strain (%) (2)' could be it" in finding.text
    # One column in two units is one.
    kelvin = np.column_stack([rows, rows[:, 0] + 273.15])
    heads = "Temperature (C),Strain (%),Stress (MPa),Temperature (K)"
    assert open_record(write(kelvin, heads)).findings == ()


def test_an_isobaric_test_in_newtons_needs_a_section(write):
    newtons = in_percent(loop()) * (1.0, 1.0, 0.0707)
    path = write(newtons, "Temperature (C),Strain (%),Force (N)")
    with pytest.raises(InputError, match="force in Force \\(N\\), and no section"):
        open_record(path)
    record = open_record(path, stated={"diameter": 0.3e-3})
    assert isinstance(record, IsobaricRecord) and record.stress == pytest.approx(100e6, rel=1e-3)


def test_a_factor_in_a_title_above_its_unit_is_asked(write):
    with pytest.raises(InputError, match="unit 'MPa x10' of Stress.* is not known: which"):
        open_record(write(in_percent(loop()), "Temperature,Strain,Stress x10\nC,%,MPa"))


@pytest.mark.parametrize(("titles", "said"), [
    ("Temperature (deg),Strain (%),Stress (MPa)", "'deg' is a unit of angle, the title says temp"),
    ("Temperature (C),Shear Strain (%),Shear Stress (MPa)", "a table of another logger"),
])  # fmt: skip
def test_degrees_of_an_angle_and_shear_are_refused(write, titles, said):
    with pytest.raises(InputError, match=said):
        open_record(write(in_percent(loop()), titles))


def test_japanese_of_windows_is_read(tmp_path):
    rows = "\n".join(",".join(f"{v:.6e}" for v in row) for row in in_percent(loop()))
    path = tmp_path / "shift_jis.csv"
    path.write_bytes(f"温度 (C),ひずみ (%),応力 (MPa)\n{rows}\n".encode("cp932"))
    assert open_record(path).stress == pytest.approx(100e6)


def test_a_tensile_test_that_warms_the_wire_a_little_is_tensile(write):
    warmed = np.column_stack([STRETCHED, np.linspace(23.0, 31.0, len(STRETCHED))])
    record = open_record(write(warmed, "Strain (%),Stress (MPa),Temperature (C)"))
    assert isinstance(record, TensileRecord)
    assert any("changes by 8.0 K" in f.text for f in record.findings)


def test_percents_of_a_workbook_are_as_they_are_seen(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Temperature (C)", "Strain (%)", "Stress (MPa)"])
    for row in loop().tolist():
        book.active.append(row)
        book.active.cell(book.active.max_row, 2).number_format = "0.00%"
    book.save(tmp_path / "seen.xlsx")
    assert heights(open_record(tmp_path / "seen.xlsx")) == pytest.approx([0.03, 0.03], rel=1e-3)


def test_measured_sets_and_the_seven_cycles_of_a_load_frame_are_read(measured_data):
    folder = measured_data / "sma_react" / "input"
    directions = {"cal_sample_1": ["cooling", "heating"], "cal_sample_2": ["heating", "cooling"]}
    for sample, expected in directions.items():
        for path in sorted((folder / sample).glob("*MPa.txt")):
            record = open_record(path)
            assert record.stress == pytest.approx(float(path.stem.split()[0]) * 1e6, rel=0.01)
            assert [b.direction for b in record.cycles[0].branches] == expected
            assert max(heights(record)) < 0.04 and record.findings == ()
    path = folder / "preprocessor_samples" / "isobaric_7cycle.txt"
    record = open_record(path)
    assert [len(c.branches) for c in record.cycles] == [2] * 7
    assert record.strain_unit == "relative"
    texts = " ".join(f.text for f in record.findings)
    assert "more than any NiTi endures" in texts and "537 rows of loading" in texts
    scaled = open_record(path, stated={"gauge_length": 0.4})
    assert scaled.strain_unit == "1"
    assert scaled.cycles[0].branches[0].strain.max() == pytest.approx(0.0555, rel=0.02)

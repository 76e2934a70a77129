"""Tables as other people's loggers and instruments write them: right, asked, or refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sma_bench.api import load
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.parameters.yaml_file import read_parameter_names
from sma_bench.records import open_records, read_record
from sma_bench.records.import_map import account_of, convert
from sma_bench.records.import_proposal import BenchHints, bench_of, propose
from sma_bench.records.tables import read_table_file, runs_of

FIELD = Path(__file__).parents[1] / "data" / "field"
EXAMPLES = Path(__file__).parents[2] / "examples"
CELSIUS = 273.15
MOVED = {"wire.voltage": (0, 3.25, 40, 19.5), "elongation": (-7.962e-3, 0, 40, 19.5)}
HEATED = {"wire.voltage": (0, 1.2, 400, 39.9), "wire.current": (0, 0.6, 400, 39.9)}

# File, rig, signals as (lowest, highest, samples, last time in s).
READ = {
    "01_T_columns_lost.csv": ("drig", {
        "wire.temperature": (24.0 + CELSIUS, 89.88 + CELSIUS, 160, 39.75),
        "ambient.temperature": (24.0 + CELSIUS, 24.0 + CELSIUS, 160, 39.75)}),
    "03_date_and_time_columns.csv": ("drig", {"elongation": (-8e-3, 0, 600, 59.9)}),
    "03b_date_and_time_thermal.csv": ("", {"wire.voltage": (0, 1.2, 40, 39.0)}),
    "04_whole_seconds.csv": ("drig", {"elongation": (-8e-3, 0, 600, 59.9)}),
    "12_index_column.csv": ("", HEATED),
    "12c_words_shift.txt": ("", HEATED),
    "13_one_step.csv": ("", {"wire.voltage": (0, 1, 1200, 59.95)}),
    "14_am_pm.csv": ("", HEATED),
    "19_quantised.csv": ("drig", {"wire.temperature": (300.65, 312.4, 3000, 35.145)}),
    "r01_quoted_decimal_commas.csv": ("rigv", MOVED),
    "r01b_quoted_decimal_commas_all.csv": ("rigv", MOVED),
    "r02_thousands_quoted.csv": ("rigv", {
        "elongation": (-1.5924e-3, 0, 40, 19.5), "force": (5.08, 11.449, 40, 19.5)}),
    "r03_time_per_series.csv": ("rigv", {"elongation": (-7.89e-3, 0, 25, 19.5)}),
    "r05_second_resolution.csv": ("rigv", {"wire.voltage": (0, 3.25, 400, 39.9)}),
    "r06_us_12h_clock.csv": ("rigv", MOVED),
    "r06b_german_dates.csv": ("rigv", MOVED),
    "r12_excel_elapsed.xlsx": ("rigv", MOVED),
    "r12e_excel_text_commas.xlsx": ("rigv", MOVED),
    "r60_quoted_title_with_comma.csv": ("rigv", MOVED),
    "r71_units_in_cells.csv": ("rigv", MOVED),
    "r72_si_prefix_in_cells.csv": ("rigv", {**MOVED, "wire.current": (0, 0.4643, 40, 19.5)}),
    "r96_mat_units_cell.mat": ("rigv", MOVED),
    "r99c_plotjuggler_export.csv": ("rigv", {
        "wire.temperature": (21.85 + CELSIUS, 88.9966 + CELSIUS, 40, 19.513)}),
}  # fmt: skip
# What is asked: a word of the question, and of what.
ASKED = {
    "12d_unnamed_row_number.txt": ("", "'Time'", "which unit"),
    "18_no_time.csv": ("drig", "'row number'", "period"),
    "r10_time_fractional_ms_no_unit.csv": ("rigv", "'time'", "which unit"),
    "r10b_time_minutes_no_unit.csv": ("rigv", "'time'", "which unit"),
    "r20_duty_mean_current.csv": ("rigd", "'current [A]'", "mean or peak"),
    "r95c_hdf5_compound.h5": ("rigv", "'log/time'", "which unit"),
}


def proposed(name, rig, **more):
    path = FIELD / f"{rig}.yaml"
    bench = bench_of(read_parameter_names(path), str(path)) if rig else BenchHints()
    table = read_table_file(FIELD / name)
    return table, *propose(table, bench, **more)


@pytest.mark.parametrize("name", READ)
def test_what_tells_its_meaning_is_read(name):
    rig, expected = READ[name]
    table, made, questions, _ = proposed(name, rig)
    assert not questions
    signals = {signal.name: signal for signal in convert(table, made)[0]}
    for signal, (low, high, samples, last) in expected.items():
        found = signals[signal]
        assert (len(found), found.time[-1]) == (samples, pytest.approx(last, abs=0.002))
        assert np.all(np.diff(found.time) > 0)
        assert found.values.min() == pytest.approx(low, abs=2e-5)
        assert found.values.max() == pytest.approx(high, abs=2e-3 if high > 100 else 1e-4)


@pytest.mark.parametrize("name", ASKED)
def test_what_does_not_is_asked(name):
    rig, where, word = ASKED[name]
    questions = proposed(name, rig)[2]
    assert any(question.startswith(where) and word in question for question in questions)


def test_dates_are_those_of_the_file():
    for name, rig, start in (("03b_date_and_time_thermal.csv", "", 1709287200),
                             ("r06_us_12h_clock.csv", "rigv", 1773143990),
                             ("r06b_german_dates.csv", "rigv", 1773133200),
                             ("r99c_plotjuggler_export.csv", "rigv", 1773136800)):  # fmt: skip
        table, made, _, _ = proposed(name, rig)
        assert convert(table, made)[2] == start * 1_000_000_000


def test_a_unit_that_is_stated_answers_the_question():
    name = "r10_time_fractional_ms_no_unit.csv"
    table, made, questions, _ = proposed(name, "rigv", units={"time": "ms"})
    assert not questions and convert(table, made)[0][0].time[-1] == pytest.approx(19.5)
    with pytest.raises(InputError, match="no column 'clock'"):
        proposed(name, "rigv", units={"clock": "ms"})


def test_a_notebook_reads_a_table_as_the_command_does():
    path, rig = FIELD / "r10_time_fractional_ms_no_unit.csv", FIELD / "rigv.yaml"
    assert load(path, units={"time": "ms"}, params=rig).duration == pytest.approx(19.5)
    with pytest.raises(InputError, match="'time': no unit"):
        load(path, params=rig)
    time = np.arange(100.0)
    for name, low, high, said in (("wire.temperature", 150, 250, "expected kelvin"),
                                  ("elongation", 12, 20, "of mm")):  # fmt: skip
        with pytest.raises(InputError, match=said):
            load({"time": time, name: np.linspace(low, high, 100)})


def test_files_that_are_one_run_become_one_bag(tmp_path):
    time = np.arange(0, 20, 0.5)
    for name, title, values in (("moved", "Position (mm)", 12.0 + 0.3 * (time > 5)),
                                ("driven", "Voltage (V)", 3.0 * (time > 5))):  # fmt: skip
        rows = "\n".join(f"{t},{v}" for t, v in zip(time, values, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"Time (s),{title}\n{rows}\n")
    files = [str(tmp_path / "moved.csv"), str(tmp_path / "driven.csv")]
    assert main(["import", *files, "--together", "--out", str(tmp_path / "bag")]) == 0
    assert set(read_record(tmp_path / "bag").signals) == {"elongation", "wire.voltage"}


def test_rows_without_a_clock_take_the_period_of_the_map(tmp_path):
    words = ["import", str(FIELD / "18_no_time.csv"), "--params", str(FIELD / "drig.yaml")]
    asked, out = tmp_path / "bag.map.yaml", tmp_path / "bag"
    assert main([*words, "--out", str(out)]) == 2
    asked.write_text(asked.read_text().replace('"row number": "ask"', '"row number": "0.5 s"'))
    assert main([*words, "--map", str(asked), "--out", str(out)]) == 0
    assert read_record(out)["wire.temperature"].time[-1] == pytest.approx(199.5)


def test_amperes_of_a_switched_supply_become_those_of_the_same_heat():
    table, made, questions, _ = proposed("r20_duty_mean_current.csv", "rigd")
    assert len(questions) == 1
    entries = tuple(replace(e, form="mean") if e.form == "ask" else e for e in made.entries)
    signals = {s.name: s for s in convert(table, replace(made, entries=entries))[0]}
    volts, amps = signals["wire.voltage"].values, signals["wire.current"].values
    on = volts > 0.9 * volts.max()
    assert np.median(volts[on] / amps[on]) == pytest.approx(7.0, rel=0.01)


def test_decimal_commas_in_a_comma_separated_table_are_refused():
    for name in ("r69_unquoted_decimal_commas.csv", "r69b_unquoted_decimal_commas_int_time.csv"):
        with pytest.raises(InputError, match="3 titles, [56] cells a row .*decimal commas"):
            read_table_file(FIELD / name)


@pytest.mark.parametrize("name", [
    "10_ta_dos_degree.txt", "11_netzsch.txt", "11e_mw_per_mg.csv", "11g_slash_units.csv"
])  # fmt: skip
def test_every_export_of_one_dsc_run_gives_its_temperatures(name):
    found = identify([load(FIELD / name)], Parameters.defaults()).estimates
    for symbol, kelvin in (("austenite_start", 318.15), ("austenite_finish", 335.15),
                           ("martensite_start", 311.15), ("martensite_finish", 293.15)):
        assert found[f"wire.{symbol}_temperature"].value == pytest.approx(kelvin, abs=0.1)


@pytest.mark.parametrize(("name", "pascal"), [
    ("07_loop_with_dwell.csv", 50e9), ("08_testxpert_extensometer.txt", 55e9),
    ("08b_testxpert_absolute_1200.txt", 55e9), ("09_unit_inside_title.csv", 55e9),
    ("17_mts_blocks.dat", 55e9),
])  # fmt: skip
def test_every_testing_machine_gives_the_modulus(name, pascal):
    given = read_parameters(FIELD / "rig60.yaml")
    result = identify([load(FIELD / name)], given, phases={"*": "austenite"})
    assert result.estimates["wire.austenite_modulus"].value == pytest.approx(pascal, rel=0.016)


def test_loads_in_sheets_are_a_record_each():
    records = open_records(FIELD / "06_loads_in_sheets.xlsx")
    assert [record.stress for record in records] == pytest.approx([50e6, 100e6, 200e6])
    first = load(FIELD / "06_loads_in_sheets.xlsx")
    assert "100MPa" in first.findings[-1].text and "200MPa" in first.findings[-1].text


def test_what_a_file_does_not_hold_is_stated(tmp_path):
    bare = FIELD / "16_two_columns.txt"
    with pytest.raises(InputError, match="stress=200 MPa"):
        load(bare)
    (given,) = open_records(bare, stated={"stress": 200e6})
    lined = tmp_path / "lined.txt"
    lined.write_text("Stress: 200 MPa\n" + bare.read_text())
    assert given.stress == load(lined).stress == 200e6
    assert main(["info", str(bare), "--state", "stress=200 MPa"]) == 0
    assert main(["info", str(bare), "--state", "stress=200"]) == 2


def test_extension_is_no_strain_and_force_no_stress(capsys):
    assert main(["info", str(FIELD / "15_info_extension.csv")]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert "1.2 mm" in line and "89.5 N" in line


def test_quantised_and_irregular_readings_raise_no_alarm(tmp_path, capsys):
    words = ["--params", str(FIELD / "drig.yaml"), "--out", str(tmp_path / "bag")]
    assert main(["import", str(FIELD / "19_quantised.csv"), *words]) == 0
    said = capsys.readouterr().out
    assert "clipped" not in said and "missing" not in said


@pytest.mark.parametrize("path", sorted(
    p for p in [*FIELD.iterdir(), *EXAMPLES.rglob("*.csv"), *EXAMPLES.rglob("*.txt")]
    if p.suffix in (".csv", ".txt", ".dat", ".xlsx", ".h5", ".mat") and "69" not in p.name
), ids=lambda p: p.name)  # fmt: skip
def test_every_row_and_column_is_accounted_for(path):
    """Of every table of the repository, as a logger's; and as an instrument's where it is one."""
    for _, table in runs_of(read_table_file(path)):
        names = [c.name for c in table.columns] + list(table.ignored)
        made, questions, remarks = propose(table, BenchHints(supply_voltage=12.0))
        account = account_of(table, made, remarks, questions)
        assert sorted({*account.used, *account.ignored}) == sorted(set(names))
        assert all(account.ignored.values())
        lost = sum("left out" in text for text in account.left_out)
        assert account.rows == sum(t.rows for t in table.tables)
        assert account.rows_used <= account.rows - lost
    try:
        records = open_records(path)
    except InputError:
        return
    file = read_table_file(path)
    for record in records:
        table = next(t for t in file.tables if record.account.sheet in ("", t.name))
        held = {c.name for c in table.columns} | set(table.ignored)
        # Universal Analysis titles its columns above the table.
        assert len({*record.account.used, *record.account.ignored}) == len(held)
        assert record.account.rows == table.rows >= record.account.rows_used > 0

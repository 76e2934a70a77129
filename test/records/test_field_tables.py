"""Tables as loggers and instruments of other labs write them: read, asked about, or refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from sma_bench.api import load
from sma_bench.cli import main
from sma_bench.errors import InputError
from sma_bench.identify import identify
from sma_bench.parameters import Parameters, read_parameters
from sma_bench.records import open_records, read_record
from sma_bench.records.import_map import account_of, propose, runs_of
from sma_bench.records.tables import read_table_file

FIELD = Path(__file__).parents[1] / "data" / "field"
EXAMPLES = Path(__file__).parents[2] / "examples"
KINDS = (".csv", ".txt", ".dat", ".xlsx", ".h5", ".mat")

CASES = yaml.safe_load(Path(__file__).with_name("field_tables.yaml").read_text())


def loaded(name, rig, units=None):
    return load(FIELD / name, units=units or {}, params=FIELD / f"{rig}.yaml" if rig else None)


@pytest.mark.parametrize(("name", "rig", "expected", "start"), CASES["read"])
def test_a_clear_table_is_read(name, rig, expected, start):
    record = loaded(name, rig)
    assert start is None or record.start_ns == start * 1_000_000_000
    for signal, low, high, samples, last in expected:
        found = record[signal]
        assert (len(found), found.time[-1]) == (samples, pytest.approx(last, abs=0.002))
        assert np.all(np.diff(found.time) > 0)
        assert found.values.min() == pytest.approx(low, abs=2e-5)
        assert found.values.max() == pytest.approx(high, abs=2e-3 if high > 100 else 1e-4)


@pytest.mark.parametrize(("name", "rig", "where", "word"), CASES["asked"])
def test_an_unclear_table_is_asked_about(name, rig, where, word):
    with pytest.raises(InputError, match=f"unsure of {where}.*{word}"):
        loaded(name, rig, {"Position": "mm"} if name.startswith("12d") else None)


def test_a_unit_that_is_stated_answers_the_question():
    name = "r10_time_fractional_ms_no_unit.csv"
    assert loaded(name, "rigv", {"time": "ms"}).duration == pytest.approx(19.5)
    with pytest.raises(InputError, match="no column 'clock'"):
        loaded(name, "rigv", {"clock": "ms"})
    time = np.arange(100.0)
    for quantity, low, high, said in (("wire.temperature", 150, 250, "expected kelvin"),
                                      ("elongation", 12, 20, "divide mm")):
        with pytest.raises(InputError, match=said):
            load({"time": time, quantity: np.linspace(low, high, 100)})


def test_files_that_are_one_run_become_one_bag(tmp_path, capsys):
    time = np.arange(0, 20, 0.5)
    columns = {"Position (mm)": 12.0 + 0.3 * (time > 5), "Voltage (V)": 3.0 * (time > 5)}
    files = [str(tmp_path / f"{k}.csv") for k in range(2)]
    for file, (title, values) in zip(files, columns.items(), strict=True):
        rows = "\n".join(f"{t},{v},dry" for t, v in zip(time, values, strict=True))
        Path(file).write_text(f"Time (s),{title},Note\n{rows}\n")
    assert main(["import", *files, "--together", "--out", str(tmp_path / "bag")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "0: Note (" in said and "1: Note (" in said
    assert set(read_record(tmp_path / "bag").signals) == {"elongation", "wire.voltage"}


def test_questions_are_answered_in_the_map_and_spread_stamps_are_reported(tmp_path):
    words = ["import", str(FIELD / "r20_duty_mean_current.csv")]
    words += ["--params", str(FIELD / "rigd.yaml")]
    asked, out = tmp_path / "bag.map.yaml", tmp_path / "bag"
    assert main([*words, "--out", str(out)]) == 2
    assert asked.read_text().count("form: ask") == 1
    asked.write_text(asked.read_text().replace("form: ask", "form: mean"))
    assert main([*words, "--map", str(asked), "--out", str(out)]) == 0
    # The mean current of a switched supply became the current of the same heat.
    record = read_record(out)
    volts, amps = record["wire.voltage"].values, record["wire.current"].values
    on = volts > 0.9 * volts.max()
    assert np.median(volts[on] / amps[on]) == pytest.approx(7.0, rel=0.01)
    words = ["import", str(FIELD / "04_whole_seconds.csv"), "--params", str(FIELD / "drig.yaml")]
    assert main([*words, "--out", str(tmp_path / "spread")]) == 0
    found = read_record(tmp_path / "spread").findings
    assert sum(finding.numbers.get("repeated", 0) for finding in found) == 540


def test_decimal_commas_in_a_comma_separated_table_are_refused():
    for name in ("r69_unquoted_decimal_commas.csv", "r69b_unquoted_decimal_commas_int_time.csv"):
        with pytest.raises(InputError, match="3 titles, [56] cells a row .*decimal commas"):
            loaded(name, "rigv")


@pytest.mark.parametrize("name", CASES["instruments"])
def test_the_parameters_of_a_specimen_are_identified_from_every_export(name):
    true = CASES["instruments"][name]
    is_dsc = len(true) == 4
    given = Parameters.defaults() if is_dsc else read_parameters(FIELD / "rig60.yaml")
    phases = None if is_dsc else {"*": "austenite"}
    found = identify([load(FIELD / name)], given, phases=phases).estimates
    for number, value in true.items():
        error = 0.1 if is_dsc else 0.016 * value
        assert found[f"wire.{number}"].value == pytest.approx(value, abs=error)


def test_each_sheet_of_a_load_is_a_record():
    records = open_records(FIELD / "06_loads_in_sheets.xlsx")
    assert [record.stress for record in records] == pytest.approx([50e6, 100e6, 200e6])
    first = load(FIELD / "06_loads_in_sheets.xlsx")
    assert "100MPa" in first.findings[-1].text and "200MPa" in first.findings[-1].text


def test_numbers_that_a_file_lacks_can_be_stated_and_extension_stays_in_mm(tmp_path, capsys):
    bare = FIELD / "16_two_columns.txt"
    with pytest.raises(InputError, match="stress=200 MPa"):
        load(bare)
    (given,) = open_records(bare, stated={"stress": 200e6})
    lined = tmp_path / "lined.txt"
    lined.write_text("Stress: 200 MPa\n" + bare.read_text())
    assert given.stress == load(lined).stress == 200e6
    assert main(["info", str(bare), "--state", "stress=200 MPa"]) == 0
    assert main(["info", str(bare), "--state", "stress=200"]) == 2
    capsys.readouterr()
    assert main(["info", str(FIELD / "15_info_extension.csv")]) == 0
    line = capsys.readouterr().out.splitlines()[0]
    assert "1.2 mm" in line and "89.5 N" in line


def test_quantised_and_irregular_readings_raise_no_alarm(tmp_path, capsys):
    words = ["--params", str(FIELD / "drig.yaml"), "--out", str(tmp_path / "bag")]
    assert main(["import", str(FIELD / "19_quantised.csv"), *words]) == 0
    said = capsys.readouterr().out
    assert not any(word in said for word in ("clipped", "missing", "gaps", "warning"))
    assert main(["info", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert said.count("Hz on average") == 2


def test_a_position_that_moves_before_its_drive_has_no_zero(tmp_path):
    """Its clock is 7 s behind the voltage's."""
    rows = [f"{t},{3.0 * (t > 10)},{t - 7.0},{12 - 4 * min(max(t - 10, 0) / 5, 1)}"
            for t in np.arange(0, 40, 0.5)]
    path = tmp_path / "two.csv"
    path.write_text("\n".join(["Time (s),Voltage (V),Time (s),Position (mm)", *rows]) + "\n")
    (question,) = propose(read_table_file(path), Parameters({"wire.length": 0.3}), {})[1]
    assert question.startswith("'Position (mm)': it moves before the first drive")


def test_a_supplys_own_readings_are_asked_about(tmp_path):
    path = tmp_path / "psu.csv"
    rows = [f"{k / 10},{3.0 * (k > 20)},{1.0 * (k > 20)},{20 + k / 10}" for k in range(90)]
    path.write_text("\n".join(["Time (s),PSU_U_RB,PSU_I_RB,T_wire (C)", *rows]) + "\n")
    made, questions, _ = propose(read_table_file(path), Parameters(), {})
    assert {e.column: e.signal for e in made.signals}["PSU_U_RB"] == "wire.voltage"
    for name in ("PSU_U_RB", "PSU_I_RB"):
        assert f"{name!r}: of the wire, or of another device (psu)?" in questions


@pytest.mark.parametrize(("head", "rig", "period", "question"), CASES["stated"])
def test_lines_above_the_titles_give_a_period_and_may_contradict_a_supply(
        head, rig, period, question, tmp_path):
    path = tmp_path / "lines.csv"
    rows = (f"{k},{50.0 * (10 < k < 20)},{20 + k / 10}" for k in range(40))
    path.write_text("\n".join([head, "Sample,Duty (%),Temp (C)", *rows]) + "\n")
    made, questions, remarks = propose(read_table_file(path), Parameters(rig), {})
    assert ("wire.count" in remarks) == ("wires" in head)
    assert made.tick("row number") == pytest.approx(period)
    assert len(questions) == bool(question) and question in "".join(questions)


@pytest.mark.parametrize(("titles", "rig", "signals", "said"), CASES["whose"])
def test_whole_words_of_a_title_give_wire_and_channel(titles, rig, signals, said, tmp_path):
    path = tmp_path / "whose.csv"
    rows = [[f"{k / 10}", *["0.5"] * (len(titles) - 1)] for k in range(30)]
    path.write_text("\n".join(map(",".join, [titles, *rows])) + "\n")
    made, questions, remarks = propose(read_table_file(path), Parameters(rig), {})
    assert [entry.signal for entry in made.signals] == signals
    texts = [f"{name!r}: {text}" for name, text in remarks.items()]
    assert any(said in text for text in [*questions, *texts])


TABLES = [p for folder in (FIELD, EXAMPLES) for p in sorted(folder.rglob("*")) if p.suffix in KINDS]


@pytest.mark.parametrize("path", [p for p in TABLES if "69" not in p.name], ids=lambda p: p.name)
def test_every_row_and_column_is_accounted_for(path):
    """All tables of the repository, read as a logger's, and as an instrument's if they are."""
    for _, table in runs_of(read_table_file(path)):
        names = [n for t in table.tables for n in (*(c.name for c in t.columns), *t.ignored)]
        bench = Parameters({"bench.supply_voltage": 12.0})
        made, questions, remarks = propose(table, bench, {})
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
        # Universal Analysis has its titles above the table: their names differ.
        assert len({*record.account.used, *record.account.ignored}) == len(held)
        assert record.account.rows == table.rows >= record.account.rows_used > 0

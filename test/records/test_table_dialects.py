"""Other people's tables: a few dialects as `./bench check tables` draws them, against the truth."""

import ast
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from examination.check.tables import RIGHT, WRONG, outcome
from examination.tables.dialects import HABITS, true_table, write
from sma_bench.errors import InputError
from sma_bench.records import cells
from sma_bench.records.cells import WORDS, moments_of, number_with_unit, parse_unit, split_title
from sma_bench.records.tables import read_table_file

PLAIN = {feature: habits[0] for feature, habits in HABITS.items()}


@pytest.mark.parametrize("number", [0, 1, 6, 8])  # clamped, on a spring, isobaric, tensile
def test_a_plain_table_is_read_right_and_a_lost_row_found_out(tmp_path, number):
    truth = true_table(number, 1)
    sample = write(truth, PLAIN, tmp_path, np.random.default_rng(1))
    assert sample.tells
    assert outcome(truth, sample) == (RIGHT, "")
    if not number:
        (tmp_path / "lost").mkdir()
        sample = write(truth, PLAIN, tmp_path / "lost", np.random.default_rng(1))
        lines = sample.path.read_text().splitlines()
        sample.path.write_text("\n".join([*lines[:50], *lines[51:]]) + "\n")
        assert outcome(truth, sample)[0] == WRONG


READERS = "cells tables import_map instrument_files instruments"
# Functions, and which of their arguments is a sentence.
SAYING = {"said": 0, "sheet.refusal": 0, "self.refusal": 0, "ask": 1, "self.ask": 1}
SAYING |= {"sheet.remark": 2, "self.remark": 2}


def test_every_sentence_is_said_with_the_values_that_it_has():
    sentences, found = WORDS["sentences"], set()
    for stem in READERS.split():
        path = Path(cells.__file__).with_name(f"{stem}.py")
        calls = (n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call))
        for call in calls:
            for argument in call.args[SAYING.get(ast.unparse(call.func), 99) :][:1]:
                keys = [k.value for k in ast.walk(argument) if isinstance(k, ast.Constant)]
                for key in (key for key in keys if key in sentences):
                    values = {part[1] for part in Formatter().parse(sentences[key])} - {None}
                    assert values <= {keyword.arg for keyword in call.keywords}, key
                    found.add(key)
    assert found == set(sentences)


@pytest.mark.parametrize(("text", "quantity", "value"), [
    ("T1_150MPa", "stress", 150e6), ("NiTi-2-150MPa", "stress", 150e6),
    ("150MPa_run2", "stress", 150e6), ("Run 2 150MPa", "stress", 150e6),
    ("Run 2-150 MPa stress", "stress", None), ("Stress: 150 ± 5 MPa", "stress", None),
    ("Sample: NiTi #3-12.0 mg weight", "mass", 12e-6), ("mass=12 345 µg", "mass", 12.345e-6),
    ("Sample Mass 1 (mg): 12.00", "mass", 12e-6), ("Mass: 12,345 mg", "mass", 12.345e-6),
    ("Sample mass: 12 3 mg", "mass", None), ("Mass 1 234 567 µg", "mass", 1.234567e-3),
    ("Durchmesser d1 (mm): 0,90", "length", 0.9e-3),
    ("Gauge length L0 [mm]: 60", "length", 0.06), ("L [mm]: 100", "length", 0.1),
    ("L [mm]: 1 200", "length", 1.2), ("gauge_length=1,000 mm", "length", None),
    ("stress=1.200,5 MPa", "stress", 1200.5e6), ("stress=1.200 MPa", "stress", None),
    ("Temperature (C): -20", "temperature", 253.15),
])  # fmt: skip
def test_a_number_is_stated_whole_and_no_digits_of_a_name_are_one(text, quantity, value):
    assert number_with_unit(text, quantity) == (None if value is None else pytest.approx(value))


@pytest.mark.parametrize(("title", "parts"), [
    ("Current [x10 mA]", ("Current", "mA x10")), ("Current (A)*1000", ("Current", "A *1000")),
    ("Temp (C)/10", ("Temp", "C /10")), ("Stress (MPa) /10", ("Stress", "MPa /10")),
    ("Strain (%) x 100", ("Strain", "% x 100")), ("Voltage x10 (V)", ("Voltage", "V x10")),
    ("Temp x2 (C)", ("Temp x2", "C")), ("T_f", ("T_f", "")), ("T_C", ("T", "C")),
    ("Sensor_ADC", ("Sensor_ADC", "")),
])  # fmt: skip
def test_a_unit_with_a_factor_is_not_known_and_a_side_is_none(title, parts):
    assert split_title(title) == parts
    assert not any(mark in parts[1] for mark in "x*/") or parse_unit(parts[1]) is None


def test_slips_of_units_are_read_where_nothing_else_can_be_meant():
    for text, unit in (("VDC", "V"), ("ADC", "A"), ("oC", "degC"), ("Mpa", "MPa")):
        assert parse_unit(text) == parse_unit(unit) is not None
    assert parse_unit("10^-3").factor == 1e-3 and parse_unit("mPa") is None
    for title, unit, meant in (
        ("Elongation", "%", "strain"), ("Elongation", "mm", "length"), ("Tensão", "MPa", "stress"),
        ("Tensão", "V", "voltage"), ("ひずみ", "%", "strain"), ("温度", "C", "temperature"),
    ):  # fmt: skip
        assert cells.meanings(title, unit) == (meant,)
        assert cells.title_meanings(title)


def test_dates_are_taken_in_the_order_that_leaves_no_hole_and_two_digits_of_a_year_are_said():
    seconds, epoch, _, remark = moments_of(["01/02/2026 23:59:59", "01/03/2026 00:00:00"])
    assert list(seconds) == [0.0, 1.0] and epoch == 1767398399
    assert remark == "01/02/2026 is taken as 2026-01-02"
    european = moments_of(["01/02/2026 23:59:59", "02/02/2026 00:00:00"])
    assert european[1] == 1769990399 and list(european[0]) == [0.0, 1.0]
    assert moments_of(["26/03/01 10:00:00"])[3] == "26/03/01 is taken as 2001-03-26"
    assert moments_of(["26.03.01 10:00:00"])[3] == moments_of(["2026-03-01 10:00"])[3] == ""


@pytest.mark.parametrize(("cells", "is_asked"), [
    (["0", "985", "1.069"], True), (["0", "1.200", "1.200"], True), (["0", "1.200", "1.5"], False),
    (["0.123", "1.200", "2.000"], False), (["1.234", "1.200", "2.345"], False),
    (["1000", "1.200", "0"], False),
])  # fmt: skip
def test_dots_that_may_be_of_thousands_are_asked_about_unless_another_cell_tells(
    cells, is_asked, tmp_path
):
    for k, times in enumerate((("0", "1", "2"), ("0.0", "0.5", "1.0"))):
        rows = "".join(f"{t};{cell}\n" for t, cell in zip(times, cells, strict=True))
        path = tmp_path / f"{k}.csv"
        path.write_text(f"Time (s);Voltage (mV)\n{rows}")
        if is_asked and not k:
            with pytest.raises(InputError, match="'1.[0-9]{3}' may have a decimal or a thousand"):
                read_table_file(path)
        else:
            assert read_table_file(path).columns[1].values[1] == float(cells[1])


def test_a_text_parted_by_blanks_may_begin_with_an_empty_line(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("\n\nTime Voltage\n0.0 1.5\n0.1 2.5\n0.2 3.5\n")
    columns = read_table_file(path).columns
    assert [c.values.tolist() for c in columns] == [[0.0, 0.1, 0.2], [1.5, 2.5, 3.5]]

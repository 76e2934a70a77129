"""Tables of other loggers: a few of those that `./bench check tables` draws, compared with what was
written to them."""

import ast
from pathlib import Path
from string import Formatter

import numpy as np
import pytest
import yaml

from examination.check.tables import RIGHT, WRONG, outcome
from examination.tables.dialects import HABITS, true_table, write
from sma_bench.errors import InputError
from sma_bench.records import cells
from sma_bench.records.cells import WORDS, moments_of, number_with_unit, parse_unit, split_title
from sma_bench.records.tables import read_table_file

CASES = yaml.safe_load(Path(__file__).with_name("cells.yaml").read_text(encoding="utf-8"))
PLAIN = {feature: habits[0] for feature, habits in HABITS.items()}


@pytest.mark.parametrize("number", [0, 1, 6, 8])  # clamped, on a spring, isobaric, tensile
def test_a_plain_table_is_read_right_and_a_lost_row_is_noticed(tmp_path, number):
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


READERS = "cells clocks tables bag_tables import_map instrument_files instruments open"
# Functions that take the key of a sentence, and the index of that argument.
KEY_OF = {"message": 0, "cells.message": 0, "sheet.refusal": 0, "self.refusal": 0, "ask": 1}
KEY_OF |= {"self.ask": 1, "sheet.remark": 2, "self.remark": 2}


def test_every_sentence_is_used_and_gets_its_values():
    sentences, found = WORDS["sentences"], set()
    for stem in READERS.split():
        path = Path(cells.__file__).with_name(f"{stem}.py")
        calls = (n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call))
        pairs = ((c, a) for c in calls for a in c.args[KEY_OF.get(ast.unparse(c.func), 99) :][:1])
        for call, argument in pairs:
            keys = {k.value for k in ast.walk(argument) if isinstance(k, ast.Constant)}
            for key in keys & set(sentences):
                values = {part[1] for part in Formatter().parse(sentences[key])} - {None}
                assert values <= {keyword.arg for keyword in call.keywords}, key
                found.add(key)
    assert found == set(sentences)


@pytest.mark.parametrize(("text", "quantity", "value"), CASES["numbers"])
def test_a_stated_number_is_read_whole_and_digits_of_a_name_are_not(text, quantity, value):
    assert number_with_unit(text, quantity) == (None if value is None else pytest.approx(value))


@pytest.mark.parametrize(("title", "parts"), CASES["titles"])
def test_a_unit_with_a_factor_is_unknown_and_a_side_is_not_a_unit(title, parts):
    assert split_title(title) == tuple(parts)
    assert not any(mark in parts[1] for mark in "x*/") or parse_unit(parts[1]) is None


def test_misspelt_units_are_read_if_they_are_unambiguous():
    for text, unit in (("VDC", "V"), ("ADC", "A"), ("oC", "degC"), ("Mpa", "MPa")):
        assert parse_unit(text) == parse_unit(unit) is not None
    assert parse_unit("10^-3").factor == 1e-3 and parse_unit("mPa") is None
    for title, unit, meant in CASES["meanings"]:
        assert cells.meanings(title, unit) == (meant,)
        assert cells.title_meanings(title)


def test_dates_are_read_in_the_order_without_long_pauses_and_short_years_are_remarked():
    seconds, epoch, _, remark = moments_of(["01/02/2026 23:59:59", "01/03/2026 00:00:00"])
    assert list(seconds) == [0.0, 1.0] and epoch == 1767398399
    assert remark == "01/02/2026 is taken as 2026-01-02"
    european = moments_of(["01/02/2026 23:59:59", "02/02/2026 00:00:00"])
    assert european[1] == 1769990399 and list(european[0]) == [0.0, 1.0]
    assert moments_of(["26/03/01 10:00:00"])[3] == "26/03/01 is taken as 2001-03-26"
    assert moments_of(["26.03.01 10:00:00"])[3] == moments_of(["2026-03-01 10:00"])[3] == ""
    exact, epoch, *_ = moments_of(["1970-01-01T00:00:00", "", "1970-01-01T00:00:00.000000001"])
    assert epoch == 0.0 and str(exact) == "[0.e+00    nan 1.e-09]"


@pytest.mark.parametrize(("cells", "is_asked"), CASES["dots"])
def test_dots_that_may_separate_thousands_are_refused(cells, is_asked, tmp_path):
    for k, times in enumerate((("0", "1", "2"), ("0.0", "0.5", "1.0"))):
        rows = "".join(f"{t};{cell}\n" for t, cell in zip(times, cells, strict=True))
        path = tmp_path / f"{k}.csv"
        path.write_text(f"Time (s);Voltage (mV)\n{rows}")
        if is_asked and not k:
            with pytest.raises(InputError, match="'1.[0-9]{3}' may have a decimal sign or a thous"):
                read_table_file(path)
        else:
            assert read_table_file(path).columns[1].values[1] == float(cells[1])

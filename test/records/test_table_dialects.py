"""Other people's tables: a few dialects as `./bench check tables` draws them, against the truth."""

import ast
from pathlib import Path
from string import Formatter

import numpy as np
import pytest

from examination.tables.dialects import HABITS, write
from examination.tables.outcome import RIGHT, WRONG, outcome
from examination.tables.truths import true_table
from sma_bench.records import cells
from sma_bench.records.cells import WORDS, number_with_unit

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
    ("Sample Mass 1 (mg): 12.00 12.00 mg", "mass", 12e-6), ("Mass: 12,345 mg", "mass", 12.345e-6),
    ("Sample mass: 12 3 mg", "mass", None), ("Mass 1 234 567 µg", "mass", 1.234567e-3),
    ("Durchmesser d1 (mm): 0,90 0,90 mm", "length", 0.9e-3),
    ("Gauge length L0 [mm]: 60 60 mm", "length", 0.06), ("L [mm]: 100 100 mm", "length", 0.1),
    ("L [mm]: 1 200 1 mm", "length", 1.2), ("gauge_length=1,000 mm", "length", None),
    ("stress=1.200,5 MPa", "stress", 1200.5e6), ("stress=1.200 MPa", "stress", None),
    ("Temperature (C): -20 20 C", "temperature", 253.15),
])  # fmt: skip
def test_a_number_is_stated_whole_and_no_digits_of_a_name_are_one(text, quantity, value):
    """A number once more with the unit of its key is as `Sheet.noted` reads such a line."""
    assert number_with_unit(text, quantity) == (None if value is None else pytest.approx(value))

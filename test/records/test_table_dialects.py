"""Other people's tables: a few dialects as `./bench check tables` draws them, against the truth."""

from collections import Counter

import numpy as np
import pytest

from examination.check.tables import import_one, table
from examination.tables.dialects import HABITS, draw_habits, write
from examination.tables.outcome import RIGHT, WRONG, outcome
from examination.tables.truths import TABLES, true_table

PLAIN = {feature: habits[0] for feature, habits in HABITS.items()}


@pytest.mark.parametrize("number", [0, 1, 6, 8])  # clamped, on a spring, isobaric, tensile
def test_a_plain_table_is_read_right(tmp_path, number):
    truth = true_table(number, 1)
    sample = write(truth, PLAIN, tmp_path, np.random.default_rng(1))
    assert sample.tells
    assert outcome(truth, sample) == (RIGHT, "")


@pytest.mark.parametrize("off", [0.01, None], ids=["value", "row"])
def test_a_number_or_a_row_that_is_not_the_truth_is_found_out(tmp_path, off):
    truth = true_table(0, 1)
    sample = write(truth, PLAIN, tmp_path, np.random.default_rng(1))
    lines = sample.path.read_text().splitlines()
    time, *cells = lines[50].split(",")
    moved = [",".join([time, *(f"{float(cell) + off:.4f}" for cell in cells)])] if off else []
    sample.path.write_text("\n".join([*lines[:50], *moved, *lines[51:]]) + "\n")
    assert outcome(truth, sample)[0] == WRONG


def test_dialects_are_drawn_again_the_same_with_every_habit_and_counted():
    found = [import_one(1, number) for number in range(20)]
    assert found[:2] == [import_one(1, number) for number in range(2)]
    counts = Counter(one["outcome"] for one in found)
    assert not counts["raised"]
    line = next(line for line in table(found).splitlines() if line.startswith("all "))
    ends = [counts[end] for end in ("right", "asked", "refused", "wrong", "raised")]
    assert [int(n) for n in line.split()[1:]] == [20, *ends]
    draws = (
        draw_habits(true_table(number % TABLES, 1), np.random.default_rng([9, number]))
        for number in range(2000)
    )
    drawn = {pair for habits in draws for pair in habits.items()}
    assert drawn == {(feature, habit) for feature, habits in HABITS.items() for habit in habits}

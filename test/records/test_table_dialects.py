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


@pytest.mark.parametrize("change", ["value", "row"])
def test_a_number_or_a_row_that_is_not_the_truth_is_found_out(tmp_path, change):
    truth = true_table(0, 1)
    sample = write(truth, PLAIN, tmp_path, np.random.default_rng(1))
    lines = sample.path.read_text().splitlines()
    if change == "value":
        cells = lines[50].split(",")
        lines[50] = ",".join([cells[0], *(f"{float(cell) + 0.01:.4f}" for cell in cells[1:])])
    else:
        del lines[50]
    sample.path.write_text("\n".join(lines) + "\n")
    assert outcome(truth, sample)[0] == WRONG


def test_twenty_dialects_are_drawn_again_the_same_and_counted():
    found = [import_one(1, number) for number in range(20)]
    assert found[:2] == [import_one(1, number) for number in range(2)]
    assert all(one["outcome"] != "raised" for one in found)
    counts = Counter(one["outcome"] for one in found)
    line = next(line for line in table(found).splitlines() if line.startswith("all "))
    assert [int(n) for n in line.split()[1:]] == [
        20, *(counts[end] for end in ("right", "asked", "refused", "wrong", "raised"))
    ]  # fmt: skip


def test_every_kind_of_table_is_drawn_with_every_habit():
    drawn = Counter(
        (feature, habit)
        for number in range(2000)
        for feature, habit in draw_habits(
            true_table(number % TABLES, 1), np.random.default_rng([9, number])
        ).items()
    )
    assert {(feature, habit) for feature, habits in HABITS.items() for habit in habits} == set(
        drawn
    )

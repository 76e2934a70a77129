"""Other people's tables: a few dialects as `./bench check tables` draws them, against the truth."""

from collections import Counter

import numpy as np
import pytest

from examination.check.tables import import_one, table
from examination.tables.dialects import HABITS, write
from examination.tables.outcome import RIGHT, WRONG, outcome
from examination.tables.truths import true_table

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


def test_dialects_are_drawn_again_the_same_and_counted():
    found = [import_one(1, number) for number in range(20)]
    assert found[:2] == [import_one(1, number) for number in range(2)]
    counts = Counter(one["outcome"] for one in found)
    assert not counts["raised"]
    line = next(line for line in table(found).splitlines() if line.startswith("all "))
    ends = [counts[end] for end in ("right", "asked", "refused", "wrong", "raised")]
    assert [int(n) for n in line.split()[1:]] == [20, *ends]

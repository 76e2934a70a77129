"""Other people's bags: a few as `./bench check bags` draws them, against the truth."""

import numpy as np
import pytest

from examination.campaign import drawn_bags
from examination.campaign.drawn_bags import HABITS, LOSS, RAISED, RIGHT, WRONG, outcome
from sma_bench.errors import InputError
from sma_bench.records import read_record

PLAIN = {kind: habits[0] for kind, habits in HABITS.items()}
UNSTAMPED = "one never stamped, an hour apart"


def written(folder, seed=1, **habits):
    return drawn_bags.write_bag(folder, np.random.default_rng(seed), PLAIN | habits)


@pytest.mark.parametrize("habits", [
    {"storage": "sqlite3"},
    # What was read wrong when it was found first.
    {"clock": UNSTAMPED, "stamps": "repeated"},
    {"clock": "from 0, computer's beside", "stamps": "one far away"},
    {"files": "one missing", "metadata": "missing"},
    {"files": "one missing", "metadata": "cut off"},
    {"inside": "no chunks", "end": "zeros"},
])  # fmt: skip
def test_a_bag_is_read_right_and_what_is_lost_is_said(tmp_path, habits):
    for seed in range(4):
        folder = tmp_path / str(seed)
        folder.mkdir()
        bag = written(folder, seed, **habits)
        end, why = outcome(bag)
        assert end not in (WRONG, RAISED), why
        assert end in (RIGHT, LOSS) or not bag.tells, why


@pytest.mark.parametrize("cut", [1, 200, 5000])
def test_an_sqlite3_file_without_its_end_is_refused(tmp_path, cut):
    """SQLite itself would find fewer rows, without a word."""
    written(tmp_path, storage="sqlite3")
    (file,) = tmp_path.rglob("*.db3")
    file.write_bytes(file.read_bytes()[:-cut])
    with pytest.raises(InputError, match="the end of the file is missing"):
        read_record(file)

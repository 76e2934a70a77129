"""Other people's bags: a few as `./bench check bags` draws them, against the truth."""

from collections import Counter

import numpy as np
import pytest

from examination.campaign import drawn_bags
from examination.campaign.drawn_bags import HABITS, LOSS, RAISED, RIGHT, WRONG, outcome
from examination.check import bags
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


@pytest.mark.parametrize("change", ["value", "time", "lost", "extra"])
def test_what_is_not_the_truth_is_found_out(tmp_path, change):
    bag = written(tmp_path)
    power = bag.streams[0]
    if change == "value":
        power.signals["wire.voltage"][5] += 1e-6
    elif change == "time":
        power.stamp[5] += 10_000
    elif change == "lost":
        for name, values in power.signals.items():
            power.signals[name] = np.append(values, 1.0)
        power.stamp = np.append(power.stamp, power.stamp[-1] + 10**7)
    else:
        del power.signals["wire.current"]
    assert outcome(bag)[0] == WRONG


def test_in_front_of_the_damage_everything_is_due(tmp_path):
    bag = written(tmp_path, end="cut")
    assert 100 < len(bag.whole) < sum(len(s.stamp) for s in bag.streams)
    assert outcome(bag)[0] not in (WRONG, RAISED)
    bag.whole.add((0, len(bag.streams[0].stamp) - 1))
    assert "1 of" in outcome(bag)[1]


@pytest.mark.parametrize("cut", [1, 200, 5000])
def test_an_sqlite3_file_without_its_end_is_refused(tmp_path, cut):
    """SQLite itself would find fewer rows, without a word."""
    written(tmp_path, storage="sqlite3")
    (file,) = tmp_path.rglob("*.db3")
    file.write_bytes(file.read_bytes()[:-cut])
    with pytest.raises(InputError, match="the end of the file is missing"):
        read_record(file)


def test_twenty_bags_are_drawn_again_the_same_and_none_is_silently_wrong(tmp_path):
    found = bags.try_bags(2, 0, 20)
    assert found[:2] == [drawn_bags.try_bag(2, number, tmp_path) for number in range(2)]
    counts = Counter(one["outcome"] for one in found)
    assert counts[WRONG] == counts[RAISED] == 0 and counts[RIGHT] > 5
    line = next(line for line in bags.table(found).splitlines() if line.startswith("all "))
    assert [int(n) for n in line.split()[1:]] == [20, *(counts[end] for end in bags.OUTCOMES)]

"""A small `./bench check power_cuts`: the real image, with power cuts at random instants."""

from collections import Counter

from examination.check.power_cuts import cuts


def test_no_power_cut_makes_the_stored_reason_wrong(emulator):
    found = cuts(7, 0, 30)
    assert [one["told"] for one in found if one["told"]] == []
    outcomes = Counter(one["outcome"] for one in found)
    assert outcomes["before"] > 3 and outcomes["now"] > 5 and outcomes["lost"] > 0
    assert sum(one["storing"] for one in found) > 3

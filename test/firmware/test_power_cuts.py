"""A small `./bench check power_cuts`: the real image, with power cuts at random instants."""

from collections import Counter

from examination.check.power_cuts import LOST, Report, cuts, verdict


def test_no_power_cut_makes_the_stored_reason_wrong(emulator):
    found = cuts(7, 0, 30)
    assert [one["told"] for one in found if one["told"]] == []
    outcomes = Counter(one["outcome"] for one in found)
    assert outcomes["before"] > 3 and outcomes["now"] > 5 and outcomes["lost"] > 0
    assert sum(one["storing"] for one in found) > 3


def test_a_report_that_was_never_stored_counts_as_wrong():
    before, now, lost = Report(2, 1.5, False), Report(1, 0.7, True), Report(LOST, 0.0, True)

    def outcome(said, may=True, must=False, was=before):
        return verdict(said, was, now, {now.cause}, may, must)

    assert (outcome(before), outcome(now), outcome(lost)) == ("before", "now", "lost")
    for wrong in (
        Report(3, 0.7, True), Report(1, 25.6, True), Report(1, 0.7, False), Report(2, 1.5, True),
        Report(2, 1.6, False), Report(0, 0.0, False), Report(LOST, 0.1, True),
    ):  # fmt: skip
        assert outcome(wrong) == "WRONG"
    assert outcome(now, may=False) == outcome(lost, may=False) == "WRONG"
    assert outcome(before, must=True) == outcome(lost, must=True) == "WRONG"
    assert outcome(lost, was=before._replace(open=True)) == "WRONG"

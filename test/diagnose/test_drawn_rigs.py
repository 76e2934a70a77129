"""The check of drawn rigs works."""

from examination.check import rigs


def test_a_drawn_rig_is_identified_and_diagnosed():
    found = rigs.try_rig(1)
    assert [found[work] for work in rigs.WORK] == [rigs.FINE] * 2, found

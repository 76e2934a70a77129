"""The check of drawn rigs works, and can fail."""

import pytest

from examination.check import rigs
from sma_bench.errors import FitError, InputError


def test_a_drawn_rig_is_identified_and_diagnosed():
    found = rigs.try_rig(1)
    assert [found[work] for work in rigs.WORK] == [rigs.FINE] * 2, found


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (FitError("within a fit: load.stiffness is 0"), rigs.RAISED),
        (InputError("bag: nothing to identify: load.stiffness is 0"), rigs.HIDDEN),
        (InputError("bag: begins under voltage"), rigs.REFUSED),
    ],
)
def test_what_goes_wrong_is_told_apart(monkeypatch, capsys, error, outcome):
    def fails(*arguments):
        raise error

    for work in rigs.WORK:
        monkeypatch.setitem(rigs.WORK, work, fails)
    assert rigs.main(["--draws", "1"]) == (outcome != rigs.REFUSED)
    assert str(error) in capsys.readouterr().out

"""The checks of identification work and can fail, on a few cases; `./bench check` has all."""


import numpy as np
import pytest

from examination.attack_lab.cases import ATTACKS
from examination.check import attacks

# One of each kind: within the errors, warned about, seen in the record, in stated numbers, refused.
OF_WIRES = (*("E1 to E3 camera gain +5 %", "E1 to E3 lead of 0.1 ohm", "E1 to E3 camera saturates"),
            "E1 to E3 spot half filled")  # fmt: skip
OF_TABLES = (
    *("E5 sample lags 8 s", "E5 signal saturates", "E7 soft grips", "E7 a slip in the rise"),
    *("E8 spot half filled", "E8 wrong diameter: 6 % too large"),
)


def silent(result):
    return [n for n, x in result["numbers"].items() if attacks.verdict(x) == "silent"]


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.compiled) for name in OF_WIRES), *OF_TABLES]
)
def test_a_wrong_number_is_within_its_error_or_warned_about(name):
    (attack,) = [a for a in ATTACKS if name == f"{a.experiment} {a.name}"]
    result = attacks.run("attack", ATTACKS.index(attack), 0)
    assert result["numbers"] or result["refused"]
    assert silent(result) == []
    if name.endswith("half filled") and name.startswith("E1"):  # only affected numbers
        warned = {name for name, x in result["numbers"].items() if x["warnings"]}
        assert warned == {"wire.heat_transfer_coefficient", "wire.specific_heat"}


def test_a_clean_bag_raises_no_warning():
    result = attacks.judge(attacks.clean_bag(np.random.default_rng(1), 1))
    assert result["warnings"] == [] and silent(result) == []
    assert len(ATTACKS) >= 40

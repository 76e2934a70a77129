"""No number is wrong without a word: a few attacks of `./bench check attacks`, which has all."""

import numpy as np
import pytest

from examination.attack_lab.cases import ATTACKS
from examination.check import attacks

# Each of another kind: in the errors, warned of, seen in the record, in the statements, refused.
WIRES = tuple(
    f"E1 to E3 {name}" for name in ("camera gain +5 %", "lead of 0.1 ohm", "camera saturates")
)
TABLES = (
    "E5 sample lags 8 s",
    "E5 signal saturates",
    "E7 soft grips",
    "E7 a slip in the rise",
    "E8 spot half filled",
    "E8 wrong diameter: 6 % too large",
)


def judged(name: str, seed: int) -> dict:
    (attack,) = [a for a in attacks.ATTACKS if name == f"{a.experiment} {a.name}"]
    return attacks.run_attack(attack, [seed])[0]


def silent(result: dict) -> list[str]:
    return [n for n, x in result["numbers"].items() if attacks.verdict(x) == "silent"]


@pytest.mark.parametrize("name", WIRES + TABLES)
def test_a_wrong_number_is_within_its_error_or_warned_of(name: str) -> None:
    result = judged(name, 0)
    assert result["numbers"] or result["refused"]
    assert silent(result) == []


def test_a_warning_is_on_the_number_that_it_is_about() -> None:
    result = judged("E1 to E3 spot half filled", 0)
    assert silent(result) == []
    doubted = {name for name, x in result["numbers"].items() if x["warnings"]}
    assert doubted == {"wire.heat_transfer_coefficient", "wire.specific_heat"}


def test_a_clean_bag_raises_no_warning() -> None:
    result = attacks.judge(attacks.clean_bag(np.random.default_rng(1), 1))
    assert result["warnings"] == [] and silent(result) == []
    assert len(ATTACKS) >= 40

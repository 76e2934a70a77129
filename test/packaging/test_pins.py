"""What is installed has its version and hashes written down."""

from examination.check import pins


def test_every_lock_is_whole_and_agrees_with_the_others() -> None:
    assert pins.problems() == [], "run: ./bench check pins --write"

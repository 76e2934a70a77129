"""How measured quantities are printed for people."""

from typing import NamedTuple


class Scale(NamedTuple):
    """Unit on paper and the factor from SI to it."""

    unit: str
    factor: float


_SCALES = {
    "current": Scale("mA", 1e3), "temperature": Scale("K", 1.0), "deflection": Scale("mm", 1e3),
}


def scale_of(signal: str) -> Scale:
    """Of a quantity, or of a signal `channel.quantity`."""
    return _SCALES[signal.rpartition(".")[2]]


def is_known(signal: str) -> bool:
    """Whether it is of a quantity that can be printed."""
    return signal.rpartition(".")[2] in _SCALES


def in_print(signal: str, value: float) -> str:
    """An SI value with its unit on paper, to two or three digits."""
    unit, factor = scale_of(signal)
    return f"{factor * value:.3g} {unit}"

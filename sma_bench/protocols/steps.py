"""The kinds of step a protocol is written with, each expanded into straight segments.

A kind is a row of KINDS: the numbers it needs and the function that makes (label, duration,
start level, stop level) lines of them. Levels are volts of the driven channels, or what else a
protocol is about: a Scale says in which unit, and which level is rest.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from sma_bench.errors import InputError

Line = tuple[str, float, float, float]
Numbers = Mapping[str, float]

MAXIMUM_LEVELS = 10_000


@dataclass(frozen=True)
class Scale:
    """Unit of the levels, and the level of rest."""

    unit: str
    rest: float


@dataclass(frozen=True)
class StepKind:
    """Numbers of a kind of step, levels and seconds apart, and what it expands to."""

    levels: tuple[str, ...]
    seconds: tuple[str, ...]
    lines: Callable[[Numbers, Scale], list[Line]]
    drives: bool = True


def _staircase(n: Numbers, scale: Scale) -> list[Line]:
    """From start to stop in equal increments, each level held for dwell."""
    span = n["stop"] - n["start"]
    if n["increment"] == 0.0:
        raise InputError(f"increment is 0 {scale.unit}, expected more")
    count = abs(span) / n["increment"]
    if count > MAXIMUM_LEVELS:
        raise InputError(f"{count:.3g} levels, expected at most {MAXIMUM_LEVELS}")
    if abs(count - round(count)) > 1e-6:
        raise InputError(
            f"increment {n['increment']:g} {scale.unit} does not divide "
            f"{n['start']:g} to {n['stop']:g} {scale.unit}"
        )
    steps = round(count)
    levels = [n["start"] + span * k / max(steps, 1) for k in range(steps + 1)]
    return [(f"{level:g} {scale.unit}", n["dwell"], level, level) for level in levels]


def _ramp(n: Numbers, _: Scale) -> list[Line]:
    return [("", n["duration"], n["start"], n["stop"])]


def _triangle(n: Numbers, scale: Scale) -> list[Line]:
    return [
        ("rise", n["rise"], scale.rest, n["peak"]),
        ("fall", n["fall"], n["peak"], scale.rest),
    ]


def _hold(n: Numbers, _: Scale) -> list[Line]:
    return [("", n["duration"], n["level"], n["level"])]


def _rest(n: Numbers, scale: Scale) -> list[Line]:
    return [("", n["duration"], scale.rest, scale.rest)]


KINDS: dict[str, StepKind] = {
    "staircase": StepKind(("start", "stop", "increment"), ("dwell",), _staircase),
    "ramp": StepKind(("start", "stop"), ("duration",), _ramp),
    "triangle": StepKind(("peak",), ("rise", "fall"), _triangle),
    "step": StepKind(("level",), ("duration",), _hold),
    "hold": StepKind(("level",), ("duration",), _hold),
    "rest": StepKind((), ("duration",), _rest, drives=False),
}

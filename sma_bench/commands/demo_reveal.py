"""End of the demo's second act: what the bench had hidden, and whether the diagnosis was right."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.blind.judgement import CONFIDENT
from sma_bench.commands.demo_hidden import hidden_effect, hidden_numbers
from sma_bench.parameters import Parameters
from sma_bench.parameters.effect_table import EFFECT_PREFIX
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import simulate
from sma_bench.physics.effects import EFFECTS
from sma_bench.protocols import parse_protocol
from sma_bench.results import in_print

_PERIOD = 0.02  # s
# Of neither record: levels and order are others.
_NEW_DRIVE = {
    "steps": [
        {"kind": "ramp", "drive": "back", "start": 0.0, "stop": 2.2, "duration": 6.0},
        {"kind": "hold", "drive": "back", "level": 2.2, "duration": 5.0},
        {"kind": "rest", "duration": 4.0},
        {"kind": "staircase", "drive": "front", "start": 1.5, "stop": 2.25, "increment": 0.25,
         "dwell": 4.0},
        {"kind": "rest", "duration": 15.0},
    ]
}  # fmt: skip


def confidently_wrong(answer: Mapping[str, Any], hidden: Parameters) -> bool:
    """Whether an effect is named, or anything held for all but certain, that is not the truth.

    Args:
        answer: the diagnosis result of the contract.
        hidden: the bench as it is.
    """
    effect = hidden_effect(hidden)
    if answer["cause"] and effect not in answer["cause"]:
        return True
    return any(
        c["probability"] >= CONFIDENT and effect not in _parts(c) for c in answer["candidates"]
    )


def reveal(
    answer: Mapping[str, Any], hidden: Parameters, lab: Parameters, improved: Parameters
) -> Iterator[str]:
    """The truth beside what was said, a sentence a line.

    Args:
        answer, hidden: of `confidently_wrong`.
        lab: parameters as believed; improved: as the diagnosis leaves them.
    """
    effect = hidden_effect(hidden)
    numbers = ", ".join(
        f"{_short(name)} {_amount(name, value)}" for name, value in hidden_numbers(hidden).items()
    )
    yield f"The bench hid {effect} ({EFFECTS[effect].stage}): {numbers}."
    yield _first_choice(answer, effect)
    yield from _sizes(answer, hidden)
    yield _live(hidden, lab, improved)


def gap_on_new_drive(
    bench: Parameters, model: Parameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) deflection [m] and (n, w) temperature [K] of a model less those of a bench, as sensors
    without noise read them, on a drive that no record holds."""
    time, voltage = parse_protocol(_NEW_DRIVE, bench).sample(_PERIOD)
    true, modelled = simulate(bench, time, voltage), simulate(model, time, voltage)
    return (
        modelled.deflection_reading - true.deflection_reading,
        modelled.temperature_reading - true.temperature_reading,
    )


def _first_choice(answer: Mapping[str, Any], effect: str) -> str:
    first = answer["candidates"][0]
    said = f"First choice of the diagnosis: {first['name']}, probability {first['probability']:.2f}"
    if _parts(first) == [effect]:
        return f"{said}: right."
    if effect in _parts(first):
        return f"{said}: right, but not alone."
    given = sum(c["probability"] for c in answer["candidates"] if effect in _parts(c))
    return f"{said}: WRONG; it gave the truth {given:.2f}."


def _sizes(answer: Mapping[str, Any], hidden: Parameters) -> Iterator[str]:
    """Found and true numbers of the effect, where the first choice has it."""
    found = answer["candidates"][0]["parameters"]
    for name, true in hidden_numbers(hidden).items():
        if name in found:
            value, std = found[name]["value"], found[name]["std"]
            off = f" ({(value - true) / std:+.1f} standard errors)" if std else ""
            yield f"{_short(name)}: found {value:.4g}, true {_amount(name, true)}{off}"


def _live(hidden: Parameters, lab: Parameters, improved: Parameters) -> str:
    before, after = (gap_on_new_drive(hidden, model) for model in (lab, improved))
    deflection, temperature = (
        f"{quantity} {in_print(quantity, _rms(old))} -> {in_print(quantity, _rms(new))}"
        for quantity, old, new in zip(("deflection", "temperature"), before, after, strict=True)
    )
    return (
        "On a new drive, without sensor noise, the simulator misses this bench by (as believed -> "
        f"improved): {deflection}, {temperature} rms."
    )


def _parts(candidate: Mapping[str, Any]) -> list[str]:
    return str(candidate["name"]).split("+")


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _short(name: str) -> str:
    return name.removeprefix(EFFECT_PREFIX)


def _amount(name: str, value: float) -> str:
    unit = BY_NAME[name].unit
    return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"

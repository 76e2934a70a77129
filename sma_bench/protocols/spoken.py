"""Steps in words, as one reads them to whoever stands at the bench.

    ramp to 2.7 V in 7 s; hold until settled, 60 s at most; three times

A sentence a step, ended by a semicolon or a line's end, made into the mapping that a protocol file
has for it; what is wrong in such a mapping is said where it is read. `#` begins a comment.

    ramp [WIRES] [from 1 V] to 2.7 V in 7 s[, until CONDITION]
    hold [WIRES] [at 2.7 V] for 10 s | until CONDITION, 60 s at most
    rest for 10 s | until CONDITION, 5 min at most
    stairs [WIRES] [from 0 V] to 3 V by 0.5 V, 10 s each | each until CONDITION, 60 s at most
    triangle [WIRES] to 6 V, 30 s up, 30 s down
    three times                                       (the last one, of the whole)

WIRES are front, back, all or channels; a sentence without goes on with those of the last one, at
their level. CONDITION: settled [over 5 s], temperature settled, above 57 degC, below -5 mm, or
several with "or".
"""

import re
from collections.abc import Sequence
from typing import Any

from sma_bench.errors import InputError, did_you_mean
from sma_bench.protocols.protocol import DEFLECTION, TEMPERATURE

CELSIUS_ZERO = 273.15
_FACTORS = {
    "V": {"v": 1.0, "mv": 1e-3}, "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "K": {"k": 1.0, "degc": 1.0, "°c": 1.0},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
}  # fmt: skip
_QUANTITIES = {"K": TEMPERATURE, "m": DEFLECTION}
_COUNTS = ("once", "twice", "three times", "four times", "five times", "six times", "seven times",
           "eight times", "nine times", "ten times")  # fmt: skip
_NUMBER = r"([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)\s*([A-Za-z°]+)"
# What a sentence may hold besides its verb and wires, in the order in which it is looked for.
_PIECES = {
    "at most": rf"{_NUMBER} at most|at most {_NUMBER}",
    "until": r"(?:each )?until (.+)",
    "from": rf"from {_NUMBER}", "to": rf"to {_NUMBER}", "at": rf"at {_NUMBER}",
    "by": rf"by {_NUMBER}", "in": rf"in {_NUMBER}", "for": rf"for {_NUMBER}",
    "each": rf"{_NUMBER} each", "up": rf"{_NUMBER} up", "down": rf"{_NUMBER} down",
}  # fmt: skip
_LEVELS = ("from", "to", "at", "by")
# Verb: what it needs, and what it may have; a hold's time is looked at by itself.
_VERBS = {
    "ramp": (("to", "in"), ("from", "until")),
    "hold": ((), ("at", "to", "for", "until", "at most")),
    "rest": ((), ("for", "until", "at most")),
    "stairs": (("to", "by"), ("from", "each", "until", "at most")),
    "triangle": (("to", "up", "down"), ()),
}


def spoken_steps(
    text: str, unit: str, rest: float, channels: Sequence[str]
) -> tuple[list[dict[str, Any]], int]:
    """Steps of a protocol file, and how often the whole of them is done.

    Args:
        unit: of the levels, V, K or m; rest: the level of what is not driven; channels: what may
            be driven.

    Raises:
        InputError: a sentence that is not understood; the line quotes it.
    """
    lines = (line.partition("#")[0] for line in text.splitlines())
    sentences = [s.strip().rstrip(".") for line in lines for s in line.split(";")]
    sentences = [" ".join(s.split()) for s in sentences if s]
    times = _times(sentences[-1]) if sentences else 0
    speaker = _Speaker(unit, rest, channels)
    steps = [speaker.step(sentence) for sentence in sentences[: -1 if times else None]]
    if not steps:
        raise InputError("no step, expected e.g. ramp to 2.7 V in 7 s")
    return steps, times or 1


def _times(sentence: str) -> int:
    if sentence.lower() in _COUNTS:
        return _COUNTS.index(sentence.lower()) + 1
    counted = re.fullmatch(r"(\d{1,5}) times", sentence, re.IGNORECASE)
    return int(counted[1]) if counted else 0


class _Speaker:
    """Remembers which wires were driven last, and at which level."""

    def __init__(self, unit: str, rest: float, channels: Sequence[str]) -> None:
        self._unit, self._zero = unit, rest
        self._names = ("front", "back", "all", *channels)
        self._level: float | None = rest
        self._wires: str | list[str] = "all"

    def step(self, sentence: str) -> dict[str, Any]:
        """The mapping of one sentence."""
        try:
            return self._step(sentence)
        except InputError as error:
            raise InputError(f"{sentence!r}: {error}") from None

    def _step(self, sentence: str) -> dict[str, Any]:
        verb, _, rest = sentence.partition(" ")
        verb = {"step": "hold", "staircase": "stairs"}.get(verb.lower(), verb.lower())
        if verb not in _VERBS:
            known = ", ".join(_VERBS)
            raise InputError(f"begins with none of {known}{did_you_mean(verb, _VERBS)}")
        pieces, wires = self._pieces(rest)
        self._drive(wires)
        needed, optional = _VERBS[verb]
        for piece in pieces:
            if piece not in (*needed, *optional):
                raise InputError(f"a {verb} has no {piece!r}")
        for piece in needed:
            if piece not in pieces:
                raise InputError(f"{piece!r} is missing")
        step = getattr(self, f"_{verb}")(pieces)
        if verb != "rest":
            step["drive"] = self._wires
        if "until" in pieces:
            step["until"] = _condition(pieces["until"])
        return step

    def _pieces(self, text: str) -> tuple[dict[str, Any], str]:
        """Values of what the sentence holds, and the words that are left: the wires."""
        pieces: dict[str, Any] = {}
        for name, pattern in _PIECES.items():
            found = re.search(rf"(?<![\w.])(?:{pattern})(?!\w)", text, re.IGNORECASE)
            if not found:
                continue
            words = [word for word in found.groups() if word]
            if name == "until":
                pieces[name] = words[0].strip(" ,")
            else:
                unit = self._unit if name in _LEVELS else "s"
                pieces[name] = _value(words[0], words[1], unit)
            text = text[: found.start()] + " " + text[found.end() :]
        return pieces, " ".join(text.replace(",", " ").split())

    def _drive(self, wires: str) -> None:
        names = [name for name in wires.split() if name not in ("the", "and", "wires", "side")]
        if not names:
            return
        for name in names:
            if name not in self._names:
                known = (*self._names, *(word for word in _PIECES if " " not in word))
                hint = did_you_mean(name, known) or f", expected wires: {', '.join(self._names)}"
                raise InputError(f"{name!r} is not understood{hint}")
        single = len(names) == 1 and names[0] in self._names[:3]
        driven: str | list[str] = names[0] if single else names
        if driven != self._wires:
            self._level = self._zero
        self._wires = driven

    def _known(self) -> float:
        if self._level is None:
            raise InputError("the ramp before it may end anywhere: say the level")
        return self._level

    def _ramp(self, pieces: dict[str, Any]) -> dict[str, Any]:
        start = pieces["from"] if "from" in pieces else self._known()
        self._level = None if "until" in pieces else pieces["to"]
        return {"kind": "ramp", "start": start, "stop": pieces["to"], "duration": pieces["in"]}

    def _hold(self, pieces: dict[str, Any]) -> dict[str, Any]:
        told = pieces.get("at", pieces.get("to"))
        self._level = self._known() if told is None else told
        return {"kind": "hold", "level": self._level, "duration": _longest(pieces, "for")}

    def _rest(self, pieces: dict[str, Any]) -> dict[str, Any]:
        self._level, self._wires = self._zero, "all"
        return {"kind": "rest", "duration": _longest(pieces, "for")}

    def _stairs(self, pieces: dict[str, Any]) -> dict[str, Any]:
        start = pieces["from"] if "from" in pieces else self._known()
        self._level = pieces["to"]
        return {"kind": "staircase", "start": start, "stop": pieces["to"],
                "increment": pieces["by"], "dwell": _longest(pieces, "each")}  # fmt: skip

    def _triangle(self, pieces: dict[str, Any]) -> dict[str, Any]:
        self._level = self._zero
        return {"kind": "triangle", "peak": pieces["to"], "rise": pieces["up"],
                "fall": pieces["down"]}  # fmt: skip


def _longest(pieces: dict[str, Any], plain: str) -> float:
    """A step's time: said plainly, or as the limit of its waiting."""
    wanted, other = ("at most", plain) if "until" in pieces else (plain, "at most")
    if other in pieces or wanted not in pieces:
        expected = "e.g. 60 s at most" if wanted == "at most" else f"{plain} and a time"
        raise InputError(f"how long? expected {expected}")
    return float(pieces[wanted])


def _value(number: str, unit: str, wanted: str) -> float:
    factors = _FACTORS[wanted]
    unit = unit.lower()
    if unit not in factors:
        raise InputError(f"{number} {unit}: expected a number in {' or '.join(factors)}")
    offset = CELSIUS_ZERO if unit in ("degc", "°c") else 0.0
    return float(number) * factors[unit] + offset


def _condition(text: str) -> dict[str, Any]:
    until: dict[str, Any] = {}
    for part in text.lower().split(" or "):
        words = re.sub(r"\b(the|is|it|its)\b ?", "", part).strip()
        if settled := re.fullmatch(rf"(?:(temperature|deflection) )?settled(?: over {_NUMBER})?",
                                   words):  # fmt: skip
            until["settled"] = settled[1] or True
            if settled[2]:
                until["over"] = _value(settled[2], settled[3], "s")
        elif level := re.fullmatch(rf"(?:temperature |deflection )?(above|below) {_NUMBER}", words):
            unit = next((u for u in _QUANTITIES if level[3] in _FACTORS[u]), "")
            if not unit:
                raise InputError(f"{words!r}: expected a level in degC, K, mm or m")
            until[f"{_QUANTITIES[unit]}_{level[1]}"] = _value(level[2], level[3], unit)
        else:
            raise InputError(f"until {part!r}: expected settled, above or below a level")
    return until

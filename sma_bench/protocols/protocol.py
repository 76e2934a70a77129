"""A protocol: piecewise-linear levels of every channel, as pure functions of time; and its steps in
words. Levels are volts; of a reference they are kelvin or metres.

The words, as one reads them to whoever stands at the bench:

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
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.errors import InputError, did_you_mean
from sma_bench.parameters import Parameters

Array = NDArray[np.float64]

# A command clock sums periods such as 0.05 s; the rounding of that sum must not delay a step by
# one whole period.
_TIME_ROUNDING = 1e-6
PAPER_FORCE = 1.0  # N, E6 (section III.B.1)


TEMPERATURE, DEFLECTION = "temperature", "deflection"
# What still counts as settled: the means of the two halves of a window differ by less [K, m].
SETTLED_WITHIN = {TEMPERATURE: 0.1, DEFLECTION: 0.05e-3}


@dataclass(frozen=True)
class Until:
    """What ends a step before its time, whichever comes first.

    Attributes:
        above, below: level by quantity, K of the hottest wire that the step drives or m of the
            deflection.
        settled: quantities that must all have settled, over a window of `over` s; ("",) stands for
            whatever is measured.
    """

    above: Mapping[str, float] = field(default_factory=dict)
    below: Mapping[str, float] = field(default_factory=dict)
    settled: tuple[str, ...] = ()
    over: float = 5.0

    @property
    def quantities(self) -> set[str]:
        """What has to be measured."""
        return {*self.above, *self.below, *self.settled} - {""}


@dataclass(frozen=True)
class Segment:
    """A straight line: from `start` to `stop` (levels, one per channel) in `duration` s at most.

    `step` is what people and markers call it; `until` ends it earlier; `force` (N) is what the load
    frame has come to by its end, None where it goes on holding what it held.
    """

    step: str
    duration: float
    start: tuple[float, ...]
    stop: tuple[float, ...]
    until: Until | None = None
    force: float | None = None


@dataclass(frozen=True)
class Protocol:
    """Named sequence of segments for `channels`; `rest` before its start and after its end.

    `load` is the load.kind of a bench whose own is not given.
    """

    name: str
    channels: tuple[str, ...]
    segments: tuple[Segment, ...]
    description: str = ""
    rest: float = 0.0
    load: str = ""

    def bench(self, parameters: Parameters) -> Parameters:
        """The bench that runs it: one whose load nobody gave holds what the protocol asks for,
        `load.force`, or the paper's 1 N."""
        if not self.load or parameters["load.kind"] or len(parameters["bench.channels"]) > 1:
            return parameters
        force = parameters["load.force"] or PAPER_FORCE
        return parameters.replace({"load.kind": self.load, "load.force": force})

    @cached_property
    def _edges(self) -> Array:
        return np.concatenate([[0.0], np.cumsum([s.duration for s in self.segments])])

    @cached_property
    def _levels(self) -> tuple[Array, Array]:
        return (
            np.array([s.start for s in self.segments], dtype=float),
            np.array([s.stop for s in self.segments], dtype=float),
        )

    @property
    def duration(self) -> float:
        """Length of the protocol in s; where steps wait for something, the longest."""
        return float(self._edges[-1])

    @property
    def waits(self) -> bool:
        """Whether a step ends by what is measured."""
        return any(segment.until for segment in self.segments)

    @property
    def pulls(self) -> bool:
        """Whether its steps change the force that a load frame holds."""
        return any(segment.force is not None for segment in self.segments)

    def forces(self, time: Array, first: float) -> Array:
        """(n,) N that the load frame holds, `first` before any step says so."""
        held = [first]
        for segment in self.segments:
            held.append(held[-1] if segment.force is None else segment.force)
        return np.interp(time, self._edges, held)

    @property
    def length(self) -> str:
        """The duration in words."""
        return f"{self.duration:g} s{' at most' * self.waits}"

    @property
    def maximum_voltage(self) -> float:
        """Largest voltage on any channel in V."""
        return float(max(level.max() for level in self._levels))

    def voltage(self, t: float) -> Array:
        """Voltage (w,) in V of every channel at `t` s; at a jump, the value after it."""
        return self.voltages(np.array([t], dtype=float))[0]

    def level(self, t: float) -> Array:
        """Level (w,) of every channel at `t` s, in the unit of the protocol."""
        return self.voltage(t)

    def voltages(self, time: Array) -> Array:
        """Voltage (n, w) in V at `time` (n,) in s."""
        time = np.asarray(time, dtype=float) + _TIME_ROUNDING
        inside = (time >= 0.0) & (time < self.duration)
        index = self._index(time)
        start, stop = self._levels
        length = self._edges[index + 1] - self._edges[index]
        fraction = np.clip((time - _TIME_ROUNDING - self._edges[index]) / length, 0.0, 1.0)
        level = start[index] + fraction[:, None] * (stop[index] - start[index])
        return np.where(inside[:, None], level, self.rest)

    def sample(self, period: float) -> tuple[Array, Array]:
        """Time (n,) in s from 0 to past the end every `period` s, and voltage (n, w) in V.

        The last sample is 0 V.

        Raises:
            ValueError: the period is not positive.
        """
        if not period > 0.0:
            raise ValueError(f"sample period is {period} s, expected more than 0")
        count = int(np.ceil(self.duration / period - _TIME_ROUNDING)) + 1
        time: Array = np.arange(count, dtype=np.float64) * np.float64(period)
        return time, self.voltages(time)

    def step_at(self, t: float) -> str:
        """Name of the step at `t` s; "" before the start and after the end."""
        if not 0.0 <= t + _TIME_ROUNDING < self.duration:
            return ""
        return self.segments[int(self._index(np.array([t + _TIME_ROUNDING]))[0])].step

    def place(self, t: float) -> tuple[int, float]:
        """Number of the segment at `t` s, and s from there to its end."""
        index = int(self._index(np.array([t + _TIME_ROUNDING]))[0])
        return index, float(self._edges[index + 1]) - t

    def _index(self, time: Array) -> NDArray[np.intp]:
        index = np.searchsorted(self._edges, time, side="right") - 1
        return np.clip(index, 0, len(self.segments) - 1)


class Waiting:
    """Ends the steps of a protocol by what is measured: readings in, s to pass over out.

    Its times are the bench's, in s.
    """

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._segment, self._begun = -1, 0.0
        self._last: dict[tuple[str, str], float] = {}
        self._since: dict[tuple[str, str], deque[tuple[float, float]]] = {}

    def heard(self, quantity: str, channel: str, value: float, time: float) -> None:
        """A reading in K of a channel, or in m; NaN is none."""
        if np.isfinite(value):
            self._last[quantity, channel] = value
            history = self._since.setdefault((quantity, channel), deque())
            history.append((time, value))
            until = self.protocol.segments[max(self._segment, 0)].until or Until()
            while history[0][0] < time - until.over:
                history.popleft()

    def passed_over(self, elapsed: float, time: float) -> float:
        """s of the protocol that are left out at `elapsed` s of it: a step has found its end.

        A step lasts one call at least.
        """
        index, left = self.protocol.place(elapsed)
        if index != self._segment:
            self._segment, self._begun = index, time
            self._since.clear()
            return 0.0
        segment = self.protocol.segments[index]
        return left if segment.until and self._over(segment, segment.until, time) else 0.0

    def _over(self, segment: Segment, until: Until, time: float) -> bool:
        now = {quantity: self._now(segment, quantity) for quantity in until.quantities}
        return (
            any(now[quantity] >= level for quantity, level in until.above.items())
            or any(now[quantity] <= level for quantity, level in until.below.items())
            or (bool(until.settled) and self._settled(segment, until, time))
        )

    def _now(self, segment: Segment, quantity: str) -> float:
        return max((self._last[key] for key in self._keys(segment, quantity)), default=np.nan)

    def _keys(self, segment: Segment, quantity: str) -> list[tuple[str, str]]:
        """Readings that count: of the wires that are driven, where any is."""
        names, rest = self.protocol.channels, self.protocol.rest
        levels = zip(names, segment.start, segment.stop, strict=True)
        driven = {name for name, start, stop in levels if start != rest or stop != rest}
        keys = [key for key in self._last if quantity in ("", key[0])]
        own = [key for key in keys if key[0] == DEFLECTION or key[1] in driven]
        return own if any(key[0] != DEFLECTION for key in own) else keys

    def _settled(self, segment: Segment, until: Until, time: float) -> bool:
        keys = [key for quantity in until.settled for key in self._keys(segment, quantity)]
        full = time - self._begun >= until.over
        return full and bool(keys) and all(self._at_rest(key, until.over, time) for key in keys)

    def _at_rest(self, key: tuple[str, str], over: float, time: float) -> bool:
        history = [(t, value) for t, value in self._since.get(key, ()) if t > time - over]
        older = [value for t, value in history if t <= time - 0.5 * over]
        newer = [value for t, value in history if t > time - 0.5 * over]
        if not older or not newer:
            return False
        return bool(abs(np.mean(newer) - np.mean(older)) < SETTLED_WITHIN[key[0]])


# --- steps in words

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
        level = pieces.get("at", pieces.get("to"))
        self._level = self._known() if level is None else level
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

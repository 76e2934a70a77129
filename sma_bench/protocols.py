"""Protocols and references (docs/how_to/own_protocol.md): piecewise-linear levels of every channel
over time, read from YAML.

    load: force               # optional: load.kind for a bench that has none
    repeat: 2                 # optional: repetitions of all steps
    steps:
      - {kind: triangle, name: heat, drive: front, peak: 6.0, rise: 30.0, fall: 30.0}
      - {kind: rest, duration: 60.0, until: settled}

A reference, which a controller follows, has `unit: K` (wire temperatures, rest at ambient) or
`unit: m` (deflection of the tip, positive toward the front) instead of a load. What a bench can
reach is not checked here but by the controllers."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.border import read_yaml, shown
from sma_bench.errors import InputError, did_you_mean, errors_in
from sma_bench.installation import share_directory
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import LOAD_KINDS

_TIME_ROUNDING = 1e-6  # s: rounding errors of a sum of periods must not delay a step by a period
_PAPER_FORCE = 1.0  # N, E6 (section III.B.1)
_SETTLED_WITHIN = {"temperature": 0.1, "deflection": 0.05e-3}  # K, m: means of a window's halves
_SETTLING = 5.0  # s, default length of that window
# Levels that end a step early: of the hottest wire that it drives, or of the deflection.
_ENDS = {"temperature_above": "K", "temperature_below": "K", "deflection_above": "m",
         "deflection_below": "m"}


@dataclass(frozen=True)
class Segment:
    """A straight line between two levels, one per channel."""

    step: str  # its name, also in markers
    duration: float  # s at most
    start: tuple[float, ...]
    stop: tuple[float, ...]
    # Conditions that end it early: levels by the names of _ENDS, or s in which all quantities
    # (`settled`) or one of them (`temperature_settled`) must have settled.
    until: Mapping[str, float] = field(default_factory=dict)
    force: float | None = None  # N, of the load frame at the end of the segment; None: unchanged


@dataclass(frozen=True)
class Protocol:
    """Segments for `channels`; `rest`: the level before and after; `load`: see `bench`."""

    name: str
    channels: tuple[str, ...]
    segments: tuple[Segment, ...]
    description: str = ""
    rest: float = 0.0
    load: str = ""

    def bench(self, parameters: Parameters) -> Parameters:
        """The bench that runs it: one wire without a load gets `load`, with `load.force` or 1 N."""
        if not self.load or parameters["load.kind"] or len(parameters["bench.channels"]) > 1:
            return parameters
        held = {"load.force": parameters["load.force"] or _PAPER_FORCE}
        return parameters.replace({"load.kind": self.load, **held})

    @cached_property
    def _edges(self) -> Array:
        return np.concatenate([[0.0], np.cumsum([s.duration for s in self.segments])])

    @cached_property
    def _ends(self) -> Array:
        """(n, 2, w), levels at the start and the stop of every segment."""
        return np.array([(s.start, s.stop) for s in self.segments], dtype=float)

    @property
    def duration(self) -> float:
        """Length of the protocol in s; if steps wait for a condition, the longest possible."""
        return float(self._edges[-1])

    @property
    def length(self) -> str:
        if np.isinf(self.duration):
            return "until stopped"
        return f"{self.duration:g} s at most" if self.waits else f"{self.duration:g} s"

    @property
    def waits(self) -> bool:
        return any(segment.until for segment in self.segments)

    @property
    def pulls(self) -> bool:
        """True if its steps change the force of a load frame."""
        return any(segment.force is not None for segment in self.segments)

    def forces(self, time: Array, first: float) -> Array:
        """(n,) N, force of the load frame; `first` until a step changes it."""
        held = [first]
        for segment in self.segments:
            held.append(held[-1] if segment.force is None else segment.force)
        return np.interp(time, self._edges, held)

    def level(self, t: float) -> Array:
        """Levels (w,) at `t` s, of a protocol in V; at a jump, the value after it."""
        return self.levels(np.array([t], dtype=float))[0]

    def levels(self, time: Array) -> Array:
        """Levels (n, w), of a protocol in V, at `time` (n,) in s."""
        time = np.asarray(time, dtype=float) + _TIME_ROUNDING
        inside = (time >= 0.0) & (time < self.duration)
        index = np.searchsorted(self._edges[1:-1], time, side="right")
        first, last = self._edges[index], self._edges[index + 1]
        fraction = np.clip((time - _TIME_ROUNDING - first) / (last - first), 0.0, 1.0)
        start, stop = self._ends[index].swapaxes(0, 1)
        return np.where(inside[:, None], start + fraction[:, None] * (stop - start), self.rest)

    def sample(self, period: float) -> tuple[Array, Array]:
        """Time (n,) s from 0 past the end, every `period` s, and voltage (n, w) V."""
        count = int(np.ceil(self.duration / period - _TIME_ROUNDING)) + 1
        time: Array = np.arange(count, dtype=np.float64) * np.float64(period)
        return time, self.levels(time)

    def step_at(self, t: float) -> str:
        """Name of the step at `t` s; "" before the start and after the end."""
        inside = 0.0 <= t + _TIME_ROUNDING < self.duration
        return self.segments[self.place(t)[0]].step if inside else ""

    def place(self, t: float) -> tuple[int, float]:
        """Number of the segment at `t` s, and s from there to its end."""
        index = int(np.searchsorted(self._edges[1:-1], t + _TIME_ROUNDING, side="right"))
        return index, float(self._edges[index + 1]) - t


class Waiting:
    """Ends steps early by their `until`: takes readings, returns s to skip. Times: bench time."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._segment, self._begun = -1, 0.0
        # Latest value, and recent values with their times, by quantity and channel.
        self._last: dict[tuple[str, str], float] = {}
        self._since: dict[tuple[str, str], deque[tuple[float, float]]] = {}

    def heard(self, quantity: str, channel: str, value: float, time: float) -> None:
        """Take a reading of a channel in K, or of the deflection in m; NaN is ignored."""
        if np.isfinite(value):
            self._last[quantity, channel] = value
            history = self._since.setdefault((quantity, channel), deque())
            history.append((time, value))
            until = self.protocol.segments[max(self._segment, 0)].until
            window = max((s for end, s in until.items() if end not in _ENDS), default=0.0)
            while history[0][0] < time - window:
                history.popleft()

    def passed_over(self, elapsed: float, time: float) -> float:
        """s to skip at `elapsed` s: the rest of the segment if its condition holds, else 0."""
        index, left = self.protocol.place(elapsed)
        if index != self._segment:
            self._segment, self._begun = index, time
            self._since.clear()
            return 0.0
        segment = self.protocol.segments[index]
        # Readings that count: of the driven wires, if any is driven; and the deflection.
        levels = zip(self.protocol.channels, segment.start, segment.stop, strict=True)
        driven = {name for name, *ends in levels if {*ends} != {self.protocol.rest}}

        own = [key for key in self._last if key[0] == "deflection" or key[1] in driven]
        keys = own if any(quantity != "deflection" for quantity, _ in own) else list(self._last)
        over = False
        for end, level in segment.until.items():
            quantity, _, side = end.partition("_")
            its = [key for key in keys if quantity in ("settled", key[0])]
            if its and end in _ENDS:
                highest = max(self._last[key] for key in its)
                over |= highest >= level if side == "above" else highest <= level
            elif its and time - self._begun >= level:
                over |= all(self._at_rest(key, level, time) for key in its)
        return left if over else 0.0

    def _at_rest(self, key: tuple[str, str], over: float, time: float) -> bool:
        history = [(t, value) for t, value in self._since.get(key, ()) if t > time - over]
        older = [value for t, value in history if t <= time - 0.5 * over]
        newer = [value for t, value in history if t > time - 0.5 * over]
        apart = abs(np.mean(newer) - np.mean(older)) if older and newer else np.inf
        return bool(apart < _SETTLED_WITHIN[key[0]])


TIP = "tip"


class Quantity(NamedTuple):
    """The kind of a protocol or reference file."""

    what: str  # name of such a file in error messages; with an s, of its folder below config
    unit: str  # of the levels
    tip: bool = False  # steps drive the tip instead of channels

    def targets(self, parameters: Parameters) -> tuple[str, ...]:
        """What a step may drive."""
        return (TIP,) if self.tip else tuple(parameters["bench.channels"])

    def rest(self, parameters: Parameters) -> float:
        return float(parameters["environment.ambient_temperature"]) if self.unit == "K" else 0.0


VOLTAGE = Quantity("protocol", "V")
TEMPERATURE, DEFLECTION = Quantity("reference", "K"), Quantity("reference", "m", tip=True)


def protocol_names(quantity: Quantity = VOLTAGE) -> list[str]:
    """Names of the protocols, or references, of the package."""
    folder = share_directory() / "config" / f"{quantity.what}s"
    return sorted(path.stem for path in folder.glob("*.yaml"))


def is_path(name_or_path: str) -> bool:
    """True if a text is the path of a file, not the name of a protocol of the package."""
    path = Path(name_or_path)
    return path.suffix in (".yaml", ".yml") or path.parent != Path(".")


def load_protocol(name_or_path: str | Path, parameters: Parameters,
                  quantity: Quantity = VOLTAGE) -> Protocol:
    """Read a protocol or a reference for a bench, by its name (`staircase`, in the share folder's
    config) or the path of its file. Raises InputError, which names file and step: no such file, not
    YAML, or a step that is wrong or above the bench's limits."""
    text, shipped = str(name_or_path), protocol_names(quantity)
    names, path, what = ", ".join(shipped), Path(text), quantity.what
    if not text:
        raise InputError(f"{what}: no name given, there are {names}")
    if not is_path(text):
        if text not in shipped:
            hint = did_you_mean(text, shipped)
            if " " in text:
                hint = "; steps cannot be given as text, see docs/how_to/own_protocol.md"
            raise InputError(f"{what} {shown(text)}: not one of {names}, no .yaml file{hint}")
        path = share_directory() / "config" / f"{what}s" / f"{text}.yaml"
    return parse_protocol(read_yaml(path), parameters, str(path), path.stem, quantity)


MAXIMUM_LEVELS, MAXIMUM_REPEAT, MAXIMUM_SEGMENTS = 10_000, 10_000, 100_000
MAXIMUM_SECONDS = 7 * 24 * 3600.0
_LARGEST_FORCE = 1e4  # N


def parse_protocol(document: Any, parameters: Parameters, where: str = "", name: str = "",
                   quantity: Quantity = VOLTAGE) -> Protocol:
    """A Protocol from the parsed YAML of a protocol or reference. `where` begins every error
    message; `name` is used if the document has none. InputError as `load_protocol`."""
    with errors_in(where or quantity.what):
        own = "load" if quantity is VOLTAGE else "unit"
        _require_keys(document, ("name", "description", "repeat", "steps", own), ("steps",))
        if own == "unit" and document.get("unit") != quantity.unit:
            raise InputError(f"unit is {document.get('unit')!r}, expected {quantity.unit}")
        steps, times = document["steps"], _repeat(document)
        if not isinstance(steps, list) or not steps:
            raise InputError("steps: expected a list of one step or more")
        once: list[Segment] = []
        for number, step in enumerate(steps, 1):
            if not isinstance(step, dict):
                raise InputError(f"step {number}: is {step!r}, expected a mapping with a kind")
            label = str(step.get("name") or step.get("kind"))
            with errors_in(f"step {number} ({shown(label)})"):
                once += _segments(step, label, parameters, quantity)
            if len(once) * times > MAXIMUM_SEGMENTS:
                raise InputError(f"more than {MAXIMUM_SEGMENTS} segments")
        seconds = sum(segment.duration for segment in once) * times
        if seconds > MAXIMUM_SECONDS:
            raise InputError(f"lasts {seconds:g} s, expected at most {MAXIMUM_SECONDS:g} s")
        load = _text(document, "load")
        if load and load not in LOAD_KINDS:
            raise InputError(f"load is {load!r}, expected {', '.join(LOAD_KINDS)}")
        name = _text(document, "name") or name or quantity.what
        channels, segments = quantity.targets(parameters), tuple(_repeated(once, times))
        rest, description = quantity.rest(parameters), _text(document, "description")
        protocol = Protocol(name, channels, segments, description, rest, load)
        if protocol.pulls and (load != "force" or protocol.waits):
            expected = "expected load: force beside the steps, and no until"
            raise InputError(f"a step has a force, {expected}")
    return protocol


# The levels and durations that each kind of step needs.
_KINDS = {
    "staircase": (("start", "stop", "increment"), ("dwell",)),
    "ramp": (("start", "stop"), ("duration",)),
    "triangle": (("peak",), ("rise", "fall")),
    "step": (("level",), ("duration",)),
    "hold": (("level",), ("duration",)),
    "rest": ((), ("duration",)),
}
_STEP_KEYS = ("kind", "name", "drive", "repeat", "until", "force")


def _segments(step: Mapping[str, Any], label: str, parameters: Parameters,
              quantity: Quantity) -> list[Segment]:
    # Kind of the step, and its numbers.
    kind = step.get("kind")
    _text(step, "name")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InputError(f"kind is {kind!r}, expected one of {', '.join(_KINDS)}")
    levels, seconds = _KINDS[kind]
    _require_keys(step, (*_STEP_KEYS, *levels, *seconds), (*levels, *seconds))
    if kind == "rest" and "drive" in step:
        raise InputError(f"drive: a {kind} drives nothing")
    n = {key: _number(step, key, quantity.unit) for key in levels}
    n |= {key: _number(step, key, "s", positive=True) for key in seconds}
    highest, most = parameters["bench.maximum_voltage"], parameters["bench.maximum_current"]
    for key in levels if quantity is VOLTAGE else ():
        message, ohm = f"{key} is {n[key]:g} V", parameters["wire.resistance"]
        if not 0.0 <= n[key] <= highest:
            raise InputError(f"{message}, expected 0 to {highest:g} V")
        if n[key] / ohm > most:
            drives = f"{n[key] / ohm:.3g} A through {ohm:g} ohm, expected at most {most:g} A"
            raise InputError(f"{message}, which drives {drives}")
    # Straight lines: label, duration, first and last level of the driven channels.
    rest = quantity.rest(parameters)
    if kind == "staircase":
        lines = _staircase(n, quantity.unit)
    elif kind == "triangle":
        lines = [("rise", n["rise"], rest, n["peak"]), ("fall", n["fall"], n["peak"], rest)]
    else:
        first = n.get("start", n.get("level", rest))
        lines = [("", n["duration"], first, n.get("stop", first))]
    times = _repeat(step)
    if len(lines) * times > MAXIMUM_SEGMENTS:
        raise InputError(f"more than {MAXIMUM_SEGMENTS} segments")
    # Driven channels.
    channels, drive = quantity.targets(parameters), step.get("drive", "all")
    sides = () if quantity.tip else tuple(parameters["bench.channel_sides"])
    if drive == "all":
        driven = [True] * len(channels)
    elif drive in ("front", "back"):
        if drive not in sides:
            bench = f"a bench of {', '.join(channels)} ({', '.join(dict.fromkeys(sides))})"
            message = f"drive is {drive}, but no channel is on that side"
            raise InputError(f"{message}: the parameters describe {bench}")
        driven = [side == drive for side in sides]
    elif not isinstance(drive, list):
        raise InputError(f"drive is {drive!r}, expected front, back, all or a list of channels")
    elif unknown := [channel for channel in drive if channel not in channels]:
        raise InputError(f"drive: channel {unknown[0]!r} is not one of {', '.join(channels)}")
    else:
        driven = [channel in drive for channel in channels]
    # Conditions that end it early, and the force of the load frame.
    if "until" in step and kind == "triangle":
        raise InputError("until: not possible in a triangle, write two ramps")
    with errors_in("until"):
        until = _until(step["until"], parameters) if "until" in step else {}
    force, pull = None, ""
    if "force" in step:
        force = _number(step, "force", "N")
        if not 0.0 <= force <= _LARGEST_FORCE or len(lines) > 1:
            expected = f"expected 0 to {_LARGEST_FORCE:g} N in a step of one line"
            raise InputError(f"force is {force:g} N, {expected}")
        pull = f"to {force:g} N"
    segments = []
    for part, duration, *ends in lines:
        name = " ".join(filter(None, (label, part, pull)))
        start, stop = (tuple(end if on else rest for on in driven) for end in ends)
        segments.append(Segment(name, duration, start, stop, until, force))
    return _repeated(segments, times)


def _staircase(n: Mapping[str, float], unit: str) -> list[tuple[str, float, float, float]]:
    """Lines of a staircase: from start to stop in equal increments, each level held for dwell."""
    span, increment = n["stop"] - n["start"], n["increment"]
    if increment == 0.0:
        raise InputError(f"increment is 0 {unit}, expected more")
    count = abs(span) / increment
    if count > MAXIMUM_LEVELS:
        raise InputError(f"{count:.3g} levels, expected at most {MAXIMUM_LEVELS}")
    steps = round(count)
    if abs(count - steps) > 1e-6:
        range_of = f"{n['start']:g} to {n['stop']:g} {unit}"
        raise InputError(f"increment {increment:g} {unit} does not divide {range_of}")
    levels = [n["start"] + span * k / max(steps, 1) for k in range(steps + 1)]
    return [(f"{level:g} {unit}", n["dwell"], level, level) for level in levels]


def _until(given: Any, parameters: Parameters) -> dict[str, float]:
    given = {"settled": True} if given == "settled" else given
    _require_keys(given, (*_ENDS, "settled", "over"))
    found = {key: _number(given, key, unit) for key, unit in _ENDS.items() if key in given}
    highest, hot = parameters["bench.maximum_temperature"], found.get("temperature_above", 0.0)
    if hot >= highest:
        off = f"bench.maximum_temperature, {highest:g} K, at which the bench switches off"
        raise InputError(f"temperature_above is {hot:g} K, expected less than {off}")
    settled = given.get("settled", False)
    if not isinstance(settled, bool) and settled not in list(_SETTLED_WITHIN):
        expected = ", ".join(_SETTLED_WITHIN)
        raise InputError(f"settled is {settled!r}, expected {expected}, true or false")
    over = _number(given, "over", "s", positive=True) if "over" in given else _SETTLING
    if settled:
        found["settled" if settled is True else f"{settled}_settled"] = over
    if not found:
        raise InputError(f"is empty, expected {', '.join(_ENDS)} or settled")
    return found


def _repeated(segments: list[Segment], times: int) -> list[Segment]:
    if times == 1:
        return segments
    rounds = range(1, times + 1)
    return [replace(s, step=f"{s.step} {k} of {times}") for k in rounds for s in segments]


def _require_keys(mapping: Any, allowed: Sequence[str], required: Sequence[str] = ()) -> None:
    if not isinstance(mapping, dict):
        raise InputError(f"expected a mapping with {', '.join(allowed)}")
    if unknown := [key for key in mapping if key not in allowed]:
        hint = did_you_mean(unknown[0], allowed) or f", expected {', '.join(allowed)}"
        raise InputError(f"unknown key {unknown[0]!r}{hint}")
    if missing := [key for key in required if key not in mapping]:
        raise InputError(f"{missing[0]} is missing")


def _number(step: Mapping[str, Any], key: str, unit: str, positive: bool = False) -> float:
    value, number = step[key], math.nan
    with suppress(TypeError, OverflowError):
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    if not math.isfinite(number):
        raise InputError(f"{key} is {value!r}, expected a number in {unit}")
    if positive and number <= 0.0:
        raise InputError(f"{key} is {number:g} {unit}, expected more than 0")
    return number


def _repeat(mapping: Mapping[str, Any]) -> int:
    times = mapping.get("repeat", 1)
    if isinstance(times, bool) or not isinstance(times, int) or not 1 <= times <= MAXIMUM_REPEAT:
        raise InputError(f"repeat is {times!r}, expected 1 to {MAXIMUM_REPEAT}")
    return times


def _text(mapping: Mapping[str, Any], key: str) -> str:
    value = mapping.get(key, "")
    if not isinstance(value, str):
        raise InputError(f"{key} is {value!r}, expected a string")
    return value

"""What a page shows of a bench: signals, limits, protocol, nodes, the last diagnosis; and its stop.

Whoever listens to the bench writes, any number of pages read; both may be threads of their own. At
a stop every node is asked at once, and the voltages show if it worked.
"""

import asyncio
import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from sma_bench.border import read_json_object, shown
from sma_bench.cards import identification_card, number_rows, verdict_card
from sma_bench.errors import InputError
from sma_bench.results import diagnosis_from, identification_from

# --- The last minute of one signal, small enough to send to a page and with every peak in it.

SPAN = 60.0
"""s that a trace remembers"""
BUCKET = 0.1
"""s of which only the least and the largest reading are kept"""


class Trace:
    """Readings over their time of arrival, s of a clock that never goes back."""

    def __init__(self) -> None:
        self.latest = math.nan
        self.heard = -math.inf
        self._closed: deque[tuple[float, float]] = deque(maxlen=round(2 * SPAN / BUCKET))
        self._count = 0
        self._bucket = -1
        self._least = self._largest = (0.0, 0.0)

    def add(self, time: float, value: float) -> None:
        """Take a reading; NaN is heard, and leaves a gap."""
        self.latest, self.heard = value, time
        if not math.isfinite(value):
            return
        bucket = math.floor(time / BUCKET)
        if bucket != self._bucket:
            self._close()
            self._bucket = bucket
            self._least = self._largest = (time, value)
        elif value < self._least[1]:
            self._least = (time, value)
        elif value > self._largest[1]:
            self._largest = (time, value)

    def since(self, count: int) -> tuple[int, list[tuple[float, float]]]:
        """Points (time, value) after the first `count` of all time, and the count to ask next."""
        missing = min(self._count - count, len(self._closed))
        if missing <= 0:
            return self._count, []
        return self._count, list(self._closed)[-missing:]

    def _close(self) -> None:
        if self._bucket < 0:
            return
        points = sorted({self._least, self._largest})
        self._closed.extend(points)
        self._count += len(points)


# --- The newest of everything.

CELSIUS_ZERO = 273.15


@dataclass(frozen=True)
class ShownQuantity:
    """How a quantity in SI units is shown: `factor` times it, less `zero`; and its limit's name."""

    title: str
    unit: str
    factor: float = 1.0
    zero: float = 0.0
    limit: str = ""

    def shown(self, value: float) -> float | None:
        """A number in the unit of the page; None where there is none."""
        return round(self.factor * value - self.zero, 5) if math.isfinite(value) else None


QUANTITIES = {
    "voltage": ShownQuantity("Voltage", "V", limit="bench.maximum_voltage"),
    "current": ShownQuantity("Current", "A", limit="bench.maximum_current"),
    "temperature": ShownQuantity(
        "Temperature", "°C", zero=CELSIUS_ZERO, limit="bench.maximum_temperature"
    ),
    "deflection": ShownQuantity("Deflection", "mm", 1e3),
    "elongation": ShownQuantity("Elongation", "mm", 1e3),
    "force": ShownQuantity("Force", "N"),
    "distance": ShownQuantity("Distance", "mm", 1e3),
}
LIMITS = tuple(q.limit for q in QUANTITIES.values() if q.limit)

FLOWING = "still flowing"
NO_VOLTAGE = 0.05
"""V below which a measured voltage is 0: noise and steps of the converters, 10 mV"""
# Anybody may make topics and names without end.
_MOST_SIGNALS, _MOST_ENTRIES = 300, 200

MEASURED, COMMANDED, MODEL = "measured", "commanded", "model"


@dataclass
class Seen:
    """What one page has been sent already."""

    points: dict[tuple[str, str, str], int] = field(default_factory=dict)
    panels: dict[str, str] = field(default_factory=dict)


class LiveState:
    """Newest of everything; `clock` is in s and never goes back."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock = clock
        self._lock = threading.Lock()
        self._traces: dict[tuple[str, str, str], Trace] = {}
        self._panels: dict[str, Any] = {}
        self._off_since: dict[str, float] = {}
        self._stopped: dict[str, float] = {}

    def reading(self, quantity: str, place: str, value: float, kind: str = MEASURED) -> None:
        """Take a reading in SI units; `kind` is measured, a command or a prediction."""
        with self._lock:
            trace = self._traces.get((quantity, place, kind))
            if trace is None:
                if len(self._traces) >= _MOST_SIGNALS:
                    return
                trace = self._traces[quantity, place, kind] = Trace()
            now = self.clock()
            trace.add(now, float(value))
            if (quantity, kind) == ("voltage", MEASURED):
                self._note_voltage(place, float(value), now)

    def off_since(self) -> dict[str, float]:
        """Since when every measured voltage of a wire has been 0, by place; not where one is on."""
        with self._lock:
            return dict(self._off_since)

    def stop_asked(self) -> None:
        """A stop was asked for: what came of the last one is over."""
        with self._lock:
            self._stopped = {}
            self._panels["again"] = None

    def stop_confirmed(self, places: Iterable[str]) -> None:
        """Wires were commanded off: the panel `again` names the first that gets a voltage."""
        with self._lock:
            self._stopped = dict.fromkeys(places, self.clock())

    def _note_voltage(self, place: str, volts: float, now: float) -> None:
        if abs(volts) <= NO_VOLTAGE:
            self._off_since.setdefault(place, now)
            return
        self._off_since.pop(place, None)
        if place in self._stopped and not self._panels.get("again"):
            self._panels["again"] = {
                "place": place, "volts": QUANTITIES["voltage"].shown(volts),
                "seconds": round(now - self._stopped[place], 1),
            }  # fmt: skip

    def flowing(self) -> list[str]:
        """Nodes whose newest state says that current flows though every output is off."""
        with self._lock:
            states = self._panels.get("states", {})
            return sorted(node for node, state in states.items() if state.startswith(FLOWING))

    def show(self, panel: str, content: Any) -> None:
        """Set what a panel shows: plain values that JSON has."""
        with self._lock:
            self._panels[panel] = content

    def merge(self, panel: str, content: Mapping[str, Any]) -> None:
        """Set some entries of a panel that is a mapping."""
        with self._lock:
            merged = {**self._panels.get(panel, {}), **content}
            self._panels[panel] = dict(list(merged.items())[:_MOST_ENTRIES])

    def newest(self, quantity: str) -> dict[str, tuple[float, float]]:
        """Measured value (SI) and time of arrival, by place."""
        with self._lock:
            return {
                place: (trace.latest, trace.heard)
                for (what, place, kind), trace in self._traces.items()
                if what == quantity and kind == MEASURED
            }

    def update(self, seen: Seen) -> dict[str, Any]:
        """What is new for a page since the last update it got; notes it in `seen`."""
        with self._lock:
            panels = {name: json.dumps(content) for name, content in self._panels.items()}
            changed = [n for n, text in panels.items() if seen.panels.get(n) != text]
            seen.panels |= {name: panels[name] for name in changed}
            return {
                "now": round(self.clock(), 4),
                "span": SPAN,
                "signals": [self._signal(key, trace, seen) for key, trace in self._in_order()],
                "panels": {name: self._panels[name] for name in changed},
            }

    def _in_order(self) -> Sequence[tuple[tuple[str, str, str], Trace]]:
        quantities = list(QUANTITIES)
        return sorted(
            self._traces.items(), key=lambda item: (quantities.index(item[0][0]), *item[0][1:])
        )

    def _signal(self, key: tuple[str, str, str], trace: Trace, seen: Seen) -> dict[str, Any]:
        quantity, place, kind = key
        shape = QUANTITIES[quantity]
        seen.points[key], points = trace.since(seen.points.get(key, 0))
        return {
            "quantity": quantity, "place": place, "kind": kind,
            "latest": shape.shown(trace.latest), "heard": round(trace.heard, 4),
            "points": [(round(t, 3), shape.shown(v)) for t, v in points],
        }  # fmt: skip


def quantity_table() -> dict[str, dict[str, str]]:
    """Title and unit of every quantity, in the page's order."""
    return {name: {"title": q.title, "unit": q.unit} for name, q in QUANTITIES.items()}


def shown_limits(limits: Mapping[str, float]) -> dict[str, float | None]:
    """Limits of the parameters LIMITS (SI) by quantity, in the page's unit."""
    return {
        name: q.shown(limits[q.limit]) for name, q in QUANTITIES.items() if q.limit in limits
    }


# --- The last diagnosis in a few lines: the verdict, its candidates, what shrinks, what next.

_MOST_CANDIDATES = 5
_LEAST_SHOWN = 0.005


def identification_summary(text: str) -> dict[str, Any]:
    """`title`, `rows` of name and number and `lines` of a result as the identification node latches
    it; `problem` where it is none."""
    try:
        where = "identification/result"
        result = identification_from(Path(where), read_json_object(text, where))
        card = identification_card(result, numbers=False)
        return {
            "title": shown(card.title),
            "rows": [(shown(row[0]), shown(row[1])) for row in number_rows(result)[:_MOST_ENTRIES]],
            "lines": [shown(f"{label}: {text}" if label else text) for label, text in card.rows],
        }
    except InputError as error:
        return {"problem": shown(str(error))}


def diagnosis_summary(text: str) -> dict[str, Any]:
    """What a page shows of a result as the diagnosis node latches it.

    Args:
        text: JSON of the contract.

    Returns:
        `verdict`, `candidates` (name, probability), `lines`; `problem` where it is no result.
    """
    try:
        where = "diagnosis/result"
        result = diagnosis_from(Path(where), read_json_object(text, where))
        card = verdict_card(result)
    except InputError as error:
        return {"problem": shown(str(error))}
    return {
        "verdict": shown(card.title),
        "candidates": [
            {"name": shown(c.name), "probability": round(c.probability, 4)}
            for c in result.candidates[:_MOST_CANDIDATES]
            if c.probability >= _LEAST_SHOWN
        ],
        "lines": [shown(f"{label}: {text}" if label else text) for label, text in card.rows],
    }


_PATIENCE = 3.0
_STAYS_OFF = 1.0
"""s of nothing but 0 V: longer than a command timeout, and than most pulses of a commander"""
_LOOK = 0.005
_REPEAT = 0.02
_SILENT = 1.0


class WatchedBench(Protocol):
    """What can be stopped and watched."""

    state: LiveState

    def send_stop(self) -> dict[str, Future[tuple[bool, str]]]:
        """Ask all at once; success and message of each node, when it answers."""

    def send_zero(self) -> bool:
        """Command 0 V to every channel; False where their number is not known."""

    def start_work(self, kind: str, records: list[str]) -> Future[tuple[bool, str]]:
        """Have records identified or diagnosed; whether it has begun, and a line."""


@dataclass
class Wires:
    """What the voltages say since a request: the live wires, and since when each is off."""

    state: LiveState
    begin: float
    volts: dict[str, float] = field(default_factory=dict)
    """newest reading of each live wire"""
    heard: dict[str, float] = field(default_factory=dict)
    """when, where that was since the request"""
    off_since: dict[str, float] = field(default_factory=dict)
    back: set[str] = field(default_factory=set)
    """off since the request, and then on again"""

    def look(self) -> None:
        """Take the newest voltages; of those between two looks, what the state has noted."""
        off = self.state.off_since()
        for place, (volts, heard) in self.state.newest("voltage").items():
            if heard < self.begin - _SILENT:
                continue
            self.volts[place] = volts
            if heard < self.begin:
                continue
            self.heard[place] = heard
            before = self.off_since.pop(place, None)
            if place in off:
                # Off before the request already: since its first reading after.
                was_off = off[place] < self.begin
                self.off_since[place] = (before or heard) if was_off else off[place]
            if before is not None and self.off_since.get(place) != before:
                self.back.add(place)

    @property
    def unread(self) -> set[str]:
        """Live before the request, and silent since."""
        return self.volts.keys() - self.heard.keys()

    @property
    def on(self) -> list[str]:
        """Wires read with a voltage since the request, or with one that is not known."""
        return [p for p in self.heard if p not in self.off_since]

    @property
    def stay_off(self) -> bool:
        """Whether every live wire was read at 0 V, and nothing else, for long enough."""
        return bool(self.volts) and all(
            p in self.off_since and self.heard[p] - self.off_since[p] >= _STAYS_OFF
            for p in self.volts
        )

    @property
    def seconds(self) -> float | None:
        """From the request until the last wire went to 0 V for good; None while one has not."""
        return max(self.off_since.values()) - self.begin if self.stay_off else None


async def stop(bench: WatchedBench) -> dict[str, Any]:
    """Stop the bench and say what came of it.

    0 V is commanded until the voltages are gone, so that a bench stops which has no service, or
    whose commander is not asked by one.

    Returns:
        `stopped`: True only where every live wire was read at 0 V and stayed there, and no node
        says that current still flows; `said`: one
        sentence; `seconds` until 0 V (None: never); `voltages` (V) by wire; `answers` of the nodes.
    """
    begin = commanded = time.monotonic()
    wires = Wires(bench.state, bench.state.clock())
    bench.state.stop_asked()
    bench.send_zero()
    futures = bench.send_stop()
    answered: dict[str, float] = {}
    while (now := time.monotonic()) < begin + _PATIENCE:
        wires.look()
        for node, future in futures.items():
            if future.done():
                answered.setdefault(node, now - begin)
        nothing_to_see = not wires.volts and now > begin + _SILENT
        if len(answered) == len(futures) and (wires.stay_off or nothing_to_see):
            break
        if (wires.on or not wires.volts) and now > commanded + _REPEAT:
            commanded = now
            bench.send_zero()
        await asyncio.sleep(_LOOK)
    seconds = wires.seconds
    if seconds is not None:
        bench.state.stop_confirmed(wires.volts)
    return {
        "stopped": seconds is not None and not bench.state.flowing(),
        "said": _plug(bench.state.flowing()) or _sentence(wires, bool(futures)),
        "seconds": seconds and round(seconds, 4),
        "voltages": {p: round(v, 3) for p, v in wires.volts.items() if math.isfinite(v)},
        "answers": [_answer(node, future, answered) for node, future in sorted(futures.items())],
    }


def _plug(nodes: list[str]) -> str:
    if not nodes:
        return ""
    return f"PULL THE PLUG: current still flows with every output off, says {', '.join(nodes)}."


def _sentence(wires: Wires, asked: bool) -> str:
    if wires.on:
        still = ", ".join(f"{place} {wires.volts[place]:.2f} V" for place in wires.on)
        return f"NOT STOPPED, voltage is on: {still}. Use the emergency stop of the bench."
    if wires.unread:
        silent = ", ".join(sorted(wires.unread))
        return f"Not confirmed: no reading since the request from {silent}. Look at the bench."
    if wires.seconds is not None:
        count = "the wire" if len(wires.volts) == 1 else f"all {len(wires.volts)} wires"
        return (
            f"0 V read on {count}, {1e3 * wires.seconds:.0f} ms after the request, and nothing "
            f"else for {_STAYS_OFF:g} s."
        )
    if wires.back:
        back = ", ".join(sorted(wires.back))
        return f"NOT STOPPED, voltage comes back: {back}. Use the emergency stop of the bench."
    if wires.volts:
        return "Not confirmed: too few readings since the request. Look at the bench."
    if asked:
        return "Not confirmed: stop was sent, but no voltage is read here. Look at the bench."
    return "Nothing to stop: no node answers here and no voltage is read. Look at the bench."


def _answer(
    node: str, future: Future[tuple[bool, str]], answered: dict[str, float]
) -> dict[str, Any]:
    if not future.done():
        return {"node": node, "success": False, "message": "no answer", "seconds": None}
    success, message = future.result()
    return {
        "node": node, "success": success, "message": message, "seconds": round(answered[node], 4)
    }

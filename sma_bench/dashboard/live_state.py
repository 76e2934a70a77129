"""What a page shows of a bench: signals, limits, protocol, nodes, the last results.

Whoever listens to the bench writes, any number of pages read; both may be threads of their own.
"""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sma_bench.border import read_json_object, shown
from sma_bench.errors import InputError
from sma_bench.results import in_unit, with_error

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
        if bucket == self._bucket:
            self._least = min(self._least, (time, value), key=lambda point: point[1])
            self._largest = max(self._largest, (time, value), key=lambda point: point[1])
            return
        if self._bucket >= 0:
            points = sorted({self._least, self._largest})
            self._closed.extend(points)
            self._count += len(points)
        self._bucket, self._least, self._largest = bucket, (time, value), (time, value)

    def since(self, count: int) -> tuple[int, list[tuple[float, float]]]:
        """Points (time, value) after the first `count` of all time, and the count to ask next."""
        missing = min(self._count - count, len(self._closed))
        return self._count, list(self._closed)[-missing:] if missing > 0 else []


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


QUANTITIES = {  # in the page's order
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
        key, value = (quantity, place, kind), float(value)
        with self._lock:
            if key not in self._traces and len(self._traces) >= _MOST_SIGNALS:
                return
            now = self.clock()
            self._traces.setdefault(key, Trace()).add(now, value)
            if (quantity, kind) != ("voltage", MEASURED):
                return
            if abs(value) <= NO_VOLTAGE:
                self._off_since.setdefault(place, now)
                return
            self._off_since.pop(place, None)
            if place in self._stopped and not self._panels.get("again"):
                self._panels["again"] = {
                    "place": place, "volts": QUANTITIES["voltage"].shown(value),
                    "seconds": round(now - self._stopped[place], 1),
                }  # fmt: skip

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
            signals = []
            order = list(QUANTITIES)
            for key in sorted(self._traces, key=lambda key: (order.index(key[0]), *key[1:])):
                trace, shape = self._traces[key], QUANTITIES[key[0]]
                seen.points[key], points = trace.since(seen.points.get(key, 0))
                signals.append({
                    **dict(zip(("quantity", "place", "kind"), key, strict=True)),
                    "latest": shape.shown(trace.latest), "heard": round(trace.heard, 4),
                    "points": [(round(t, 3), shape.shown(v)) for t, v in points],
                })  # fmt: skip
            panels = {name: json.dumps(content) for name, content in self._panels.items()}
            changed = [n for n, text in panels.items() if seen.panels.get(n) != text]
            seen.panels |= {name: panels[name] for name in changed}
            return {
                "now": round(self.clock(), 4), "span": SPAN, "signals": signals,
                "panels": {name: self._panels[name] for name in changed},
            }  # fmt: skip


def quantity_table() -> dict[str, dict[str, str]]:
    """Title and unit of every quantity, in the page's order."""
    return {name: {"title": q.title, "unit": q.unit} for name, q in QUANTITIES.items()}


def shown_limits(limits: Mapping[str, float]) -> dict[str, float | None]:
    """Limits of the parameters LIMITS (SI) by quantity, in the page's unit."""
    return {
        name: q.shown(limits[q.limit]) for name, q in QUANTITIES.items() if q.limit in limits
    }


# --- The last results in a few lines: `title` and `lines`, or `problem` where it is no result.

_MOST_CANDIDATES = 5
_LEAST_SHOWN = 0.005


def identification_summary(text: str) -> dict[str, Any]:
    """Of the JSON that the identification node latches; `rows` of name and number."""
    try:
        where = "identification/result"
        document = read_json_object(text, where)
        title, lines = _card(document, where)
        rows = []
        for name, entry in _entries(document.get("parameters"), dict, where, "parameters").items():
            number = entry if isinstance(entry, dict) else {}
            value, std, text = number.get("value"), number.get("std"), ""
            if isinstance(value, int | float) and isinstance(std, int | float):
                text = shown(in_unit(with_error(value, std), str(number.get("unit", ""))))
            rows.append((shown(name), text))
    except InputError as error:
        return {"problem": shown(str(error))}
    return {"title": title, "rows": rows[:_MOST_ENTRIES], "lines": lines}


def diagnosis_summary(text: str) -> dict[str, Any]:
    """Of the JSON that the diagnosis node latches; `candidates` have name and probability."""
    try:
        where = "diagnosis/result"
        document = read_json_object(text, where)
        title, lines = _card(document, where)
        found = _entries(document.get("candidates"), list, where, "candidates")
    except InputError as error:
        return {"problem": shown(str(error))}
    candidates = [
        {"name": shown(str(c.get("name"))), "probability": round(float(c["probability"]), 4)}
        for c in found if isinstance(c, dict)
        and isinstance(c.get("probability"), int | float) and c["probability"] >= _LEAST_SHOWN
    ]
    return {"title": title, "candidates": candidates[:_MOST_CANDIDATES], "lines": lines}


def _card(document: dict[str, Any], where: str) -> tuple[str, list[str]]:
    """The title and the other rows of the card that a result carries."""
    rows = _entries(document.get("card"), list, where, "card")
    if not rows or not all(
        isinstance(r, list) and len(r) == 2 and all(isinstance(t, str) for t in r) for r in rows
    ):
        raise InputError(f"{where}: card is not pairs of texts")
    return shown(rows[0][1]), [
        shown(f"{label}: {text}" if label else text) for label, text in rows[1:_MOST_ENTRIES]
    ]


def _entries(found: Any, kind: type, where: str, name: str) -> Any:
    if not isinstance(found, kind):
        raise InputError(f"{where}: {name} is missing")
    return found

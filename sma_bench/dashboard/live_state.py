"""The state of a bench that pages show. One thread writes it, any number of pages read it."""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sma_bench.border import A_LIST, AN_OBJECT, read_fields, shown
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO, Freshness
from sma_bench.results import with_unit

SPAN = 60.0  # s, length of a trace
BUCKET = 0.1  # s; of each only the smallest and the largest reading are kept
_BEYOND = 1e9  # too large for the scale of a plot


class Trace:
    """Readings over their time of arrival, s of a clock that never goes back."""

    def __init__(self) -> None:
        self.latest, self.heard = math.nan, -math.inf
        self._closed = deque[tuple[float, float]](maxlen=round(2 * SPAN / BUCKET))
        self._count, self._bucket = 0, -1
        self._least = self._largest = (0.0, 0.0)

    def add(self, time: float, value: float) -> None:
        """Add a reading; a NaN counts as received and leaves a gap."""
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
        """The count of points so far, and the points (time, value) after the first `count`."""
        missing = min(self._count - count, len(self._closed))
        return self._count, list(self._closed)[-missing:] if missing > 0 else []


@dataclass(frozen=True)
class ShownQuantity:
    """How an SI quantity is shown (`factor` times it, minus `zero`), and the name of its limit."""

    title: str
    unit: str
    factor: float = 1.0
    zero: float = 0.0
    limit: str = ""

    def shown(self, value: float) -> float | None:
        """A number in the page's unit; None if NaN or too large."""
        number = self.factor * value - self.zero
        return round(number, 5) if abs(number) < _BEYOND else None


QUANTITIES = {  # in the page's order
    "voltage": ShownQuantity("Voltage", "V", limit="bench.maximum_voltage"),
    "current": ShownQuantity("Current", "A", limit="bench.maximum_current"),
    "temperature": ShownQuantity("Temperature", "°C", 1, CELSIUS_ZERO, "bench.maximum_temperature"),
    "deflection": ShownQuantity("Deflection", "mm", 1e3),
    "elongation": ShownQuantity("Elongation", "mm", 1e3), "force": ShownQuantity("Force", "N"),
    "distance": ShownQuantity("Distance", "mm", 1e3)}
_ORDER = list(QUANTITIES)
LIMITS = tuple(q.limit for q in QUANTITIES.values() if q.limit)
FLOWING = "still flowing"
NO_VOLTAGE = 0.05  # V; below it a measured voltage counts as 0 (converter noise and steps: 10 mV)
# Limits, as anybody may create any number of topics and names.
_MOST_SIGNALS, _MOST_ENTRIES = 300, 200
MEASURED, COMMANDED, MODEL = "measured", "commanded", "model"


class WireVoltage(NamedTuple):
    """The measured voltage of a wire; times in s of the state's clock."""

    volts: float  # the newest [V]
    heard: float  # when that was received
    off_since: float  # since when all readings have been 0; inf while one is not
    stamp: float  # of the newest, s of its source's clock
    last_message: float  # its time, even if it repeats the reading


@dataclass
class Seen:
    """What has already been sent to one page."""

    points: dict[tuple[str, str, str], int] = field(default_factory=dict)
    panels: dict[str, str] = field(default_factory=dict)


class LiveState:
    """The newest values and panels; `clock` is in s and never goes back."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clock, self._lock = clock, threading.Lock()
        self._traces: dict[tuple[str, str, str], Trace] = {}
        self._fresh: dict[tuple[str, str, str], Freshness] = {}
        self._panels: dict[str, Any] = {}
        self._voltages, self._stopped = dict[str, WireVoltage](), dict[str, float]()

    def reading(self, quantity: str, place: str, value: float, kind: str = MEASURED,
                stamp: float | None = None) -> None:
        """Note a reading in SI units. `stamp`: s of its source's clock, None: now. A stamp of 0
        (not set) or a repeated one (a driver that hangs) confirms no stop."""
        key, value = (quantity, place, kind), float(value)
        with self._lock:
            if key not in self._traces and len(self._traces) >= _MOST_SIGNALS:
                return
            now = self.clock()
            fresh = self._fresh.setdefault(key, Freshness(place, SPAN))
            if is_new := fresh.seen(stamp or math.nan, now):  # without a stamp each is new
                self._traces.setdefault(key, Trace()).add(now, value)
            if (quantity, kind) != ("voltage", MEASURED):
                return
            if (before := self._voltages.get(place)) and not is_new:
                self._voltages[place] = before._replace(last_message=now)
                return
            off_since = min(now, before.off_since if before else now)
            is_off = abs(value) <= NO_VOLTAGE
            self._voltages[place] = WireVoltage(value, now, off_since if is_off else math.inf,
                                                now if stamp is None else stamp, now)
            if not is_off and place in self._stopped and not self._panels.get("again"):
                self._panels["again"] = {"place": place,
                                         "volts": QUANTITIES["voltage"].shown(value),
                                         "seconds": round(now - self._stopped[place], 1)}

    def voltages(self) -> dict[str, WireVoltage]:
        with self._lock:
            return dict(self._voltages)

    def foreign(self) -> dict[str, str]:
        """Wires whose readings come from a node that takes no commands, and that node's name."""
        with self._lock:
            return dict(self._panels.get("foreign", {}))

    def stop_asked(self) -> None:
        """A new stop is requested: forget the result of the last one."""
        with self._lock:
            self._stopped, self._panels["again"] = {}, None

    def stop_confirmed(self, places: Iterable[str]) -> None:
        """Wires are confirmed off: the panel `again` will name the first that gets a voltage."""
        with self._lock:
            self._stopped = dict.fromkeys(places, self.clock())

    def flowing(self) -> list[str]:
        """Nodes whose newest state reports a current with all outputs off."""
        with self._lock:
            states = self._panels.get("states", {})
            return sorted(node for node, state in states.items() if state.startswith(FLOWING))

    def show(self, panel: str, content: Any) -> None:
        """Set the content of a panel, as JSON values."""
        with self._lock:
            self._panels[panel] = content

    def merge(self, panel: str, content: Mapping[str, Any]) -> None:
        """Set some entries of a panel whose content is a mapping."""
        with self._lock:
            merged = {**self._panels.get(panel, {}), **content}
            self._panels[panel] = dict(list(merged.items())[:_MOST_ENTRIES])

    def update(self, seen: Seen) -> dict[str, Any]:
        """Changes for a page since its last update, which are noted in `seen`."""
        with self._lock:
            signals = []
            for key in sorted(self._traces, key=lambda key: (_ORDER.index(key[0]), *key[1:])):
                trace, (quantity, place, kind), shape = self._traces[key], key, QUANTITIES[key[0]]
                seen.points[key], points = trace.since(seen.points.get(key, 0))
                signals.append({"quantity": quantity, "place": place, "kind": kind,
                                "latest": shape.shown(trace.latest), "heard": round(trace.heard, 4),
                                "points": [(round(t, 3), shape.shown(v)) for t, v in points]})
            panels = {name: json.dumps(content) for name, content in self._panels.items()}
            changed = [n for n, text in panels.items() if seen.panels.get(n) != text]
            seen.panels |= panels
            return {"now": round(self.clock(), 4), "span": SPAN, "signals": signals,
                    "panels": {name: self._panels[name] for name in changed}}


def shown_limits(limits: Mapping[str, float]) -> dict[str, float | None]:
    """Limits of the parameters LIMITS (SI) by quantity, in the page's unit."""
    return {name: q.shown(limits[q.limit]) for name, q in QUANTITIES.items() if q.limit in limits}


def result_summary(node: str, text: str) -> dict[str, Any]:
    """The shown part of the result (JSON) of `identification` or `diagnosis`: `title` and `lines`
    of its card, `rows` (name, number) of an identification; or `problem`, a line."""
    where, numbers = f"{node}/result", node == "identification"
    fields = {"card": A_LIST, **({"parameters": AN_OBJECT} if numbers else {})}
    try:
        found = read_fields(text, fields, where)
        card = found["card"]
        if not card or any(not isinstance(r, list) or [*map(type, r)] != [str, str] for r in card):
            raise InputError(f"{where}: card is not pairs of texts")
    except InputError as error:
        return {"problem": shown(str(error))}
    rows = []
    for name, entry in list(found["parameters"].items())[:_MOST_ENTRIES] if numbers else ():
        entry = entry if isinstance(entry, dict) else {}
        value, std, number = entry.get("value"), entry.get("std"), ""
        if isinstance(value, int | float) and isinstance(std, int | float):
            number = shown(with_unit(str(entry.get("unit", "")), value, std))
        rows.append((shown(name), number))
    lines = [shown(f"{label}: {line}" if label else line) for label, line in card[1:_MOST_ENTRIES]]
    return {"title": shown(card[0][1]), "lines": lines, "rows": rows}

"""The page's stop: every node is asked at once, and the voltages show whether it worked."""

import asyncio
import math
import time
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, Protocol

from sma_bench.dashboard.live_state import LiveState

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

    def sentence(self, asked: bool) -> str:
        """What they say, where nodes were `asked`."""
        count, silent = len(self.volts), sorted(self.volts.keys() - self.heard.keys())
        if self.on:
            still = ", ".join(f"{place} {self.volts[place]:.2f} V" for place in self.on)
            return f"NOT STOPPED, voltage is on: {still}. Use the emergency stop of the bench."
        if silent:
            names = ", ".join(silent)
            return f"Not confirmed: no reading since the request from {names}. Look at the bench."
        if self.stay_off:
            ms = 1e3 * (max(self.off_since.values()) - self.begin)
            wires = "the wire" if count == 1 else f"all {count} wires"
            after = f"{ms:.0f} ms after the request, and nothing else for {_STAYS_OFF:g} s."
            return f"0 V read on {wires}, {after}"
        if self.back:
            names = ", ".join(sorted(self.back))
            return f"NOT STOPPED, voltage comes back: {names}. Use the emergency stop of the bench."
        if count:
            return "Not confirmed: too few readings since the request. Look at the bench."
        if asked:
            return "Not confirmed: stop was sent, but no voltage is read here. Look at the bench."
        return "Nothing to stop: no node answers here and no voltage is read. Look at the bench."


async def stop(bench: WatchedBench) -> dict[str, Any]:
    """Stop the bench and say what came of it.

    0 V is commanded until the voltages are gone, so that a bench stops which has no service, or
    whose commander is not asked by one.

    Returns:
        `stopped`: True only where every live wire was read at 0 V and stayed there, and no node
        says that current still flows; `said`: one sentence; `seconds` until 0 V (None: never);
        `voltages` (V) by wire; `answers` of the nodes.
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
                answered.setdefault(node, round(now - begin, 4))
        nothing_to_see = not wires.volts and now > begin + _SILENT
        if len(answered) == len(futures) and (wires.stay_off or nothing_to_see):
            break
        if (wires.on or not wires.volts) and now > commanded + _REPEAT:
            commanded = now
            bench.send_zero()
        await asyncio.sleep(_LOOK)
    seconds = max(wires.off_since.values()) - wires.begin if wires.stay_off else None
    if seconds is not None:
        bench.state.stop_confirmed(wires.volts)
    answers = []
    for node, future in sorted(futures.items()):
        success, message = future.result() if future.done() else (False, "no answer")
        answers.append({
            "node": node, "success": success, "message": message, "seconds": answered.get(node),
        })  # fmt: skip
    flowing = ", ".join(bench.state.flowing())
    plug = f"PULL THE PLUG: current still flows with every output off, says {flowing}."
    return {
        "stopped": seconds is not None and not flowing,
        "said": plug if flowing else wires.sentence(bool(futures)),
        "seconds": seconds and round(seconds, 4),
        "voltages": {p: round(v, 3) for p, v in wires.volts.items() if math.isfinite(v)},
        "answers": answers,
    }

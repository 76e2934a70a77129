"""Is the stored reason of the last trip ever wrong or incomplete after a power failure?

The real firmware on an emulated Uno, in virtual time. It trips for one of ten causes, and the power
fails at a random instant: before, while or after the reason is written to the EEPROM, while its
acknowledgement is written, after a reset in between, or during a start. The byte being written gets
a random value. The next start must report the previous or the new trip, each complete, or that one
was lost; and the new one if the power lasted for 40 ms. Three minutes.

    ./bench check power_cuts [--cuts 1000] [--seed 1] [--json FILE]
"""

import functools
import random
import sys
import tempfile
from collections import namedtuple
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "firmware"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "test" / "tools"))

from uno import emulated_uno
from virtual_host import VirtualHost

from examination.pieces import IN_PIECES, in_pieces, options_of, print_table
from sma_bench.hardware.serial_messages import CAUSES, line

KEPT_WITHIN = 0.04  # s to write a reason: nine bytes of 3.4 ms
STARTED = 0.15  # s after a start, when it can be armed
WRONG_TIME = 0.3  # s: a larger error of the reported time of a trip counts as wrong
LOST = CAUSES.index("reason lost with the power")
RESTARTED = CAUSES.index("restarted while armed")
CHAIN = 20  # cuts
TIMSK0, TIMSK1, ADCSRA = 0x6E, 0x6F, 0x7A
OUTCOMES = ("before", "now", "lost", "WRONG")
WAYS = ("while it works", "at a trip", "at what acknowledges it", "behind a reset at a trip")


# Report of the last trip: cause, s after a start, not acknowledged.
Report = namedtuple("Report", "cause time open")
# How to cause a trip, its possible causes, shortest and longest time until it [s].
Trip = namedtuple("Trip", "make causes soonest latest")


def electrics(**values: float) -> Callable[[VirtualHost], object]:
    """Set quantities at the pins; those of wires for the first wire."""

    def change(host: VirtualHost) -> None:
        pins = host.uno.electrics
        for name, value in values.items():
            if name == "supply":
                pins.supply = value
            else:
                getattr(pins, name)[0] = value

    return change


def poke(register: int) -> Callable[[VirtualHost], object]:
    return lambda host: host.uno.poke(register, 0)


UNEXPLAINED = ("over-current of the front board", "more current than the outputs explain",
               "duty above its limit")  # fmt: skip
TRIPS = {
    "stop byte": Trip(lambda host: host.uno.write(b"!"), ("stop byte",), 0.0, 0.001),
    "silence": Trip(lambda host: None, ("command timeout",), 0.19, 0.206),
    "short circuit": Trip(electrics(resistance=0.05), UNEXPLAINED, 0.0, 0.02),
    "switch stuck": Trip(electrics(switch_is=emulated_uno.Switch.STUCK_ON), UNEXPLAINED, 0.0, 0.05),
    "supply lost": Trip(electrics(supply=0.0), ("supply out of range", *UNEXPLAINED), 0.0, 0.06),
    "converter dead": Trip(poke(ADCSRA), ("converter dead",), 0.005, 0.013),
    "outputs frozen": Trip(poke(TIMSK0), ("output interrupt lost",), 0.004, 0.008),
    # These, from the watchdog, are only stored at the next start.
    "loop hung": Trip(lambda host: host.uno.hang(interrupts=True), ("main loop hung",), 0.03, 0.08),
    "all hung": Trip(lambda host: host.uno.hang(interrupts=False), ("restarted while armed",),
                     0.05, 0.08),
    "clock frozen": Trip(poke(TIMSK1), ("restarted while armed",), 0.05, 0.08)}


def verdict(said: Report, before: Report, now: Report, causes: Collection[int], may: bool,
            must: bool) -> str:  # fmt: skip
    """Outcome of a cut, if `now`, with one of the `causes`, may or must have been stored."""
    is_now = said.cause in causes and said.open == now.open
    if may and is_now and abs(said.time - now.time) < WRONG_TIME:
        return "now"
    if must:
        return "WRONG"
    if said == before:
        return "before"
    # If an acknowledgement is lost, its trip is reported again.
    return "lost" if may and said == Report(LOST, 0.0, True) and not before.open else "WRONG"


class CutUno:
    """A chain of power cuts; each starts with the EEPROM of the one before."""

    def __init__(self, uno: emulated_uno.EmulatedUno, draw: random.Random) -> None:
        self._uno, self._host, self._draw = uno, VirtualHost(uno), draw
        self._last = Report(0, 0.0, False)
        self._host.run(STARTED)

    def _restart(self, why: emulated_uno.Reset) -> None:
        uno, pins = self._uno, self._uno.electrics
        uno.reset(why)
        pins.supply, pins.resistance[0], pins.switch_is[0] = 12.0, 2.7, emulated_uno.Switch.SOUND
        self._host.messages.clear()

    def _lose_power(self) -> Report:
        """The report of the next start; the power may fail once more during a start."""
        while True:
            self._restart(emulated_uno.Reset.POWER_ON)
            if self._draw.random() < 0.8:
                break
            self._host.run(self._draw.uniform(0.0, 1.2 * KEPT_WITHIN))
        self._host.run(STARTED)
        return self._said()

    def _said(self) -> Report:
        said = self._host.named("?", "H")
        return Report(int(said["trip"]), 0.1 * int(said["trip_ds"]), said["trip_open"] == "1")

    def cut(self) -> dict[str, Any]:
        """Drive, trip, cut the power; the outcome, by the report of the next start."""
        draw, host, uno, before = self._draw, self._host, self._uno, self._last
        (way,), kind = draw.choices(WAYS, (1, 4, 4, 2)), draw.choice(list(TRIPS))
        trip, causes = TRIPS[kind], {CAUSES.index(cause) for cause in TRIPS[kind].causes}
        may = must = False
        if before.open and draw.random() < 0.7:
            host.consent("R")
            host.run(KEPT_WITHIN)
            before = before._replace(open=False)
        host.arm()
        host.drive(6000, 0, 0, 3000)
        host.run(draw.uniform(0.05, 0.15))
        now = Report(0, uno.time - uno.electrics.started + trip.latest, True)
        if way != WAYS[0]:
            host.drive(6000, 0, 0, 3000)
            host.run(0.005)
            trip.make(host)
        # Mostly while it is being stored.
        first = draw.choice((max(trip.soonest - 0.002, 0.0), trip.latest))
        after = draw.uniform(first, trip.latest + 1.2 * KEPT_WITHIN)
        if way == WAYS[1]:
            host.run(after)
            may, must = after >= trip.soonest, after > trip.latest + KEPT_WITHIN
        elif way == WAYS[2]:
            host.run(trip.latest + 1.5 * KEPT_WITHIN)
            self._restart(emulated_uno.Reset.PIN)
            host.run(STARTED)
            before = self._said()
            assert verdict(before, self._last, now, causes, may=True, must=True) == "now", before
            now, causes = before._replace(open=False), {before.cause}
            uno.write(line("R"))
            after = draw.uniform(0.0, 1.2 * KEPT_WITHIN)
            host.run(after)
            may, must = True, after > 0.002 + KEPT_WITHIN
        elif way == WAYS[3]:
            host.run(after)
            may = must = True
            if after < trip.latest:
                causes.add(RESTARTED)
            self._restart(emulated_uno.Reset.PIN)
            host.run(1.5 * KEPT_WITHIN)
        storing = uno.storing
        self._last = said = self._lose_power()
        outcome = verdict(said, before, now, causes, may, must)
        return {"kind": kind, "way": way, "storing": storing, "outcome": outcome,
                "told": "" if outcome != OUTCOMES[-1] else f"{before} {now} {said}"}  # fmt: skip


@functools.cache
def built() -> tuple[Any, Path, Path]:
    """Emulator and firmware, built once per process, and their folder."""
    folder = tempfile.TemporaryDirectory(prefix="power_cuts_")
    build = emulated_uno.build_emulator, emulated_uno.build_firmware
    return folder, *(make(Path(folder.name)) for make in build)


def cuts(seed: int, first: int, stop: int) -> list[dict[str, Any]]:
    """The outcomes of a chain of cuts."""
    uno = emulated_uno.EmulatedUno(*built()[1:], seed=seed + first)
    chain = CutUno(uno, random.Random(f"{seed} {first}"))
    return [chain.cut() for _ in range(first, stop)]


def main(argv: Sequence[str] | None = None) -> int:
    """0 if no reported reason was wrong."""
    options = options_of("power_cuts", __doc__, argv, cuts=(1000, "of the power"),
                         seed=(1, "of the first"), **IN_PIECES)  # fmt: skip
    if missing := emulated_uno.missing_tools():
        print(f"check power_cuts: {missing}", file=sys.stderr)
        return 2
    chains = [(options.seed, first, min(first + CHAIN, options.cuts))
              for first in range(0, options.cuts, CHAIN)]
    found = [one for chain in in_pieces(cuts, chains, options) for one in chain]
    rows = []
    for group in (*WAYS, *TRIPS, "all"):
        own = [one for one in found if group in (one["way"], one["kind"], "all")]
        ends = [one["outcome"] for one in own]
        storing = sum(one["storing"] for one in own)
        rows.append((group, len(own), storing, *map(ends.count, OUTCOMES)))
    print_table(("power fails", ">cuts", ">byte under way", *(f">{o}" for o in OUTCOMES)), rows)
    for one in found:
        if one["told"]:
            print(f"{one['way']}, {one['kind']}: {one['told']}")
    return 1 if rows[-1][-1] else 0

"""Data for a page, in its units; and the result of a stop, which follows from the voltages."""

import asyncio
import json
import math
import re
from contextlib import nullcontext
from functools import partial
from time import sleep

import pytest
from stand_in import StandIn

from sma_bench.dashboard import server
from sma_bench.dashboard.live_state import BUCKET, QUANTITIES, SPAN, LiveState, Seen, Trace
from sma_bench.dashboard.server import Wires, stop


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def test_a_trace_keeps_peaks_tells_each_point_once_and_shows_gaps():
    trace = Trace()
    peaks = {437: 5.0, 431: -5.0}
    for k in range(1000):
        trace.add(0.001 * k, peaks.get(k, 0.0))
    count, points = trace.since(0)
    assert count == len(points) < 20 and points == sorted(points)
    assert [p for p in points if p[1]] == [(0.431, -5.0), (0.437, 5.0)]
    trace = Trace()
    for k in range(round(3 * SPAN / BUCKET)):
        trace.add(BUCKET * (k + 0.5), float(k))
    count, points = trace.since(0)
    assert points[-1][0] - points[0][0] <= 2 * SPAN
    assert trace.since(count) == (count, [])
    trace.add(4 * SPAN, 1.0)
    assert [value for _, value in trace.since(count)[1]] == [float(k)]
    trace = Trace()
    for time, value in ((1.0, 2.0), (2.0, math.nan), (3.0, 4.0), (4.0, 4.0)):
        trace.add(time, value)
    assert [time for time, _ in trace.since(0)[1]] == [1.0, 3.0]
    trace.add(5.0, math.nan)
    assert trace.heard == 5.0 and math.isnan(trace.latest)


def test_an_update_has_what_is_new_and_is_json_for_any_browser():
    clock = Clock()
    state, seen = LiveState(clock), Seen()
    state.reading("temperature", "wire", 300.0)
    state.show("stops", ["experiment"])
    clock.now += 1.0
    state.reading("temperature", "wire", math.nan)
    state.reading("temperature", "wire", 310.0)
    first = json.loads(json.dumps(state.update(seen), allow_nan=False))
    (signal,) = first["signals"]
    assert signal["latest"] == pytest.approx(36.85)
    assert signal["points"] == [[100.0, pytest.approx(26.85)]]
    assert first["panels"] == {"stops": ["experiment"]}
    state.merge("states", {"recorder": "recording"})
    second = state.update(seen)
    assert second["signals"][0]["points"] == []
    assert second["panels"] == {"states": {"recorder": "recording"}}
    assert state.update(Seen())["panels"].keys() == {"stops", "states"}


@pytest.mark.parametrize("value", [1e306, -1e306, 1e308, math.inf, math.nan])
def test_numbers_beyond_any_bench_are_no_numbers_to_a_page(value):
    clock = Clock()
    state = LiveState(clock)
    for clock.now in (100.0, 101.0):
        for quantity in QUANTITIES:
            state.reading(quantity, "tip", value)
    update = json.loads(json.dumps(state.update(Seen()), allow_nan=False))
    shown = [number for s in update["signals"] for _, number in [[0, s["latest"]], *s["points"]]]
    assert len(shown) >= len(QUANTITIES) and set(shown) == {None}


def test_a_repeated_reading_is_not_new():
    state = LiveState(clock := Clock())
    for stamp, heard in ((5.0, 100.0), (5.0, 100.0), (6.0, 102.0), (0.0, 103.0)):
        state.reading("voltage", "wire", 0.0, stamp=stamp)
        assert state.voltages()["wire"].heard == heard
        clock.now += 1.0


@pytest.fixture
def bench(monkeypatch):
    """One whose stop needs less patience than a page's."""
    monkeypatch.setattr(server, "_STAYS_OFF", 0.3)
    monkeypatch.setattr(server, "_SILENT", 0.3)
    return StandIn()


def stopped(bench, before=True, after=True, patience=0.6):
    """Result of a stop, with readings before and after it."""
    if before:
        bench.read()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "_STOP_TIMEOUT", patience)
        with bench.readings() if after else nullcontext():
            return asyncio.run(stop(bench))


def answers(result):
    return [(a["node"], a["success"], a["message"]) for a in result["answers"]]


def test_voltages_at_zero_are_a_stop_until_one_comes_back_which_every_page_is_told(bench):
    result = stopped(bench, patience=30.0)
    assert result["stopped"] and " ms after the request" in result["said"]
    assert result["said"].startswith("0 V read on all 2 wires, ")
    assert result["voltages"] == {"front_1": 0.0, "back_1": 0.0}
    assert answers(result) == [("serial_bridge", True, "stopped")]
    assert not bench.state.update(Seen())["panels"]["again"]
    for volts in (5.0, 0.0):
        bench.volts["back_1"] = volts
        bench.read()
    again = bench.state.update(Seen())["panels"]["again"]
    assert (again["place"], again["volts"]) == ("back_1", 5.0)
    bench.answers = {"mute": None, "experiment": (False, "cannot")}
    result = stopped(bench, patience=1.5)
    assert answers(result) == [("experiment", False, "cannot"), ("mute", False, "no answer")]
    assert result["stopped"] and not bench.state.update(Seen())["panels"]["again"]


SILENT = {"before": False, "after": False}
LATE = {"before": False}  # first heard of after the request
# Stamps of a driver that hangs, that sets none, whose clock is slow or goes back.
STAMPS = (lambda _: 5.0, lambda _: 0.0, lambda now: 0.001 * now, lambda now: -now)


@pytest.mark.parametrize(("volts", "change", "readings", "said"), [
    (0.0, {}, {"after": False}, ".*no reading since the request"), (3.0, {}, SILENT, "Not conf"),
    (3.0, {"obeys": False}, {}, "NOT STOPPED, .* on: front_1 3.00 V[.]"),
    (3.0, {"answers": {}}, SILENT, "Nothing to stop"),
    *((0.0, {"stamp": stamp}, {}, "Not") for stamp in STAMPS),
    *((0.0, {"stamp": stamp}, LATE, "Not") for stamp in (*STAMPS[:2], STAMPS[3])),
    # A reading of a voltage that is on counts whatever its stamp.
    *((3.0, {"obeys": False, "stamp": stamp}, {}, "NOT STOPPED, volt") for stamp in STAMPS[1:]),
])  # fmt: skip
def test_no_stop_is_confirmed_without_new_readings(bench, volts, change, readings, said):
    """A wire that stays on is named, and commanded to zero meanwhile."""
    vars(bench).update(change)
    bench.volts = {"front_1": volts, "back_1": 0.0}
    result = stopped(bench, **readings)
    assert not result["stopped"]
    assert re.match(said, result["said"]) and bench.stops == 1
    assert bench.zeros > 5 or not {"stamp", "obeys"} & change.keys()


@pytest.mark.parametrize(("volts", "said"), [
    (0.0, "Not confirmed: no reading since the request from front_1."),
    (3.0, "NOT STOPPED, voltage is on: front_1 3.00 V."),
])  # fmt: skip
def test_a_wire_whose_driver_hung_long_ago_is_still_one_of_the_bench(bench, volts, said):
    """Were it forgotten, the other wires would confirm the stop."""
    hung = partial(bench.state.reading, "voltage", "front_1", volts, stamp=5.0)
    hung()
    sleep(1.5 * server._SILENT)
    bench.volts, bench.on_read = {"back_1": 0.0}, hung
    result = stopped(bench)
    assert not result["stopped"] and result["said"].startswith(said)


@pytest.mark.parametrize("ahead", [1e9, -1e9])
def test_stamps_of_another_time_confirm_a_stop_and_a_clock_that_jumps_only_once_it_goes_on(
    bench, ahead
):
    """The source's own clock counts, whatever time it shows."""
    bench.volts = dict.fromkeys(bench.volts, 0.0)
    bench.stamp = lambda now: now + ahead
    assert stopped(bench, patience=30.0)["stopped"]
    begun = bench.state.clock()
    bench.stamp = lambda now: now + ahead - 3600.0 * (now > begun + 0.1)
    bench.read()
    result = stopped(bench, before=False)
    assert not result["stopped"] and "no reading since the request" in result["said"]
    assert stopped(bench, patience=30.0)["stopped"]


def test_a_player_a_commander_that_comes_back_and_current_that_still_flows_are_no_stop(bench):
    class Stubborn(dict):
        """0 V until the third reading after the request."""

        read = 0

        def items(self):
            self.read += bench.stops > 0
            return [(wire, 3.0 if self.read > 3 else 0.0) for wire in self]

    bench.obeys, bench.volts = False, Stubborn(bench.volts)
    assert not stopped(bench)["stopped"]
    bench.state.merge("states", {"serial_bridge": "still flowing: pull the plug (4.43 A)"})
    bench.obeys = True
    result = stopped(bench, patience=30.0)
    assert not result["stopped"]
    assert result["said"].startswith("PULL THE PLUG") and "serial_bridge" in result["said"]
    bench.state.merge("states", {"serial_bridge": "idle"})
    bench.state.show("foreign", {"front_1": "rosbag2_player"})  # which takes no commands
    result = stopped(bench)
    assert not result["stopped"] and "front_1 (rosbag2_player)" in result["said"]


@pytest.mark.parametrize(("off", "phase"), [(30, 0), (30, 66), (99, 0), (99, 33), (99, 99)])
def test_a_pulsed_wire_is_never_reported_as_off(off, phase):
    """5 V in one reading, 0 V in up to 99: one every 10 ms, looked at now and then."""
    clock = Clock()
    state = LiveState(clock)
    for k in range(500):
        clock.now = 100.0 + 0.01 * k
        state.reading("voltage", "wire", 0.0 if (k + phase) % (off + 1) else 5.0)
        if clock.now < 101.0:
            before = state.voltages()
        wires = Wires(101.0, state.voltages(), before, {})
        assert k < 100 or not wires.stay_off
    assert wires.sentence(asked=True).startswith("NOT STOPPED, voltage ")

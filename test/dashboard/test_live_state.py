"""What a page is told, in its units; and a stop that says only what the voltages say."""

import asyncio
import json
import math
from contextlib import nullcontext

import pytest
from stand_in import StandIn

from sma_bench.dashboard import stopping
from sma_bench.dashboard.live_state import (
    BUCKET,
    SPAN,
    LiveState,
    Seen,
    Trace,
    diagnosis_summary,
    identification_summary,
)
from sma_bench.dashboard.stopping import Wires, stop


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def test_a_trace_keeps_peaks_tells_each_point_once_and_shows_gaps():
    trace = Trace()
    for k in range(1000):
        trace.add(0.001 * k, 5.0 if k == 437 else -5.0 if k == 431 else 0.0)
    count, points = trace.since(0)
    values = [value for _, value in points]
    assert count == len(points) < 20
    assert (0.431, -5.0) in points and (0.437, 5.0) in points
    assert points == sorted(points)
    assert values.count(0.0) == len(values) - 2
    trace = Trace()
    for k in range(round(3 * SPAN / BUCKET)):
        trace.add(BUCKET * (k + 0.5), float(k))
    count, points = trace.since(0)
    assert points[-1][0] - points[0][0] <= 2 * SPAN
    assert trace.since(count) == (count, [])
    trace.add(4 * SPAN, 1.0)
    assert [value for _, value in trace.since(count)[1]] == [float(k)]
    trace = Trace()
    trace.add(1.0, 2.0)
    trace.add(2.0, math.nan)
    trace.add(3.0, 4.0)
    trace.add(4.0, 4.0)
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


def diagnosis(**changes):
    return json.dumps({
        "verdict": "effect",
        "candidates": [{"name": "slack", "probability": 0.93}, {"name": "x", "probability": 1e-3}],
        "card": [["", "slack explains it"], ["cause", "slack: play"], ["", "more"]], **changes,
    })  # fmt: skip


def test_the_last_results_are_their_cards_candidates_and_numbers():
    said = diagnosis_summary(diagnosis())
    assert said["title"] == "slack explains it"
    assert said["candidates"] == [{"name": "slack", "probability": 0.93}]
    assert said["lines"] == ["cause: slack: play", "more"]
    numbers = {"wire.resistance": {"value": 2.7, "std": 0.01, "unit": "ohm"}, "odd": 3}
    said = identification_summary(diagnosis(parameters=numbers))
    assert said["title"] == "slack explains it"
    assert said["rows"] == [("wire.resistance", "2.7 ± 0.01 ohm"), ("odd", "")]


@pytest.fixture
def bench(monkeypatch):
    """One whose stop needs less patience than a page's."""
    monkeypatch.setattr(stopping, "_STAYS_OFF", 0.3)
    monkeypatch.setattr(stopping, "_SILENT", 0.3)
    return StandIn()


def stopped(bench, before=True, after=True, patience=30.0):
    """Result of a stop, with readings before and after it."""
    stopping._PATIENCE, kept = patience, stopping._PATIENCE
    if before:
        bench.read()
    try:
        with bench.readings() if after else nullcontext():
            return asyncio.run(stop(bench))
    finally:
        stopping._PATIENCE = kept


def test_voltages_at_zero_are_a_stop_with_its_time_and_the_answers(bench):
    result = stopped(bench)
    assert result["stopped"] and 0.0 < result["seconds"] < 2.0
    assert result["said"].startswith("0 V read on all 2 wires, ")
    assert result["voltages"] == {"front_1": 0.0, "back_1": 0.0}
    (answer,) = result["answers"]
    assert (answer["node"], answer["success"], answer["message"]) == (
        "serial_bridge", True, "stopped",
    )  # fmt: skip


def test_no_stop_is_confirmed_where_current_flows_or_no_reading_says_so(bench):
    told = "still flowing: pull the plug (4.43 A through the front board with its outputs off)"
    bench.state.merge("states", {"serial_bridge": told})
    result = stopped(bench)
    assert not result["stopped"]
    assert result["said"].startswith("PULL THE PLUG") and "serial_bridge" in result["said"]
    bench.state.merge("states", {"serial_bridge": "stopped"})
    bench.volts = dict.fromkeys(bench.volts, 0.0)
    result = stopped(bench, after=False, patience=0.5)
    assert not result["stopped"] and "no reading since the request" in result["said"]


def test_a_wire_that_stays_on_is_named_and_commanded_to_zero_meanwhile(bench):
    bench.obeys = False
    bench.volts["back_1"] = 0.0
    result = stopped(bench, patience=1.0)
    assert not result["stopped"] and result["seconds"] is None
    assert "NOT STOPPED, voltage is on: front_1 3.00 V." in result["said"]
    assert bench.stops == 1 and bench.zeros > 5


def test_a_bench_that_measures_no_voltage_is_not_called_stopped(bench):
    for answers, said in ((bench.answers, "Not confirmed"), ({}, "Nothing to stop")):
        bench.answers = answers
        result = stopped(bench, before=False, after=False)
        assert not result["stopped"] and result["said"].startswith(said)


def test_a_node_that_does_not_answer_or_refuses_is_named(bench):
    bench.answers = {"mute": None, "experiment": (False, "cannot")}
    result = stopped(bench, patience=3.0)
    assert result["stopped"]
    assert [(a["node"], a["success"], a["message"]) for a in result["answers"]] == [
        ("experiment", False, "cannot"), ("mute", False, "no answer"),
    ]  # fmt: skip


def test_a_commander_that_comes_back_is_not_a_stop(bench):
    class Stubborn(dict):
        """0 V until the third reading after the request."""

        def items(self):
            bench.read_after += bool(bench.stops)
            return [(wire, 3.0 if bench.read_after > 3 else 0.0) for wire in self]

    bench.obeys, bench.read_after, bench.volts = False, 0, Stubborn(bench.volts)
    assert not stopped(bench, patience=1.0)["stopped"]


@pytest.mark.parametrize("phase", range(0, 100, 33))
@pytest.mark.parametrize("off", [30, 99])
def test_a_wire_that_pulses_is_never_called_off(off, phase):
    """5 V in one reading, 0 V in up to 99: one every 10 ms, looked at now and then."""
    clock = Clock()
    state = LiveState(clock)
    wires = None
    for k in range(500):
        clock.now = 100.0 + 0.01 * k
        state.reading("voltage", "wire", 0.0 if (k + phase) % (off + 1) else 5.0)
        if k == 100:
            wires = Wires(state, clock())
        if wires is not None and k % 7 == 0:
            wires.look()
            assert not wires.stay_off
    assert wires.back == {"wire"}


def test_a_voltage_that_comes_back_after_a_stop_is_told_to_every_page(bench):
    assert stopped(bench)["stopped"]
    assert not bench.state.update(Seen())["panels"]["again"]
    bench.volts["back_1"] = 5.0
    bench.read()
    bench.volts["back_1"] = 0.0
    bench.read()
    again = bench.state.update(Seen())["panels"]["again"]
    assert (again["place"], again["volts"]) == ("back_1", 5.0)
    assert stopped(bench)["stopped"]
    assert not bench.state.update(Seen())["panels"]["again"]

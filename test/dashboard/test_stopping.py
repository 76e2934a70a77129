"""The stop asks everything at once, and says only what the voltages say."""

import asyncio

import pytest
from stand_in import StandIn

from sma_bench.dashboard.live_state import LiveState, Seen
from sma_bench.dashboard.stopping import Wires, stop


@pytest.fixture
def bench():
    return StandIn()


def stopped(bench, before=True, after=True):
    """Result of a stop, with readings before and after it."""
    if before:
        bench.read()
    if not after:
        return asyncio.run(stop(bench))
    with bench.readings():
        return asyncio.run(stop(bench))


def test_voltages_at_zero_are_a_stop_with_its_time_and_the_answers(bench):
    result = stopped(bench)
    assert result["stopped"] and 0.0 < result["seconds"] < 2.0
    assert result["said"].startswith("0 V read on all 2 wires, ")
    assert result["voltages"] == {"front_1": 0.0, "back_1": 0.0}
    (answer,) = result["answers"]
    assert (answer["node"], answer["success"], answer["message"]) == (
        "serial_bridge", True, "stopped",
    )  # fmt: skip


def test_no_stop_is_confirmed_while_a_node_says_that_current_flows(bench):
    told = "still flowing: pull the plug (4.43 A through the front board with its outputs off)"
    bench.state.merge("states", {"serial_bridge": told})
    result = stopped(bench)
    assert not result["stopped"]
    assert result["said"].startswith("PULL THE PLUG") and "serial_bridge" in result["said"]


def test_a_wire_that_stays_on_is_named_and_commanded_to_zero_meanwhile(bench):
    bench.obeys = False
    bench.volts["back_1"] = 0.0
    result = stopped(bench)
    assert not result["stopped"] and result["seconds"] is None
    assert "NOT STOPPED, voltage is on: front_1 3.00 V." in result["said"]
    assert bench.stops == 1 and bench.zeros > 20


def test_without_a_reading_since_the_request_nothing_is_confirmed(bench):
    bench.volts = dict.fromkeys(bench.volts, 0.0)
    result = stopped(bench, after=False)
    assert not result["stopped"] and "no reading since the request" in result["said"]


def test_a_bench_that_measures_no_voltage_is_not_called_stopped(bench):
    result = stopped(bench, before=False, after=False)
    assert not result["stopped"] and result["said"].startswith("Not confirmed")
    bench.answers = {}
    result = stopped(bench, before=False, after=False)
    assert not result["stopped"] and result["said"].startswith("Nothing to stop")


def test_a_node_that_does_not_answer_or_refuses_is_named(bench):
    bench.answers = {"mute": None, "experiment": (False, "cannot")}
    result = stopped(bench)
    assert result["stopped"]
    assert [(a["node"], a["success"], a["message"]) for a in result["answers"]] == [
        ("experiment", False, "cannot"), ("mute", False, "no answer"),
    ]  # fmt: skip


def test_a_commander_that_comes_back_is_not_a_stop(bench, monkeypatch):
    begun = bench.state.clock()

    class Stubborn(dict):
        def items(self):
            late = bench.state.clock() - begun > 0.15
            return [(wire, 3.0 if late else 0.0) for wire in self]

    monkeypatch.setattr(bench, "obeys", False)
    bench.volts = Stubborn(bench.volts)
    assert not stopped(bench)["stopped"]


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize("phase", range(0, 100, 13))
@pytest.mark.parametrize("off", [30, 80, 99])
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

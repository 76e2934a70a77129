"""What a page is told: every peak, only what is new, numbers in the page's units."""

import json
import math

import pytest

from sma_bench.dashboard.live_state import (
    BUCKET,
    LIMITS,
    SPAN,
    LiveState,
    Seen,
    Trace,
    diagnosis_summary,
    identification_summary,
    shown_limits,
)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_a_trace_keeps_the_peaks_of_readings_that_come_too_often():
    trace = Trace()
    for k in range(1000):
        trace.add(0.001 * k, 5.0 if k == 437 else -5.0 if k == 431 else 0.0)
    count, points = trace.since(0)
    values = [value for _, value in points]
    assert count == len(points) < 20
    assert (0.431, -5.0) in points and (0.437, 5.0) in points
    assert points == sorted(points)
    assert values.count(0.0) == len(values) - 2


def test_a_trace_tells_each_point_once_and_forgets_the_oldest():
    trace = Trace()
    for k in range(round(3 * SPAN / BUCKET)):
        trace.add(BUCKET * (k + 0.5), float(k))
    count, points = trace.since(0)
    assert points[-1][0] - points[0][0] <= 2 * SPAN
    assert trace.since(count) == (count, [])
    trace.add(4 * SPAN, 1.0)
    assert [value for _, value in trace.since(count)[1]] == [float(k)]


def test_a_reading_that_is_none_is_heard_and_leaves_a_gap():
    trace = Trace()
    trace.add(1.0, 2.0)
    trace.add(2.0, math.nan)
    trace.add(3.0, 4.0)
    trace.add(4.0, 4.0)
    assert [time for time, _ in trace.since(0)[1]] == [1.0, 3.0]
    trace.add(5.0, math.nan)
    assert trace.heard == 5.0 and math.isnan(trace.latest)


def test_an_update_has_what_is_new_and_is_json_for_any_browser(clock):
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


def test_limits_are_shown_in_the_units_of_the_signals():
    assert shown_limits({"bench.maximum_temperature": 423.15}) == {"temperature": 150.0}
    assert set(LIMITS) == {
        "bench.maximum_voltage", "bench.maximum_current", "bench.maximum_temperature",
    }  # fmt: skip


def diagnosis(**changes):
    return json.dumps({
        "verdict": "effect",
        "candidates": [{"name": "slack", "probability": 0.93}, {"name": "x", "probability": 1e-3}],
        "card": [["", "slack explains it"], ["cause", "slack: play"], ["", "more"]], **changes,
    })  # fmt: skip


def test_the_last_diagnosis_is_its_card_and_candidates():
    said = diagnosis_summary(diagnosis())
    assert said["title"] == "slack explains it"
    assert said["candidates"] == [{"name": "slack", "probability": 0.93}]
    assert said["lines"] == ["cause: slack: play", "more"]


def test_the_last_identification_is_its_card_and_numbers():
    numbers = {"wire.resistance": {"value": 2.7, "std": 0.01, "unit": "ohm"}, "odd": 3}
    said = identification_summary(diagnosis(parameters=numbers))
    assert said["title"] == "slack explains it"
    assert said["rows"] == [("wire.resistance", "2.7 ± 0.01 ohm"), ("odd", "")]


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"verdict": 3}', diagnosis(candidates=3), diagnosis(card=[["a"]]),
             diagnosis(card=[])],
)  # fmt: skip
def test_what_is_no_diagnosis_is_said_to_be_none(text):
    assert set(diagnosis_summary(text)) == {"problem"}

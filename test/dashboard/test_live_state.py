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
        "verdict": "effect", "cause": ["side_heat_coupling"],
        "candidates": [
            {"name": "side_heat_coupling", "stage": "thermal", "probability": 0.93,
             "parameters": {}},
            {"name": "recalibration", "stage": "", "probability": 0.001, "parameters": {}},
        ],
        "where": {"stage": "thermal", "table": []},
        "shrinkage": {"deflection": {"rmse_before": 1.2e-3, "rmse_after": 2e-4, "fraction": 0.9,
                                     "ci90": [0.8, 0.95], "noise_floor": 1e-4}},
        "next_experiment": {"why": "drive one side"}, **changes,
    })  # fmt: skip


def test_the_last_diagnosis_is_its_verdict_candidates_and_shrinkage():
    said = diagnosis_summary(diagnosis())
    assert said["title"] == "side_heat_coupling explains the gap (probability 93 %)"
    assert said["candidates"] == [{"name": "side_heat_coupling", "probability": 0.93}]
    cause, error, following = said["lines"]
    assert cause.startswith("cause: side_heat_coupling: ") and "(thermal stage)" in cause
    assert error == (
        "error: deflection 1.2 mm as believed -> 0.2 mm with the effect, noise 0.1 mm: 90 % "
        "[80, 95] of the gap gone"
    )
    assert following == "next: drive one side"


@pytest.mark.parametrize(
    "text", ["", "[]", "{", '{"verdict": 3}', diagnosis(candidates=3), diagnosis(shrinkage={
        "smell": json.loads(diagnosis())["shrinkage"]["deflection"]})],
)  # fmt: skip
def test_what_is_no_diagnosis_is_said_to_be_none(text):
    assert set(diagnosis_summary(text)) == {"problem"}

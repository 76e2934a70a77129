"""Well-formed and hostile: what any program may put on a topic is bounded and typed, or nothing."""

import json
import math

import pytest

from sma_bench.border import read_fields, shown
from sma_bench.dashboard.live_state import LiveState, Seen, diagnosis_summary
from sma_bench.errors import InputError
from sma_bench.live.recording import recorder_failure, recorder_state
from sma_bench.ros.dashboard import _PROGRESS, state_line

BRACKETS = "[" * 100_000
HOSTILE = [
    "", "null", "[]", BRACKETS, '{"a":' * 50_000, "[" * 50_000 + "]" * 50_000, "9" * 5000,
    '{"messages":[1]}', '{"state": "recording", "messages": [1]}', "\x1b[2J", '"\\ud800"', "NaN",
    '{"state": "failed", "failure": ["x"]}', '{"state": {"state": "failed"}, "failure": 1e999}',
    '{"state": "recording", "output": "x", "failure": "", "messages": {"a": "1"}}',
    '{"protocol": "p", "step": "s", "elapsed": "1", "duration": 3}',
    '{"protocol": "p", "step": "s", "elapsed": 1, "duration": "3"}',
    '{"protocol": "p", "step": "s", "elapsed": NaN, "duration": 3}',
    '{"protocol": "p", "step": "s", "elapsed": 1, "duration": true}',
    '{"verdict": "effect", "cause": [[]], "candidates": [{}]}', '{"x": "' + "y" * 2_000_000 + '"}',
]  # fmt: skip
def read_everywhere(text):
    """All that nodes make of a text on a topic; what is shown is short, plain JSON."""
    assert len(recorder_failure(text)) <= 501
    state = recorder_state(text)
    assert state is None or all(isinstance(n, int) for n in state["messages"].values())
    for line in (state_line(text), json.dumps(diagnosis_summary(text), allow_nan=False)):
        assert "\x1b" not in line and "\n" not in line and len(line) < 20_000
    try:
        progress = read_fields(text, _PROGRESS, "experiment/progress")
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert all(isinstance(progress[name], str) for name in ("protocol", "step"))
        assert math.isfinite(progress["elapsed"])
        assert progress["duration"] is None or math.isfinite(progress["duration"])


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_a_hostile_text_is_read_or_left_in_one_line(text):
    """What nodes and pages make of them: test_dashboard.py."""
    read_everywhere(text)


def test_what_people_and_pages_see_of_hostile_texts_is_short_and_bounded():
    assert shown("a\n b\x1b[2J") == "a b\\x1b[2J"
    assert len(shown("x" * 10**6)) == 501
    state = LiveState()
    for k in range(10_000):
        state.reading("voltage", f"wire_{k}", 1.0)
    for k in range(1000):
        state.merge("diagnostics", {f"node_{k}": {}})
    update = state.update(Seen())
    assert len(update["signals"]) == 300 and len(update["panels"]["diagnostics"]) == 200

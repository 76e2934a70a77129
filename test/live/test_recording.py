"""What a recorder writes, without ROS and without a disk."""

import pytest

from sma_bench.live.recording import Recording, recorded_type, recorder_state

READING, STATE = "/bench/wire/temperature", "/bench/experiment/state"


class Bag:
    """A bag in memory."""

    def __init__(self, path):
        self.path, self.written, self.closed = path, [], False

    def add_topic(self, topic, kind):
        pass

    def write(self, *message):
        self.written.append(message)

    def flush(self):
        pass

    def close(self):
        self.closed = True


def recording(skip_idle=False, margin=0.0):
    """A recording that has begun, and its bag."""
    bag = Bag("bag")
    made = Recording("bag", skip_idle, margin, pytest.fail, lambda _: bag)
    made.begin("bag")
    for topic in (READING, STATE):
        made.add(topic, "t")
    return made, bag


def write(made, topic, second, text="x"):
    made.write(topic, round(second * 1e9), text.encode(), bytes.decode)


def test_what_is_recorded_and_that_messages_of_one_tick_keep_their_order():
    """Bags one after another are those of test/nodes/test_recorder.py."""
    for topic, kind in (
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/bench/wire/power", "sensor_msgs/msg/BatteryState"),
        ("/bench/experiment/progress", ""), ("/other/wire/power", ""),
    ):
        assert recorded_type(topic, "/bench/") == kind
    made, bag = recording()
    for _ in range(3):
        write(made, READING, 1.0)
    assert [stamp for _, stamp, _ in bag.written] == [10**9, 10**9 + 1, 10**9 + 2]
    assert made.finish() and bag.closed and not made.finish()
    write(made, READING, 2.0)  # nobody writes it
    assert recorder_state(made.state("recording")) == {
        "state": "recording", "output": "bag", "failure": "", "messages": {READING: 3, STATE: 0},
    }  # fmt: skip


@pytest.mark.parametrize(("margin", "expected"), [(0.0, [2.0, 3.0]), (1.0, [1.0, 2.0, 3.0, 4.0])])
def test_idle_time_is_left_out_where_asked_but_for_a_margin(margin, expected):
    made, bag = recording(skip_idle=True, margin=margin)
    states = {0: "idle", 1.9: "running: ramp", 3.1: "done: ramp"}
    for moment in sorted([*states, *range(1, 7)]):
        if moment in states:
            write(made, STATE, moment, states[moment])
        else:
            write(made, READING, moment)
    found = [stamp / 1e9 for topic, stamp, _ in bag.written if topic == READING]
    assert found == expected

"""What a recorder writes, without ROS and without a disk."""

import pytest

from sma_bench.live.recording import Recording, recorded_type, recorder_state

READING, STATE = "/bench/wire/temperature", "/bench/experiment/state"


class Bag:
    """A bag in memory."""

    def __init__(self, path):
        self.path = path
        self.written, self.topics, self.closed = [], [], False

    def add_topic(self, topic, kind):
        self.topics.append(topic)

    def write(self, *message):
        self.written.append(message)

    def flush(self):
        pass

    def close(self):
        self.closed = True


def recording(output="bag", skip_idle=False, margin=0.0):
    """A recording, and its bags to come."""
    bags = []

    def open_bag(path):
        bags.append(Bag(path))
        return bags[-1]

    return Recording(output, skip_idle, margin, pytest.fail, open_bag), bags


def write(made, topic, second, text="x"):
    made.write(topic, round(second * 1e9), text.encode(), bytes.decode)


def test_messages_of_one_tick_keep_their_order_and_each_bag_begins_with_all_topics(tmp_path):
    for topic, kind in (
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ("/bench/wire/power", "sensor_msgs/msg/BatteryState"),
        ("/bench/experiment/progress", ""), ("/other/wire/power", ""),
    ):
        assert recorded_type(topic, "/bench/") == kind
    made, bags = recording(str(tmp_path / "bag"))
    assert made.next_output() == str(tmp_path / "bag")
    made.begin("bag")
    made.add(READING, "t")
    for _ in range(3):
        write(made, READING, 1.0)
    assert [stamp for _, stamp, _ in bags[0].written] == [10**9, 10**9 + 1, 10**9 + 2]
    assert made.finish() and bags[0].closed and not made.finish()
    write(made, READING, 2.0)  # nobody writes it
    for name in ("bag", "bag_2"):
        (tmp_path / name).mkdir()
    assert made.next_output() == str(tmp_path / "bag_3")
    made.begin("bag_3")
    write(made, READING, 3.0)
    assert bags[1].topics == [READING] and made.messages == {READING: 1}
    assert recorder_state(made.state("recording")) == {
        "state": "recording", "output": "bag_3", "failure": "", "messages": {READING: 1},
    }  # fmt: skip


@pytest.mark.parametrize(("margin", "expected"), [(0.0, [2.0, 3.0]), (1.0, [1.0, 2.0, 3.0, 4.0])])
def test_idle_time_is_left_out_where_asked_but_for_a_margin(margin, expected):
    made, bags = recording(skip_idle=True, margin=margin)
    made.begin("bag")
    for topic in (READING, STATE):
        made.add(topic, "t")
    states = {0: "idle", 1.9: "running: ramp", 3.1: "done: ramp"}
    for moment in sorted([*states, *range(1, 7)]):
        if moment in states:
            write(made, STATE, moment, states[moment])
        else:
            write(made, READING, moment)
    found = [stamp / 1e9 for topic, stamp, _ in bags[0].written if topic == READING]
    assert found == expected

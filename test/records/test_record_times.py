"""Which clock a record's times come from, and what is done about disorder."""

import pytest

from sma_bench.records import read_record


def texts(record, severity=None):
    return [f.text for f in record.findings if severity in (None, f.severity)]


def test_unsorted_messages_are_sorted_and_duplicates_dropped_and_both_said(
    tmp_path, write_bag, messages
):
    content = []
    for received, (second, value) in enumerate([(0, 1.0), (2, 3.0), (1, 2.0), (2, 99.0)]):
        stamp = messages.start + second * 10**9
        content.append(
            ("/x/wire/temperature", messages.temperature(stamp, value), messages.start + received)
        )
    record = read_record(write_bag(tmp_path / "bag", content))
    assert (record["wire.temperature"].values - 273.15).tolist() == pytest.approx([1, 2, 3])
    assert record["wire.temperature"].time.tolist() == [0.0, 1.0, 2.0]
    numbers = {key: n for f in record.findings for key, n in f.numbers.items()}
    assert numbers == {"backward": 1, "duplicates": 1}


def test_headers_never_stamped_fall_back_to_the_receive_time(tmp_path, write_bag, messages):
    content = [
        ("/x/wire/temperature", messages.temperature(0, 20.0), messages.start + k * 10**9)
        for k in range(3)
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record["wire.temperature"].time.tolist() == [0.0, 1.0, 2.0]
    assert any("never set" in text for text in texts(record, "warning"))


def test_single_unstamped_messages_are_left_out(tmp_path, write_bag, messages, ramp):
    broken = ("/bench/wire/temperature", messages.temperature(0, 20.0), messages.start + 5)
    record = read_record(write_bag(tmp_path / "bag", [*ramp, broken]))
    assert len(record["wire.temperature"]) == 200
    assert record.start_ns == messages.start
    assert "1 of 201 messages have no header.stamp and are left out" in texts(record, "warning")


def test_markers_and_commands_use_the_receive_time(tmp_path, write_bag, messages, ramp):
    at = messages.start + 500_000_000
    content = [
        *ramp,
        ("/bench/experiment/marker", messages.text("ramp up"), at),
        ("/bench/voltage_command", messages.command([1.5]), at),
    ]
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record.markers == ((0.5, "ramp up"),)
    assert record["voltage_command"].time.tolist() == [0.5]
    assert record["voltage_command"].values.tolist() == [[1.5]]


def test_headerless_topics_follow_the_stamps_of_a_faster_simulated_clock(
    tmp_path, write_bag, messages
):
    content = []
    for k in range(1000):  # ten simulated seconds in one second of the wall's clock
        wall = messages.start + k * 1_000_000
        reading = messages.temperature(k * 10_000_000, 20.0)
        content.append(("/bench/wire/temperature", reading, wall))
        if k == 700:
            content.append(("/bench/voltage_command", messages.command([1.0]), wall))
    record = read_record(write_bag(tmp_path / "bag", content))
    assert record.start_ns == 0
    assert record["voltage_command"].time == pytest.approx([7.0], abs=0.011)
    assert any("moved onto their clock" in text for text in texts(record, "warning"))

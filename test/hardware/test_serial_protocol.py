"""Bytes and messages of the serial protocol, against its documentation and against damage."""

import re
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.hardware.conversation import Conversation
from sma_bench.hardware.device import DeviceIdentity, LinkStatus
from sma_bench.hardware.serial_messages import (
    Accepted,
    Named,
    Pong,
    ProtocolError,
    Refused,
    Splitter,
    Telemetry,
    checksum,
    command,
    decode,
    frame,
    line,
    open_frame,
    open_line,
)

PAGE = Path(__file__).resolve().parents[2] / "docs" / "serial_protocol.md"
TEXT = b"T 57 3210000 1 0 12003 432 0 -102 0 15002 14990 2844 0 0 65535 1"
FRAME = bytes.fromhex(
    "42 3900 10fb3000 01 00 e32e b001 0000 9aff 0000 9a3a 8e3a 1c0b 0000 0000 ffff 0100"
)


def test_checksum_and_documented_session_are_valid():
    assert checksum(b"123456789") == 0x29B1
    session = re.search(r"```\n(.*?)```", PAGE.read_text(), re.S)
    assert session is not None
    lines = re.findall(r"^(host|device) +(\S.*\*\w{4})", session[1], re.M)
    assert len(lines) >= 9
    for speaker, text in lines:
        body = open_line(text.encode())
        assert body is not None, text
        if speaker == "device":
            decode(body)


def test_text_and_binary_telemetry_say_the_same_and_refusals_say_why():
    expected = Telemetry(
        sequence=57, time_us=3210000, state=1, cause=0, supply=pytest.approx(12.003),
        current=pytest.approx((-0.102, 0.0)), range_voltage=pytest.approx((1.5002, 1.499)),
        duty=pytest.approx((2844 / 65536, 0.0, 0.0, 65535 / 65536)), echo=1,
        drop=pytest.approx((0.432, 0.0)),
    )
    assert decode(TEXT) == expected
    assert decode(FRAME) == expected
    assert str(Refused("V", 7)) == "device refused V: above the voltage limit"
    assert str(Refused("V", 99)) == "device refused V: number 99"


def test_answers_are_decoded_and_what_is_no_message_is_refused():
    for body, message in (
        (b"K A 13841", Accepted("A", 13841)),
        (b"N V 6", Refused("V", 6)),
        (b"P 3 4294967295 5", Pong(3, 4294967295, 5)),
        (b"S rejected=1 new=x", Named("S", {"rejected": "1", "new": "x"})),
    ):
        assert decode(body) == message
    for body in (b"", b"Z 1", b"T 1 2 3", b"K A", b"K A x", b"P 1 2", b"S rejected", b"\xff",
                 b"T 65536 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0", FRAME[:-1]):  # fmt: skip
        with pytest.raises(ProtocolError, match="not of protocol 2"):
            decode(body)
    for number in (-1, 65536):
        with pytest.raises(ValueError, match="expected 0 to 65535"):
            command("V", 1, number)


@given(st.binary(min_size=1, max_size=600))
def test_frames_have_no_zero_inside_and_open_to_the_body(body):
    framed = frame(body)
    assert framed.count(0) == 1
    assert framed.endswith(b"\0")
    assert open_frame(framed[:-1]) == body


@given(st.lists(st.text("AKTN 0123456789-=", min_size=1).filter(str.strip)), st.data())
def test_splitting_does_not_depend_on_how_bytes_arrive(
    bodies, data
):
    stream = b"".join(map(line, bodies))
    splitter, found = Splitter(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += splitter.feed(stream[:size])
        stream = stream[size:]
    assert found == [body.encode() for body in bodies]
    assert splitter.damaged == 0


@given(st.binary(max_size=300), st.booleans())
def test_garbage_is_counted_and_the_next_messages_are_found(garbage, binary):
    splitter = Splitter()
    splitter.expect(binary)
    seal = frame if binary else lambda body: line(body.decode())
    splitter.feed(garbage + (b"\0" if binary else b"\n"))
    assert splitter.feed(seal(b"K A 1") + seal(b"K D 0")) == [b"K A 1", b"K D 0"]


@given(st.integers(0, 8 * len(line(TEXT.decode())) - 9))
def test_every_single_bit_error_of_a_line_is_noticed(bit):
    damaged = bytearray(line(TEXT.decode()))
    damaged[bit // 8] ^= 1 << bit % 8
    assert TEXT not in Splitter().feed(bytes(damaged)) or damaged.endswith(b"\r\n")
    assert all(body == TEXT for body in Splitter().feed(bytes(damaged)))


def test_pieces_and_endless_lines_are_dropped_and_only_damage_is_counted():
    splitter = Splitter()
    splitter.feed(line("K A 1")[3:] + line("K A 1"))
    assert splitter.damaged == 0
    splitter.feed(line("K A 1")[3:])
    assert splitter.damaged == 1
    splitter = Splitter()
    splitter.feed(b"x" * 10_000)
    assert splitter.damaged == 1
    assert splitter.feed(b"\n" + line("K A 1")) == [b"K A 1"]


HANDSHAKE = {
    "H": "name=sma-uno build=61A52BFF protocol=2 reset=9 before=2 nonce=13841 later=x",
    "L": "channels=4 max_mv=10000 timeout_ms=200 duty=58982 mean_ma=6500 peak_ma=12000 "
    "least_mohm=1000",
    "M": "hot_mv=8000 hot_ms=2000 on_duty=6554 on_s=900 supply_min_mv=6000 supply_max_mv=15000",
}


def handshake(**changed):
    lines = {
        letter: dict(pair.split("=") for pair in text.split()) for letter, text in HANDSHAKE.items()
    }
    for values in lines.values():
        values.update({key: text for key, text in changed.items() if key in values})
    return {letter: Named(letter, values) for letter, values in lines.items()}


def test_handshake_gives_limits_in_si_units_or_what_it_lacks():
    device = DeviceIdentity.from_lines(handshake())
    assert device.maximum_voltage == pytest.approx(10.0)
    assert device.command_timeout == pytest.approx(0.2)
    assert device.maximum_duty == pytest.approx(0.9, abs=1e-4)
    assert device.supply_range == pytest.approx((6.0, 15.0))
    assert device.reset == "power-on, watchdog, after: command timeout"
    assert device.hot_voltage == pytest.approx(8.0)
    lines = handshake()
    del lines["M"].values["on_s"]
    with pytest.raises(InputError, match="handshake: on_s is missing"):
        DeviceIdentity.from_lines(lines)
    for changed, complaint in (
        ({"protocol": "1"}, "the device has protocol 1, expected 2"),
        ({"max_mv": "ten"}, "invalid literal"),
    ):
        with pytest.raises(InputError, match=complaint):
            DeviceIdentity.from_lines(handshake(**changed))


def window(number, period_us=10000):
    """The n-th window since power-up."""
    time_us = number * period_us % (1 << 32)
    return Telemetry(
        number % 65536, time_us, 0, 0, 12.0, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0, 0.0), 0
    )


@given(
    uptime=st.integers(1000, 2_000_000), first=st.integers(1, 50),
    period=st.sampled_from((2000, 10000, 100000)),
)
def test_a_restart_is_noticed_after_any_uptime(uptime, first, period):
    """Most of all between half a turn of the clock, 35.8 min, and a whole one."""
    status = LinkStatus()
    status.note(window(uptime, period))
    reached = status.restarted(window(first, period), period)
    # Within three windows of a match of both counters: once in 20000 restarts.
    same = (uptime - first) * period % (1 << 32), (uptime - first) % 65536
    gap = (-same[0] + same[1] * period) % (65536 * period)
    assert reached or min(gap, 65536 * period - gap) <= 3 * period


@given(uptime=st.integers(1000, 2_000_000), lost=st.integers(0, 20000))
def test_lost_windows_are_no_restart(uptime, lost):
    status = LinkStatus()
    status.note(window(uptime))
    assert not status.restarted(window(uptime + 1 + lost), 10000)


COUNTERS = " ".join(f"counter{k}={10_000 + k}" for k in range(8))


class CountingDevice:
    """Sends its counters whenever it is read, and consents to what it is asked."""

    timeout = 0.0
    in_waiting = 1

    def __init__(self):
        self.answers = []

    def read(self, size=1):
        return self.answers.pop(0) if self.answers else line(f"S {COUNTERS}")

    def write(self, data):
        self.answers = [line(f"S {COUNTERS}"), line("K R 1")]


def test_answers_are_found_among_counters_that_are_not_kept():
    conversation = Conversation(CountingDevice())

    def held_after(seconds):
        for _ in range(seconds):
            messages, _ = conversation.receive()
            assert len(messages) == 1
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        before = held_after(100)
        a_second = (held_after(1000) - before) / 1000
    finally:
        tracemalloc.stop()
    assert a_second < 10.0
    conversation = Conversation(CountingDevice())
    conversation.receive()
    found = conversation.ask("R", complete=lambda answers: len(answers) == 2, pump=True)
    assert [answer.letter for answer in found] == ["S", "R"]
    assert conversation.unasked == ""

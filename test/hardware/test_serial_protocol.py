"""The serial protocol: examples of its documentation, messages, and damaged bytes."""

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from sma_bench.errors import InputError
from sma_bench.hardware import serial_messages
from sma_bench.hardware.serial_link import LinkStatus
from sma_bench.hardware.serial_messages import Named, Refused, Splitter, Telemetry, decode, line

PAGE = Path(__file__).resolve().parents[2] / "docs" / "serial_protocol.md"
TEXT = b"T 57 3210000 1 0 12003 432 0 -102 0 15002 14990 2844 0 0 65535 1"
FRAME = bytes.fromhex(
    "42 3900 10fb3000 01 00 e32e b001 0000 9aff 0000 9a3a 8e3a 1c0b 0000 0000 ffff 0100"
)


def test_checksum_and_documented_session_are_valid():
    assert serial_messages.checksum(b"123456789") == 0x29B1
    session = re.search(r"```\n(.*?)```", PAGE.read_text(), re.S)
    lines = re.findall(r"^(host|device) +(\S.*\*\w{4})", session[1], re.M)
    assert len(lines) >= 9
    for speaker, text in lines:
        body = serial_messages.open_line(text.encode())
        assert body is not None, text
        if speaker == "device":
            decode(body)


def test_messages_are_decoded_and_other_bytes_are_refused():
    """Text and binary telemetry decode to the same values."""
    expected = Telemetry(sequence=57, time_us=3210000, state=1, cause=0,
                         supply=pytest.approx(12.003), current=pytest.approx((-0.102, 0.0)),
                         range_voltage=pytest.approx((1.5002, 1.499)),
                         duty=pytest.approx((2844 / 65536, 0.0, 0.0, 65535 / 65536)), echo=1,
                         drop=pytest.approx((0.432, 0.0)))  # fmt: skip
    for body, message in (
        (TEXT, expected), (FRAME, expected), (b"K A 13841", serial_messages.Accepted("A", 13841)),
        (b"N V 6", Refused("V", 6)), (b"P 3 4294967295 5", serial_messages.Pong(3, 4294967295, 5)),
        (b"S rejected=1 new=x", Named("S", {"rejected": "1", "new": "x"})),
    ):  # fmt: skip
        assert decode(body) == message
    assert str(Refused("V", 7)) == "device refused V: above the voltage limit"
    assert str(Refused("V", 99)) == "device refused V: number 99"
    bad = ["", "Z 1", "T 1 2 3", "K A", "K A x", "P 1 2", "S rejected", "T 65536" + " 0" * 15]
    for body in (*(text.encode() for text in bad), b"\xff", FRAME[:-1]):
        with pytest.raises(serial_messages.ProtocolError, match="not of protocol 2"):
            decode(body)
    for number in (-1, 65536):
        with pytest.raises(ValueError, match="expected 0 to 65535"):
            serial_messages.command("V", 1, number)


def frame(body):
    """A message as the device frames it (COBS), its delimiter included."""
    stuffed = b""
    for piece in (body + serial_messages.checksum(body).to_bytes(2, "little")).split(b"\0"):
        for at in range(0, max(len(piece), 1), 254):
            block = piece[at : at + 254]
            stuffed += bytes([len(block) + 1 if at + 254 >= len(piece) else 255]) + block
    return stuffed + b"\0"


@given(st.binary(min_size=1, max_size=600))
def test_frames_have_no_zero_inside_and_open_to_the_body(body):
    framed = frame(body)
    assert framed.count(0) == 1 and framed.endswith(b"\0")
    assert serial_messages.open_frame(framed[:-1]) == body


@given(st.lists(st.text("AKTN 0123456789-=", min_size=1).filter(str.strip)), st.data())
def test_splitting_does_not_depend_on_how_bytes_arrive(bodies, data):
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


def test_pieces_and_endless_lines_are_dropped_and_only_damage_is_counted():
    splitter, piece = Splitter(), line("K A 1")[3:]
    for received, damaged in ((piece + line("K A 1"), 0), (piece, 1), (b"x" * 10_000, 2)):
        splitter.feed(received)
        assert splitter.damaged == damaged
    assert splitter.feed(b"\n" + line("K A 1")) == [b"K A 1"]


DEVICE = yaml.safe_load(Path(__file__).with_name("device.yaml").read_text())


def identity(old="", new=""):
    return serial_messages.DeviceIdentity.from_lines({
        letter: Named(letter, dict(pair.split("=") for pair in text.replace(old, new).split()))
        for letter, text in DEVICE["handshake"].items()
    })  # fmt: skip


def test_handshake_gives_limits_in_si_units_or_what_it_lacks():
    device = identity()
    found = (device.maximum_voltage, device.command_timeout, *device.supply_range)
    assert (*found, device.hot_voltage) == pytest.approx((10.0, 0.2, 6.0, 15.0, 8.0))
    assert device.reset == "power-on, watchdog, after: command timeout"
    for old, new, complaint in (
        ("hot_ms=2000 ", "", "handshake: hot_ms is missing"),
        ("protocol=2", "protocol=1", "the device has protocol 1, expected 2"),
        ("max_mv=10000", "max_mv=ten", "invalid literal"),
    ):
        with pytest.raises(InputError, match=complaint):
            identity(old, new)


@pytest.mark.parametrize(("said", "text"), DEVICE["trips"])
def test_the_last_trip_is_told_in_words_by_a_firmware_that_keeps_it(said, text):
    values = dict(pair.split("=") for pair in said.split())
    assert str(serial_messages.Trip.from_values(values)).startswith(text)


@pytest.mark.parametrize("said", ["trip=x trip_ds=1 trip_open=0", "trip=2", "trip_open=1"])
def test_a_last_trip_without_its_numbers_is_one_line(said):
    with pytest.raises(InputError, match="last trip is .*, expected three numbers"):
        serial_messages.Trip.from_values(dict(pair.split("=") for pair in said.split()))


def window(number, period_us=10000):
    time_us = number * period_us % (1 << 32)
    return Telemetry(number % 65536, time_us, 0, 0, 12.0, (0.0, 0.0), (0.0, 0.0),
                     (0.0, 0.0, 0.0, 0.0), 0)


@given(uptime=st.integers(1000, 2_000_000), first=st.integers(1, 50),
       period=st.sampled_from((2000, 10000, 100000)))
@example(uptime=65536, first=1, period=100000)  # the count goes on as if nothing had happened
def test_a_restart_is_noticed_after_any_uptime(uptime, first, period):
    """Especially after an uptime between half a wrap of the clock (35.8 min) and a whole one."""
    status = LinkStatus()
    status.note(window(uptime, period))
    reached = status.restarted(window(first, period), period)
    # Unnoticed only if both counters match within three windows: one in 20000 restarts.
    same = (uptime - first) * period % (1 << 32), (uptime - first) % 65536
    gap = (-same[0] + same[1] * period) % (65536 * period)
    assert reached or min(gap, 65536 * period - gap) <= 3 * period


@given(uptime=st.integers(1000, 2_000_000), lost=st.integers(0, 20000))
def test_lost_windows_are_no_restart(uptime, lost):
    status = LinkStatus()
    status.note(window(uptime))
    assert not status.restarted(window(uptime + 1 + lost), 10000)

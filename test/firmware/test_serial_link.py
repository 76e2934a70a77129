"""The link against the firmware's logic behind a pseudo terminal, in real time."""

import os
import pty
import re
import time
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import pytest
from host_firmware import HostFirmware
from uno.emulated_bench import on_a_port

from sma_bench.errors import InputError
from sma_bench.hardware import serial_link
from sma_bench.hardware.serial_messages import DeviceState, line

PATIENCE = 30.0
VOLTS = (6000, 0, 0, 3000)


class Watched(serial_link.SerialLink):
    """A link that remembers its readings and events; `change` alters the next bytes it reads."""

    greeting_timeout, first_back_off, longest_back_off = 0.3, 0.05, 0.2

    def __init__(self, path):
        self.readings, self.events, self.change = [], [], None

        def opened():
            port = serial_link.open_port(path())
            read = port.read
            port.read = lambda size=1: self._changed_once(read(size))
            return port

        super().__init__(opened, 100, self.readings.append, self.events.append)

    def _changed_once(self, data):
        change, self.change = self.change, None
        return change(data) if change else data

    def refuses_to_drive(self, why="not armed"):
        with pytest.raises(serial_link.LinkError, match=why):
            self.drive(VOLTS)


@contextmanager
def linked(path):
    link = Watched(path)
    link.start()
    try:
        yield link
    finally:
        link.close()


def wait_for(condition):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.005)


@pytest.fixture
def bench(host_firmware):
    with on_a_port(host_firmware) as bench:
        yield bench


@pytest.fixture
def link(bench):
    with linked(lambda: bench.path) as link:
        assert link.wait_connected(PATIENCE)
        yield link


def drive(link, bench):
    """Command voltages until the wires have them, like a node with a timer; arms again if a busy
    machine was silent for as long as the device's timeout."""

    def step():
        try:
            link.drive(VOLTS)
        except serial_link.LinkError:
            for again in (link.reset, link.arm):
                with suppress(serial_link.LinkError):
                    again()
        time.sleep(0.02)
        return bench.device.duties[0] > 0.2

    wait_for(step)


def is_off(link, bench):
    wait_for(lambda: link.status.state == DeviceState.STOPPED)
    return bench.device.duties == (0.0,) * 4


def test_a_link_knows_its_device_and_its_clock_and_keeps_a_second_host_out(link, bench):
    device = link.status.device
    assert (device.name, device.maximum_voltage) == ("sma-uno", 10.0)
    assert link.events == ["connected to sma-uno ide, last reset: power-on"]
    wait_for(lambda: len(link.readings) > 20)
    now, times = time.monotonic(), [reading.time for reading in link.readings]
    assert times == sorted(times) and 0.0 < now - times[0] < PATIENCE
    assert link.status.not_understood == 0
    with linked(lambda: bench.path) as other:
        wait_for(lambda: "exclusively lock" in other.status.problem)
        assert not other.status.connected
    assert link.status.connected


def test_only_an_armed_device_drives_and_every_stop_is_latched_with_its_cause(bench, link):
    link.refuses_to_drive()
    drive(link, bench)
    link.stop()
    assert is_off(link, bench)
    assert link.events[-1] == f"the device stopped: {link.status.cause_text}"
    assert link.status.cause_text in ("stop byte", "command timeout")
    with pytest.raises(serial_link.LinkError, match="device refused A: stopped: reset first"):
        link.arm()
    link.reset()
    link.refuses_to_drive()
    drive(link, bench)
    wait_for(lambda: link.readings and link.readings[-1].echo >= 1)
    wait_for(lambda: link.status.command_latency > 0.0)
    assert is_off(link, bench)  # nothing was said for its own timeout
    assert re.match(r"this computer sent nothing for \d", link.status.silence)
    link.reset()
    bench.do(lambda: bench.device.set_current(1, 1000))
    wait_for(lambda: link.status.cause_text == "over-current of the back board")
    assert link.events[-1] == "the device stopped: over-current of the back board"


@pytest.mark.parametrize(
    ("body", "answer"),
    [
        ("A 1", "device refused A: armed already"),
        ("V 1 1 9000 0 0 0", "device refused V: wrong nonce or session"),
        ("D", "Accepted(letter='D', value=0)"),
    ],
)
def test_requests_of_another_host_are_noticed(bench, link, body, answer):
    for _ in range(20):
        drive(link, bench)
        assert link.status.unasked == ""
        bench.do(lambda: bench.device.write(line(body)))
        wait_for(lambda: link.status.unasked or link.status.stopped)
        if link.status.unasked == answer:
            break
        # A busy machine was silent for the device's timeout.
        link.stop()
        wait_for(lambda: link.status.stopped)
        link.reset()
    assert link.status.unasked == answer
    link.stop()
    wait_for(lambda: link.status.state == DeviceState.STOPPED or body == "D")
    link.reset()
    link.arm()
    time.sleep(0.05)
    assert link.status.unasked == ""


def test_an_unplugged_cable_is_reported_and_comes_back_disarmed(host_library):
    paths = [""]
    with linked(lambda: paths[-1]) as link:
        for connections in (1, 2):
            with on_a_port(HostFirmware(host_library)) as bench:
                paths.append(bench.path)
                assert link.wait_connected(PATIENCE)
                assert link.status.connections == connections
                link.refuses_to_drive()
                link.arm()
                link.drive(VOLTS)
            wait_for(lambda: not link.status.connected)
            assert link.events[-1].startswith("not connected: ")
            link.refuses_to_drive()
            with pytest.raises(serial_link.LinkError, match="not connected"):
                link.arm()


def test_a_process_suspended_after_a_complete_write_is_no_broken_port(monkeypatch):
    device, host = pty.openpty()
    port, write = serial_link.open_port(os.ttyname(host)), os.write

    def write_and_wait(file, data):
        sent = write(file, data)
        time.sleep(0.3)  # longer than the port's timeout
        return sent

    monkeypatch.setattr(os, "write", write_and_wait)
    assert port.write(b"V 1 2") == 5
    assert os.read(device, 100) == b"V 1 2"
    monkeypatch.undo()
    with pytest.raises(OSError, match="Write timeout"):
        port.write(bytes(1 << 20))  # nobody reads
    os.close(device)
    with pytest.raises(OSError, match="write failed"):
        port.write(b"V")
    port.close()
    os.close(host)


def test_restart_of_the_device_is_noticed_and_disarms(bench, link):
    def restart_unseen():
        # While the host was suspended: clock and sequence match what they would have been.
        uptime = 1e-6 * link.readings[-1].time_us
        bench.device.restart()
        # Nobody reads meanwhile: what it sends stays in the buffer.
        bench.device.run(uptime)

    for restarts, restart in enumerate((bench.device.restart, restart_unseen), start=1):
        drive(link, bench)
        link.events.clear()
        seen = len(link.readings)
        wait_for(lambda n=seen: len(link.readings) > n + 30)
        bench.do(restart)
        wait_for(lambda n=restarts: link.status.connections == n + 1)
        assert "not connected: the device restarted by itself" in link.events
        link.refuses_to_drive()


class OldFirmware:
    """A device whose firmware stores no reason and reports none."""

    def __init__(self, device):
        self._device, self._pending = device, b""
        self.run, self.write = device.run, device.write

    def read(self):
        *lines, self._pending = (self._pending + self._device.read()).split(b"\n")
        bodies = (re.sub(rb" trip\w*=\d+", b"", text.rpartition(b"*")[0]) for text in lines)
        return b"".join(line(body.decode()) for body in bodies)


def test_the_reason_of_a_stop_is_told_after_the_power_came_back_until_it_is_acknowledged(
        bench, link):
    """From a firmware that stores none, nothing is expected."""

    def cut_power():
        connections, frames = link.status.connections, link.status.telemetry
        wait_for(lambda: link.status.telemetry > frames + 30)
        bench.do(bench.device.cut_power)
        wait_for(lambda: link.status.connections > connections)
        return link.status

    assert (str(link.status.trip), link.status.fault) == ("none", "")
    drive(link, bench)
    link.stop()
    assert is_off(link, bench)
    cause = link.status.cause_text
    time.sleep(0.1)
    for _ in range(2):
        status = cut_power()
        assert re.match(rf"{cause}, \d+\.\d s after a start, not acknowledged$", str(status.trip))
        assert status.fault == f"earlier: {status.trip}" and not status.stopped
        assert status.diagnostics["last_trip"] == str(status.trip)
    link.reset()
    assert link.status.fault == ""
    time.sleep(0.1)
    status = cut_power()
    assert (status.trip.open, status.trip.cause > 0, status.fault) == (False, True, "")
    drive(link, bench)
    wait_for(lambda: link.status.stopped)
    with on_a_port(OldFirmware(bench.device)) as old, linked(lambda: old.path) as other:
        assert other.wait_connected(PATIENCE)
        assert (other.status.trip, other.status.left) == (None, "")
        assert other.status.diagnostics["last_trip"] == "not kept by this firmware"


def test_device_that_does_not_speak_the_protocol_is_refused_and_a_port_is_found_by_its_name(
        tmp_path):
    stranger = SimpleNamespace(run=lambda seconds: None, write=lambda data: None,
                               read=lambda: b"AT OK\r\n")
    with on_a_port(stranger) as bench, linked(lambda: bench.path) as link:
        wait_for(lambda: link.status.problem)
        assert link.status.problem.startswith("no answer to the handshake")
    with pytest.raises(InputError, match="port: none in .* expected one device"):
        serial_link.find_port(tmp_path)
    (tmp_path / "usb-Arduino_1").touch()
    assert serial_link.find_port(tmp_path) == str(tmp_path / "usb-Arduino_1")
    (tmp_path / "usb-Arduino_2").touch()
    with pytest.raises(InputError, match="usb-Arduino_1, .*usb-Arduino_2"):
        serial_link.find_port(tmp_path)


def unknown_state(data):
    return b"\n" + line("T 57 3210000 7 0 12003 432 0 -102 0 15002 14990 2844 0 0 65535 1")


def failure(data):
    raise ZeroDivisionError("nobody thought of this")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (unknown_state, "device state 7, expected 0 to 3"),
        (failure, "ZeroDivisionError: nobody thought of this"),
    ],
)
def test_any_end_of_the_connection_is_reported_and_the_stop_byte_is_sent(
        bench, link, change, said):
    for _ in range(20):
        drive(link, bench)
        connected, link.change = link.status.connections, change
        wait_for(lambda n=connected: link.status.connections > n and link.status.stopped)
        assert bench.device.duties == (0.0,) * 4
        if link.status.cause_text == "stop byte":
            break
        # On a busy machine the device's own timeout may come first.
        assert link.status.cause_text == "command timeout"
    assert link.status.cause_text == "stop byte"
    assert f"not connected: {said}" in link.events


def test_frames_from_before_an_answer_are_not_used_after_it(link):
    """On a busy machine one read returns both."""
    wait_for(lambda: link.readings)
    # Lets the caller continue while a frame is processed; shorter than the period of frames, or
    # answers would be later with every frame.
    link._on_reading = lambda frame: time.sleep(0.005 * (frame.state == DeviceState.STOPPED))
    for _ in range(3):
        link.arm()
        link.stop()
        wait_for(lambda: link.status.stopped)
        link.change = lambda data: (time.sleep(0.1), data)[1]
        wait_for(lambda: link.change is None)
        time.sleep(0.05)
        link.reset()
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            assert not link.status.stopped


def test_a_late_answer_is_not_taken_for_one_to_another_host(link, monkeypatch):
    send = link._send_command

    def late(letter, *numbers):
        if letter == "A":
            link.change = lambda data: (time.sleep(0.7), data)[1]
            wait_for(lambda: link.change is None)
        return send(letter, *numbers)

    monkeypatch.setattr(link, "_send_command", late)
    with pytest.raises(serial_link.LateAnswer, match="no answer to A"):
        link.arm()
    monkeypatch.undo()
    with suppress(serial_link.LinkError):
        link.arm()
    link.stop()
    link.reset()
    assert link.status.unasked == ""


def test_a_host_that_was_stopped_itself_does_not_call_the_device_silent(link):
    """Its clock jumps beyond the limit of silence without anything to read, as after SIGSTOP."""

    def stopped(data):
        time.sleep(1.2 * serial_link.SILENCE_LIMIT)
        return b""

    link.change, frames = stopped, link.status.telemetry
    wait_for(lambda: not link.change and link.status.telemetry > frames + 20)
    assert link.status.connections == 1 and link.status.connected

"""The real link on the real image, in virtual time: stamps, losses, late drivers."""

import time
from contextlib import contextmanager, suppress

import pytest
from uno.emulated_uno import START_UP
from virtual_host import VirtualPort

from sma_bench.hardware.serial_link import LinkError, SerialLink
from sma_bench.hardware.serial_messages import DeviceState

VOLTS = (6000, 0, 0, 3000)
PATIENCE = 60.0


class Drive:
    """A driver of a link on an Uno in virtual time: a command every `every` frames of 10 ms.

    It acts in the link's own thread, so that no computer is too slow for it. When a command (except
    the first) is sent for the first time, its byte at `lost` is lost.
    """

    def __init__(self, uno, every, lost=None):
        self.port = VirtualPort(uno)
        self.every, self.lost = every, lost
        self.frames, self.commands, self.sent = [], 0, 0
        self.hung = self._loses = False
        self._write, self.port.write = self.port.write, self._lossy
        self.link = SerialLink(lambda: self.port, 100, self._on_reading, clock=self.port.clock)

    def _lossy(self, data):
        if data.startswith(b"V "):
            self.sent += 1
            if self._loses and self.lost is not None:
                self._loses, at = False, self.lost % len(data)
                data = data[:at] + data[at + 1 :]
        return self._write(data)

    def _on_reading(self, reading):
        with suppress(LinkError):  # not armed
            if len(self.frames) % self.every == 0 and not self.hung:
                self._loses = self.commands > 0
                self.link.drive(VOLTS)
                self.commands += 1
            self.frames.append(reading)

    def until(self, condition):
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end and not self.link.status.problem, self.link.status
            time.sleep(0.01)


@contextmanager
def driving(uno, every, lost=None):
    drive = Drive(uno, every, lost)
    drive.link.start()
    try:
        drive.until(lambda: drive.link.status.telemetry > 30)
        # On a busy machine virtual time runs on before this thread learns that the device is armed.
        for _ in range(100):
            drive.frames.clear()
            drive.commands = 0
            drive.link.arm()
            drive.until(lambda: len(drive.frames) > 4 or drive.link.status.stopped)
            if not drive.link.status.stopped:
                break
            drive.link.reset()
        drive.until(lambda: len(drive.frames) > 100)
        assert {frame.state for frame in drive.frames[2:]} == {DeviceState.ARMED}
        yield drive
    finally:
        drive.link.close()


@pytest.mark.parametrize("lost", [0, 1, 9, -6, -2, -1])
def test_a_command_that_lost_a_byte_is_repeated_before_the_timeout(uno, lost):
    """The driver is so slow that its own next command would come too late."""
    with driving(uno, 12, lost) as drive:
        status = drive.link.status
        assert status.refused >= drive.commands - 2
        assert status.last_refusal in {f"device refused {letter}: {reason}" for letter in "-V"
                                       for reason in ("bad format", "wrong checksum")}


def test_commands_of_a_late_driver_are_repeated_but_not_those_of_a_hung_one(uno):
    with driving(uno, 22) as drive:
        sent, commands = drive.sent, drive.commands
        drive.hung = True
        drive.until(lambda: drive.link.status.state == DeviceState.STOPPED)
        assert drive.link.status.cause_text == "command timeout"
        assert 0 < drive.sent - sent <= 5 + drive.commands - commands


@pytest.mark.parametrize(("rate", "drift"), [(100, 2e-3), (500, -2e-3)])
def test_stamps_are_acquisition_times_within_a_millisecond(uno, rate, drift):
    port, readings = VirtualPort(uno, drift), []
    link = SerialLink(lambda: port, rate, readings.append, clock=port.clock)
    link.start()
    while not readings or readings[-1].time < 4.0:
        assert link.status.problem == ""
        time.sleep(0.01)
    link.close()
    settled = [reading for reading in readings if reading.time > 3.0]
    assert len(settled) > 0.9 * rate
    for reading in settled:
        middle = START_UP + 1e-6 * reading.time_us - 0.5 / rate
        assert reading.time == pytest.approx(middle * (1.0 + drift), abs=1e-3)
    assert link.status.drift == pytest.approx(drift, abs=2e-4)
    assert link.status.lost == link.status.damaged == 0

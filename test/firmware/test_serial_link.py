"""The link against the firmware's logic behind a pseudo terminal, in real time."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import mode
from types import SimpleNamespace

import pytest
from host_firmware import HostFirmware
from uno.emulated_bench import on_a_port

from sma_bench.errors import InputError
from sma_bench.hardware.conversation import LinkError, find_port, open_port
from sma_bench.hardware.serial_link import LinkOptions, SerialLink
from sma_bench.hardware.serial_messages import DeviceState, Telemetry, line

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 30.0
QUICK = LinkOptions(greeting_timeout=0.3, first_back_off=0.05, longest_back_off=0.2)
VOLTS = (6000, 0, 0, 3000)


class Watched(SerialLink):
    """A link that remembers what it told."""

    def __init__(self, path, options=QUICK):
        self.readings = []
        self.events = []
        super().__init__(
            lambda: open_port(path()), options, self.readings.append, self.events.append
        )


@contextmanager
def linked(path, options=QUICK):
    link = Watched(path, options)
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
    """Command volts until the wires have them, as a node with a timer would; armed again where a
    busy machine was silent for as long as the device's own timeout."""

    def step():
        try:
            link.drive(VOLTS)
        except LinkError:
            for again in (link.reset, link.arm):
                with suppress(LinkError):
                    again()
        time.sleep(0.02)
        return bench.device.duties[0] > 0.2

    wait_for(step)


def test_a_link_knows_its_device_and_its_clock_and_keeps_a_second_host_out(link, bench):
    device = link.status.device
    assert (device.name, device.maximum_voltage) == ("sma-uno", 10.0)
    assert link.events == ["connected to sma-uno ide, last reset: power-on"]
    wait_for(lambda: len(link.readings) > 20)
    now = time.monotonic()
    times = [reading.time for reading in link.readings]
    assert times == sorted(times) and 0.0 < now - times[0] < PATIENCE
    assert link.status.not_understood == 0
    with pytest.raises(OSError, match="exclusively lock"):
        open_port(bench.path)
    with linked(lambda: bench.path) as other:
        wait_for(lambda: other.status.problem)
        assert not other.status.connected
    assert link.status.connected


def test_binary_telemetry_above_100_hz(bench):
    with linked(lambda: bench.path, replace(QUICK, rate=500)) as link:
        assert link.wait_connected(PATIENCE)
        wait_for(lambda: len(link.readings) > 100)
        assert link.counters()["rejected"] == 0
        times = [reading.telemetry.time_us for reading in link.readings]
        # On a machine that stands still the port overflows.
        assert mode(b - a for a, b in pairwise(times)) == 2000


def test_nothing_is_driven_without_arming_commands_are_echoed_and_a_timeout_says_who_was_silent(
    bench, link
):
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    drive(link, bench)
    link.disarm()
    assert bench.device.duties == (0.0,) * 4
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    drive(link, bench)
    wait_for(lambda: link.readings[-1].telemetry.echo >= 1 and link.status.command_latency > 0.0)
    wait_for(lambda: link.status.state == DeviceState.STOPPED)
    assert re.match(r"this computer sent nothing for \d", link.status.silence)


def test_stop_is_latched_until_reset_and_arming_and_over_current_has_its_name(bench, link):
    drive(link, bench)
    link.stop()
    wait_for(lambda: link.status.state == DeviceState.STOPPED)
    assert bench.device.duties == (0.0,) * 4
    assert link.events[-1] == f"the device stopped: {link.status.cause_text}"
    assert link.status.cause_text in ("stop byte", "command timeout")
    with pytest.raises(LinkError, match="device refused A: stopped: reset first"):
        link.arm()
    link.reset()
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
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
def test_what_another_host_asks_is_noticed(bench, link, body, answer):
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
    else:
        raise AssertionError(link.status.unasked)
    link.stop()
    wait_for(lambda: link.status.state == DeviceState.STOPPED or body == "D")
    link.reset()
    link.arm()
    time.sleep(0.05)
    assert link.status.unasked == ""


def test_pulled_cable_is_told_and_comes_back_disarmed(host_library):
    paths = [""]
    with linked(lambda: paths[-1]) as link:
        with on_a_port(HostFirmware(host_library)) as bench:
            paths.append(bench.path)
            assert link.wait_connected(PATIENCE)
            link.arm()
            link.drive(VOLTS)
        wait_for(lambda: not link.status.connected)
        assert link.events[-1].startswith("not connected: ")
        with pytest.raises(LinkError, match="not armed"):
            link.drive(VOLTS)
        with pytest.raises(LinkError, match="not connected"):
            link.arm()
        with on_a_port(HostFirmware(host_library)) as bench:
            paths.append(bench.path)
            assert link.wait_connected(PATIENCE)
            assert link.status.connections == 2
            with pytest.raises(LinkError, match="not armed"):
                link.drive(VOLTS)


def test_a_process_that_is_kept_waiting_after_it_wrote_all_is_no_broken_port(monkeypatch):
    device, host = pty.openpty()
    port, write = open_port(os.ttyname(host)), os.write

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
    link.arm()
    link.drive(VOLTS)
    wait_for(lambda: len(link.readings) > 30)
    bench.do(bench.device.restart)
    wait_for(lambda: link.status.connections == 2)
    assert "not connected: the device restarted by itself" in link.events
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    # Once more behind the back of a host that stood still: clock and count are where they would be.
    link.events.clear()
    seen = len(link.readings)
    wait_for(lambda: len(link.readings) > seen + 30)

    def restart():
        uptime = 1e-6 * link.readings[-1].telemetry.time_us
        bench.device.restart()
        # Nobody reads meanwhile: what it sends waits in the cable.
        bench.device.run(uptime)

    bench.do(restart)
    wait_for(lambda: link.status.connections == 3)
    assert "not connected: the device restarted by itself" in link.events


def test_killed_host_leaves_nothing_driven(bench):
    script = f"""
import time
from sma_bench.hardware.serial_link import LinkOptions, SerialLink
from sma_bench.hardware.conversation import LinkError, open_port
link = SerialLink(lambda: open_port({bench.path!r}), LinkOptions(greeting_timeout=0.3))
link.start()
link.wait_connected({PATIENCE})
while True:
    try:
        link.drive({VOLTS})
    except LinkError:  # not armed yet, or not any more: a busy machine
        link.reset()
        link.arm()
    time.sleep(0.02)
"""
    host = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT)
    try:
        wait_for(lambda: bench.device.duties[0] > 0.2)
    finally:
        host.send_signal(signal.SIGKILL)
        host.wait()
    wait_for(lambda: bench.device.duties == (0.0,) * 4)
    with linked(lambda: bench.path) as link:
        assert link.wait_connected(PATIENCE)
        wait_for(lambda: link.status.cause_text == "command timeout")


def test_device_that_does_not_speak_the_protocol_is_refused():
    stranger = SimpleNamespace(
        run=lambda seconds: None, write=lambda data: None, read=lambda: b"AT OK\r\n"
    )
    with on_a_port(stranger) as bench, linked(lambda: bench.path) as link:
        wait_for(lambda: link.status.problem)
        assert link.status.problem.startswith("no answer to the handshake")


def test_port_is_found_by_its_stable_name(tmp_path):
    with pytest.raises(InputError, match="port: none in .* expected one device"):
        find_port(tmp_path)
    (tmp_path / "usb-Arduino_1").touch()
    assert find_port(tmp_path) == str(tmp_path / "usb-Arduino_1")
    (tmp_path / "usb-Arduino_2").touch()
    with pytest.raises(InputError, match="usb-Arduino_1, .*usb-Arduino_2"):
        find_port(tmp_path)


def unknown_state(messages):
    return [replace(m, state=7) if isinstance(m, Telemetry) else m for m in messages]


def failure(messages):
    raise ZeroDivisionError("nobody thought of this")


@pytest.mark.parametrize(
    ("change", "said"),
    [(unknown_state, "the device is in state 7, which nobody knows here"),
     (failure, "ZeroDivisionError: nobody thought of this")],
)  # fmt: skip
def test_whatever_ends_the_conversation_is_told_and_the_stop_byte_is_sent(
    bench, link, change, said
):
    for _ in range(20):
        drive(link, bench)
        connected, receive = link.status.connections, link._conversation.receive
        link._conversation.receive = lambda wait, receive=receive: (
            change(receive(wait)[0]), time.monotonic()
        )  # fmt: skip
        wait_for(lambda n=connected: link.status.connections > n and link.status.stopped)
        assert bench.device.duties == (0.0,) * 4
        if link.status.cause_text == "stop byte":
            break
        # A busy machine may stand still for the device's own timeout first.
        assert link.status.cause_text == "command timeout"
    else:
        raise AssertionError("the stop byte never came before the device's own timeout")
    assert f"not connected: {said}" in link.events


def test_a_host_that_was_stopped_itself_does_not_call_the_device_silent(bench, link):
    """It finds nothing to read, and its clock 0.7 s on, as after SIGSTOP and SIGCONT."""
    conversation = link._conversation
    receive, leaps = conversation.receive, [0.7]

    def receive_after_a_leap(patience):
        if leaps:
            return [], time.monotonic() + leaps.pop()
        return receive(patience)

    conversation.receive = receive_after_a_leap
    frames = link.status.telemetry
    wait_for(lambda: link.status.telemetry > frames + 20)
    assert not leaps
    assert link.status.connections == 1

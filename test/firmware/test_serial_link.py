"""The link against the firmware's logic behind a pseudo terminal, in real time."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

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


def drive_until(link, condition):
    """Command volts until `condition`, as a node with a timer would."""

    def step():
        link.drive(VOLTS)
        time.sleep(0.02)
        return condition()

    wait_for(step)


def test_a_link_knows_its_device_and_its_clock_and_keeps_a_second_host_out(link, bench):
    device = link.status.device
    assert device is not None
    assert device.name == "sma-uno"
    assert device.maximum_voltage == 10.0
    assert link.events == ["connected to sma-uno ide, last reset: power-on"]
    wait_for(lambda: len(link.readings) > 20)
    now = time.monotonic()
    times = [reading.time for reading in link.readings]
    assert times == sorted(times)
    assert 0.0 < now - times[0] < PATIENCE
    assert link.status.lost == link.status.damaged == link.status.not_understood == 0
    with pytest.raises(OSError, match="exclusively lock"):
        open_port(bench.path)
    with linked(lambda: bench.path) as other:
        wait_for(lambda: other.status.problem)
        assert not other.status.connected
    assert link.status.connected


def test_binary_telemetry_above_100_hz(bench):
    with linked(lambda: bench.path, LinkOptions(rate=500, greeting_timeout=0.3)) as link:
        assert link.wait_connected(PATIENCE)
        wait_for(lambda: link.status.telemetry > 100)
        assert link.counters()["rejected"] == 0
        assert link.status.damaged == link.status.lost == 0


def test_nothing_is_driven_without_arming_commands_are_echoed_and_a_timeout_says_who_was_silent(
    bench, link
):
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    link.arm()
    drive_until(link, lambda: bench.device.duties[0] > 0.2)
    link.disarm()
    assert bench.device.duties == (0.0,) * 4
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    link.arm()
    last = [0]

    def send():
        last[0] = link.drive(VOLTS)
        time.sleep(0.02)
        return link.readings and link.readings[-1].telemetry.echo >= 3

    wait_for(send)
    assert link.readings[-1].telemetry.echo <= last[0]
    drive_until(link, lambda: link.status.command_latency > 0.0)
    wait_for(lambda: link.status.state == DeviceState.STOPPED)
    assert link.status.silence.startswith("this computer sent nothing for 0.")


def test_stop_is_latched_until_reset_and_arming_and_over_current_has_its_name(bench, link):
    link.arm()
    drive_until(link, lambda: bench.device.duties[0] > 0.2)
    link.stop()
    wait_for(lambda: link.status.state == DeviceState.STOPPED)
    assert bench.device.duties == (0.0,) * 4
    assert link.events[-1] == "the device stopped: stop byte"
    with pytest.raises(LinkError, match="device refused A: stopped: reset first"):
        link.arm()
    link.reset()
    with pytest.raises(LinkError, match="not armed"):
        link.drive(VOLTS)
    link.arm()
    drive_until(link, lambda: bench.device.duties[0] > 0.2)
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
    link.arm()
    link.drive(VOLTS)
    time.sleep(0.1)
    assert link.status.unasked == ""
    bench.do(lambda: bench.device.write(line(body)))
    wait_for(lambda: link.status.unasked == answer)
    link.stop()
    wait_for(lambda: link.status.state == DeviceState.STOPPED or body == "D")
    link.reset()
    link.arm()
    time.sleep(0.1)
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
from sma_bench.hardware.conversation import open_port
link = SerialLink(lambda: open_port({bench.path!r}), LinkOptions(greeting_timeout=0.3))
link.start()
link.wait_connected({PATIENCE})
link.arm()
while True:
    link.drive({VOLTS})
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
    class Stranger:
        def run(self, seconds): ...

        def write(self, data): ...

        def read(self):
            return b"AT OK\r\n"

    with on_a_port(Stranger()) as bench, linked(lambda: bench.path) as link:
        wait_for(lambda: link.status.problem)
        assert link.status.problem.startswith("no answer to the handshake")


def test_back_off_doubles_to_its_limit():
    waits = []

    class Recording(threading.Event):
        def wait(self, timeout=None):
            waits.append(timeout or 0.0)
            return super().wait(0.001)

    def fail():
        raise FileNotFoundError("no such port")

    link = Watched(fail, LinkOptions(first_back_off=0.5, longest_back_off=4.0))
    link._closing = Recording()
    link.start()
    wait_for(lambda: len(waits) >= 6)
    link.close()
    assert waits[:6] == [0.5, 1.0, 2.0, 4.0, 4.0, 4.0]
    assert link.events == ["not connected: no such port"]


def test_port_is_found_by_its_stable_name(tmp_path):
    with pytest.raises(InputError, match="port: none in .* expected one device"):
        find_port(tmp_path)
    (tmp_path / "usb-Arduino_1").touch()
    assert find_port(tmp_path) == str(tmp_path / "usb-Arduino_1")
    (tmp_path / "usb-Arduino_2").touch()
    with pytest.raises(InputError, match="usb-Arduino_1, .*usb-Arduino_2"):
        find_port(tmp_path)


def test_a_device_that_was_kept_waiting_itself_does_not_hurry():
    """Its command timeout is on its own time: hurrying, it would call a host silent that is not."""

    class Clockwork:
        def __init__(self):
            self.turns = [(time.monotonic(), 0.0)]

        def run(self, seconds):
            self.turns.append((time.monotonic(), self.turns[-1][1] + seconds))

        def write(self, data): ...

        def read(self):
            return b""

    device = Clockwork()
    with on_a_port(device) as bench:
        bench.request(lambda: time.sleep(0.2))
        wait_for(lambda: bench.largest_lag > 0.15 and bench.lag == 0.0)
        turns = list(device.turns)
    for k in range(0, len(turns) - 200, 100):
        (wall, own), (wall_after, own_after) = turns[k], turns[k + 200]
        assert own_after - own < 1.25 * (wall_after - wall) + 7e-3


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
    for _ in range(5):
        link.arm()
        drive_until(link, lambda: bench.device.duties[0] > 0.2)
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
        link.reset()
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

"""A bridge process on an emulated bench, and a commander in the test."""

import json
import resource
import signal
import sys
import time
from contextlib import contextmanager
from types import SimpleNamespace

from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray
from uno.emulated_bench import emulated_bench

from sma_bench.parameters import Parameters

COMMAND_PERIOD = 0.05
PATIENCE = 10.0
CELSIUS_ZERO = 273.15
# An image small enough for a loaded machine, with a wire wide enough to see.
PICTURE = {"image_width": 120, "image_height": 80}


class Commander:
    """While the test waits with `until`, commands and temperatures are published 20 times a
    second: as the wire's readings, or at another `place` for a synthetic camera."""

    def __init__(self, bench, hardware, place="temperature"):
        self.bench, self.hardware = bench, hardware
        self.states, self.power = bench.hear("serial_bridge/state", "wire/power")
        self._command = bench.node.create_publisher(Float64MultiArray, "voltage_command", 100)
        self._camera = bench.node.create_publisher(Temperature, f"wire/{place}", 100)
        self._due = 0.0
        # V of each wire, K that the camera is wrong by; None where nobody commands or looks.
        self.voltage, self.fever = (0.0,), 0.0
        self.lags = []
        """wall clock minus the Uno's (s), over time: grows when the machine is busy"""
        self.kelvin = None
        """temperature that the camera sees instead of the wire's"""

    @property
    def state(self):
        """Newest state, "" before the first."""
        return self.states[-1].data if self.states else ""

    def until(self, condition, patience=30.0):
        """Like `bench.until`, with commands and temperatures published meanwhile."""

        def step():
            self._keep_alive()
            return condition()

        return self.bench.until(step, patience)

    def send(self, *values):
        """Send one command, valid or not."""
        self._command.publish(Float64MultiArray(data=[float(value) for value in values]))

    def _keep_alive(self):
        now = time.monotonic()
        self.lags.append(now - self.hardware.uno.time)
        if now < self._due:
            return
        self._due = now + COMMAND_PERIOD
        if self.voltage is not None:
            self.send(*self.voltage)
        if self.fever is not None:
            kelvin = self.kelvin or float(self.hardware.plant.bench.temperature[0])
            self.show(kelvin - CELSIUS_ZERO + self.fever)

    def show(self, celsius):
        """Publish one temperature."""
        message = Temperature(temperature=celsius)
        message.header.stamp = self.bench.node.get_clock().now().to_msg()
        self._camera.publish(message)


class BridgedRig(Commander):
    """One emulated bench, one serial_bridge, and the test's topics to them; with `camera` the
    temperatures come from a synthetic camera and `ir_camera`."""

    def __init__(self, bench, hardware, camera=False, **parameters):
        super().__init__(bench, hardware, "true_temperature" if camera else "temperature")
        self.node = bench.start("serial_bridge", port=hardware.path, **parameters)
        self.seen = None
        bench.until(self._command.get_subscription_count)
        if camera:
            bench.start("synthetic_camera", **PICTURE, rate=20.0)
            bench.start("ir_camera", **PICTURE, read_cold_wires=True)
            # Match this service now, so that a later fault takes no time.
            assert bench.set_parameter("synthetic_camera", "fault", "none").successful
            self.seen = bench.hear("wire/temperature")
        bench.until(self._camera.get_subscription_count)
        self.refusal = ""
        """the answer to a fault"""
        self.said = b""
        """all bytes from the host through the port, without those that a fault writes"""
        uno = hardware.uno

        def tapped(data):
            self.said += data
            uno.write(data)

        hardware.port.device = SimpleNamespace(run=uno.run, read=uno.read, write=tapped)

    def for_a_while(self, seconds):
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end)

    def enable(self):
        """Wait until all readings are there, then enable."""
        self.until(lambda: self.state == "idle" and self.power and self.seen != [])
        self.for_a_while(0.3)  # of readings, which the self-test looks at
        end = time.monotonic() + PATIENCE
        # The bridge takes some time to discover the camera's node.
        while not (answer := self.ask("enable")).success:
            assert "was never received" in answer.message, answer.message
            assert time.monotonic() < end, answer.message
            self.for_a_while(0.2)

    def ask(self, service):
        """Answer of one of the bridge's services; commands continue meanwhile."""
        future = self.bench.trigger_later(f"serial_bridge/{service}")
        self.until(future.done)
        return future.result()

    def find(self, service):
        """Match a service, so that a later call takes no time."""
        self.bench.know(f"serial_bridge/{service}")
        self.for_a_while(0.2)

    def drive(self, *voltage):
        """Command a voltage and wait until the wire has it."""
        self.voltage = voltage
        self.until(lambda: self.power and abs(self.power[-1].voltage - voltage[0]) < 0.1)

    def record(self, folder):
        """Start a recorder and wait until it has written the bench's messages."""
        states = self.bench.hear("recorder/state")
        self.recorder = self.bench.start("recorder", output=folder)
        self.until(lambda: states and any(json.loads(states[-1].data)["messages"].values()))

    def fill_disk(self, folder):
        """From now on the recorder can write nothing."""
        largest = max(path.stat().st_size for path in folder.rglob("*"))
        limits = (largest, resource.RLIM_INFINITY)
        resource.prlimit(self.recorder.process.pid, resource.RLIMIT_FSIZE, limits)

    def off_after(self, moment, patience=30.0):
        """s of the Uno's clock from `moment` until its last pulse; 0 when none came after it. Waits
        until there was none for 0.5 s."""
        pins = self.hardware.pins
        self.until(lambda: self.hardware.uno.time - max(moment, pins.last_on) > 0.5, patience)
        return max(0.0, pins.last_on - moment)


@contextmanager
def bridged_rig(bench, uno, camera=False, **settings):
    """The wire rig behind a serial_bridge, not enabled yet."""
    # The emulator's thread must run between two slices, every millisecond.
    sys.setswitchinterval(1e-4)
    with emulated_bench(Parameters.defaults(), uno) as hardware:
        rig = BridgedRig(bench, hardware, camera, **settings)
        try:
            yield rig
        finally:
            rig.node.process.send_signal(signal.SIGCONT)
            rig.node.process.kill()
            rig.node.process.wait()

"""A bridge process on an emulated bench, and a commander of the test's own."""

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
# A picture small enough for a loaded machine, of a wire that shows.
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
        """s of the wall's clock less the Uno's, all along: it grows where the machine is busy"""
        self.kelvin = None
        """what the camera sees instead of the wire"""

    @property
    def state(self):
        """Newest state, "" before the first."""
        return self.states[-1].data if self.states else ""

    def until(self, condition, patience=30.0):
        """Wait for a condition as `bench.until`, commanding and looking at the wire meanwhile."""

        def step():
            self._keep_alive()
            return condition()

        return self.bench.until(step, patience)

    def send(self, *values):
        """One command, whatever is in it."""
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
            message = Temperature()
            message.header.stamp = self.bench.node.get_clock().now().to_msg()
            kelvin = self.kelvin or float(self.hardware.plant.bench.temperature[0])
            message.temperature = kelvin - CELSIUS_ZERO + self.fever
            self._camera.publish(message)


class BridgedRig(Commander):
    """One emulated bench, one serial_bridge, and the topics between them and the test; with a
    `camera` the temperatures are what a synthetic one sees, read by `ir_camera`."""

    def __init__(self, bench, hardware, camera=False, **parameters):
        super().__init__(bench, hardware, "true_temperature" if camera else "temperature")
        self.node = bench.start("serial_bridge", port=hardware.path, **parameters)
        self.seen = None
        bench.until(self._command.get_subscription_count)
        if camera:
            bench.start("synthetic_camera", **PICTURE, rate=20.0)
            bench.start("ir_camera", **PICTURE, read_cold_wires=True)
            # Known from now on, so that breaking it takes no time.
            assert bench.set_parameter("synthetic_camera", "fault", "none").successful
            self.seen = bench.hear("wire/temperature")
        bench.until(self._camera.get_subscription_count)
        self.refusal = ""
        """what a fault was answered"""
        self.said = b""
        """all bytes from the host, through the port: what a fault writes is not said by it"""
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
        # The bridge meets the camera's node in its own time.
        while not (answer := self.ask("enable")).success:
            assert "was never received" in answer.message, answer.message
            assert time.monotonic() < end, answer.message
            self.for_a_while(0.2)

    def ask(self, service):
        """Answer of one of the bridge's services; commands go on meanwhile."""
        future = self.bench.trigger_later(f"serial_bridge/{service}")
        self.until(future.done)
        return future.result()

    def find(self, service):
        """Get to know a service, so that asking it takes no time."""
        self.bench.know(f"serial_bridge/{service}")
        self.for_a_while(0.2)

    def drive(self, *voltage):
        """Command and wait until the wire has it."""
        self.voltage = voltage
        self.until(lambda: self.power and abs(self.power[-1].voltage - voltage[0]) < 0.1)

    def record(self, folder):
        """Start a recorder and wait until it has written what the bench says."""
        states = self.bench.hear("recorder/state")
        self.recorder = self.bench.start("recorder", output=folder)
        self.until(lambda: states and any(json.loads(states[-1].data)["messages"].values()))

    def fill_disk(self, folder):
        """No file of the recorder grows from now on."""
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
    """The wire rig behind a serial_bridge, enabled by nobody yet."""
    # The emulator's thread must get its turn between two slices, every half a millisecond.
    sys.setswitchinterval(1e-4)
    with emulated_bench(Parameters.defaults(), uno) as hardware:
        rig = BridgedRig(bench, hardware, camera, **settings)
        try:
            yield rig
        finally:
            rig.node.process.send_signal(signal.SIGCONT)
            rig.node.process.kill()
            rig.node.process.wait()

"""The bench without hardware: the real firmware on an emulated Uno behind a port, with wires.

`serial_bridge` opens the port as it would a cable. Temperatures, which no Uno measures, come from
here as topics: what a perfect camera would read, with its noise.
"""

import sys
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import Temperature

from sma_bench.emulation.emulated_bench import emulated_bench
from sma_bench.errors import InputError
from sma_bench.hardware.bench_sensors import Instrument
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.nodes.base import BenchNode
from sma_bench.ros.node import MEASURED

_MOST_LAG = 0.05
# s; the emulator's thread needs its turn every half a millisecond.
_SWITCH = 1e-4


class EmulatedBenchNode(BenchNode):
    """The emulator has its own thread and goes on in real time whatever the node does."""

    frozen = True

    def __init__(self) -> None:
        super().__init__("emulated_bench")
        sys.setswitchinterval(_SWITCH)
        self._link: Path | None = None
        self._running = emulated_bench(self.parameters)
        self._bench = self._running.__enter__()
        try:
            self._link = _link(self.settings["port"], self._bench.path)
        except InputError:
            self.close()
            raise
        self.get_logger().info(f"port: {self._link or self._bench.path}")
        self._channels = self.parameters["bench.channels"]
        seeds = np.random.SeedSequence(self.settings["seed"]).spawn(len(self._channels) + 1)
        self._cameras = [
            Instrument(
                self.settings["sensor.temperature_noise"],
                self.settings["sensor.temperature_resolution"],
                seed,
            )
            for seed in seeds
        ]
        self._publishers = [
            self.create_publisher(Temperature, f"{place}/temperature", MEASURED)
            for place in (*self._channels, "ambient")
        ]
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self.settings["rate.temperature"], self._look, clock=steady)
        self.create_timer(1.0, self._measure_air, clock=steady)

    def close(self) -> None:
        """The port is gone as if its cable were pulled."""
        self._running.__exit__(None, None, None)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def _look(self) -> None:
        for k, kelvin in enumerate(self._bench.plant.bench.temperature_reading):
            self._publish(k, float(kelvin))

    def _publish(self, place: int, kelvin: float) -> None:
        message = Temperature(variance=self.settings["sensor.temperature_noise"] ** 2)
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = (*self._channels, "ambient")[place]
        message.temperature = float(self._cameras[place].read(kelvin - CELSIUS_ZERO))
        self._publishers[place].publish(message)

    def _measure_air(self) -> None:
        self._publish(len(self._channels), float(self._bench.plant.bench.ambient_temperature))

    def health(self) -> list[DiagnosticStatus]:
        """Whether the emulator keeps up."""
        lag = self._bench.port.lag
        late = lag > _MOST_LAG
        return [self.status(
            "emulator", DiagnosticStatus.WARN if late else DiagnosticStatus.OK,
            "slower than real time: the computer is busy" if late else "in real time",
            {
                "seconds": f"{self._bench.uno.time:.3f}", "lag_ms": f"{1e3 * lag:.1f}",
                "since_last_pulse_s": f"{self._bench.pins.off_for:.3f}",
            },
            "emulated ATmega328P",
        )]  # fmt: skip


def _link(name: str, port: str) -> Path | None:
    """A link of a stable name to the port; it may replace another link, nothing else."""
    if not name:
        return None
    link = Path(name)
    try:
        if link.is_symlink():
            link.unlink()
        link.symlink_to(port)
    except OSError as error:
        raise InputError(f"port: {name}: {error.strerror}") from None
    return link

"""Thermal pictures to wire temperatures: `thermal_image` in, `<channel>/temperature` out."""

import importlib
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_srvs.srv import Trigger

from sma_bench.errors import InputError
from sma_bench.hardware import node_reports
from sma_bench.hardware.node_reports import CameraReport
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_settings import frame_format, frame_judge, wire_gauges
from sma_bench.hardware.thermal_wire import WireReading
from sma_bench.hardware.wire_gauge import ExpectedWarmth
from sma_bench.nodes.base import CAMERA, be_punctual, run_node
from sma_bench.nodes.managed_node import ACTIVE, ManagedNode
from sma_bench.ros.node import MEASURED

# A late picture is worth less than the next one.
_NEWEST = QoSProfile(depth=2, reliability=ReliabilityPolicy.BEST_EFFORT)
_LEVELS = {
    node_reports.OK: DiagnosticStatus.OK,
    node_reports.WARN: DiagnosticStatus.WARN,
    node_reports.ERROR: DiagnosticStatus.ERROR,
}
_FLAG_OPEN = 0


class IrCamera(ManagedNode):
    """One region of the picture a wire; what cannot be trusted is not published."""

    frozen = True
    with_uncertainty = True

    def __init__(self) -> None:
        super().__init__("ir_camera")
        if not self.get_parameter("use_sim_time").value:
            be_punctual(CAMERA)
        channels = self.parameters["bench.channels"]
        self._format = frame_format(self.settings)
        self._judge = frame_judge(self.settings)
        self._gauges = wire_gauges(self.parameters, self.settings)
        self._warmth = [ExpectedWarmth(self.parameters) for _ in channels]
        self._outputs = [self._output(channel) for channel in channels]
        self._report = CameraReport(channels, self.settings["stale_limit"], time.monotonic())
        self.create_subscription(Image, "thermal_image", self._image, _NEWEST)
        if self.settings["read_cold_wires"]:
            for k, channel in enumerate(channels):
                self.create_subscription(
                    BatteryState, f"{channel}/power", partial(self._power, k), _NEWEST
                )
        self._listen_to_flag()
        self.create_service(Trigger, "~/reset", self._reset)
        self.start_by_itself()

    def cleanup(self) -> None:
        """As `~/reset`."""
        for gauge in self._gauges:
            gauge.reset()

    def _output(self, channel: str) -> tuple[Any, Temperature]:
        message = Temperature()
        message.header.frame_id = channel
        return self.create_publisher(Temperature, f"{channel}/temperature", MEASURED), message

    def _listen_to_flag(self) -> None:
        """The Optris driver says when the camera's flag is closed, in a type of its own."""
        try:
            flag_type = importlib.import_module("optris_drivers2.msg").Flag
        except ImportError:
            return
        self.create_subscription(
            flag_type, "flag_state",
            lambda message: self._judge.flag(message.flag_state != _FLAG_OPEN), _NEWEST,
        )

    def _image(self, message: Image) -> None:
        if self.stage != ACTIVE:
            return
        self._report.arrived(time.monotonic())
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        try:
            frame = self._format.decode(
                message.encoding, message.width, message.height, message.step,
                bool(message.is_bigendian), message.data,
            )
        except InputError as error:
            self._hold(f"rejected: {error}")
            return
        reason = self._judge.objection(frame, stamp, self._seconds())
        if reason:
            self._hold(reason)
            return
        now = time.monotonic()
        readings = [
            gauge.read(frame, stamp, warmth.kelvin(now))
            for gauge, warmth in zip(self._gauges, self._warmth, strict=True)
        ]
        for (publisher, output), reading in zip(self._outputs, readings, strict=True):
            self._publish(publisher, output, reading, message)
        self._report.read(readings, self._seconds() - stamp, time.monotonic())

    def _publish(
        self, publisher: Any, output: Temperature, reading: WireReading, image: Image
    ) -> None:
        if reading.reason:
            return
        output.header.stamp = image.header.stamp
        output.temperature = float(reading.kelvin - CELSIUS_ZERO)
        output.variance = float(reading.std**2)
        publisher.publish(output)

    def _hold(self, reason: str) -> None:
        self._report.held(reason)
        self.get_logger().warning(reason, throttle_duration_sec=5.0)

    def _power(self, channel: int, message: BatteryState) -> None:
        self._warmth[channel].voltage(float(message.voltage), time.monotonic())

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.cleanup()
        response.success = True
        response.message = "wires that were lost may be read as their background again"
        return response

    def _seconds(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def health(self) -> list[DiagnosticStatus]:
        """The pictures, and a line a wire."""
        return [
            self.status(r.name, _LEVELS[r.level], r.message, r.values, "infrared camera")
            for r in self._report.reports(time.monotonic())
        ]


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("ir_camera", IrCamera, argv)


if __name__ == "__main__":
    raise SystemExit(main())

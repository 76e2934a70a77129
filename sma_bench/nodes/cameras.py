"""The infrared camera: pictures to temperatures of wires, and a stand-in that draws pictures."""

import array
import importlib
import math
import time
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import BatteryState, Image, JointState, Temperature

from sma_bench.errors import InputError
from sma_bench.hardware import node_reports
from sma_bench.hardware.node_reports import CameraReport
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import ENCODING
from sma_bench.hardware.thermal_settings import (
    ExpectedWarmth,
    frame_format,
    frame_judge,
    synthetic_camera,
    wire_gauges,
)
from sma_bench.nodes.base import CAMERA, BenchNode, be_punctual
from sma_bench.nodes.bench_topics import temperature_message
from sma_bench.ros.node import MEASURED, NEWEST

_LEVELS = {
    node_reports.OK: DiagnosticStatus.OK,
    node_reports.WARN: DiagnosticStatus.WARN,
    node_reports.ERROR: DiagnosticStatus.ERROR,
}
_FLAG_OPEN = 0


class IrCamera(BenchNode):
    """Thermal pictures to wire temperatures: `thermal_image` in, `<channel>/temperature` out. One
    region of the picture a wire; what cannot be trusted is not published."""

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
        self._outputs = [
            (self.create_publisher(Temperature, f"{channel}/temperature", MEASURED),
             temperature_message(channel))
            for channel in channels
        ]  # fmt: skip
        self._report = CameraReport(channels, self.settings["stale_limit"], time.monotonic())
        self.create_subscription(Image, "thermal_image", self._image, NEWEST)
        if self.settings["read_cold_wires"]:
            self.listen(BatteryState, "power", self._power, NEWEST, numbered=True)
        # The Optris driver says when the camera's flag is closed, in a type of its own.
        with suppress(ImportError):
            flag_type = importlib.import_module("optris_drivers2.msg").Flag
            self.create_subscription(
                flag_type, "flag_state",
                lambda message: self._judge.flag(message.flag_state != _FLAG_OPEN), NEWEST,
            )  # fmt: skip
        self.serve(reset=self._reset)

    def _image(self, message: Image) -> None:
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
            if not reading.reason:
                output.header.stamp = message.header.stamp
                output.temperature = float(reading.kelvin - CELSIUS_ZERO)
                output.variance = float(reading.std**2)
                publisher.publish(output)
        self._report.read(readings, self._seconds() - stamp, time.monotonic())

    def _hold(self, reason: str) -> None:
        self._report.held(reason)
        self.get_logger().warning(reason, throttle_duration_sec=5.0)

    def _power(self, channel: int, message: BatteryState) -> None:
        self._warmth[channel].voltage(float(message.voltage), time.monotonic())

    def _reset(self) -> str:
        for gauge in self._gauges:
            gauge.reset()
        return "wires that were lost may be read as their background again"

    def _seconds(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def health(self) -> list[DiagnosticStatus]:
        return [
            self.status(r.name, _LEVELS[r.level], r.message, r.values, "infrared camera")
            for r in self._report.reports(time.monotonic())
        ]


FAULTS = ("none", "frozen", "shutter", "silent", "moved")
_SWAY_PERIOD = 7.0
_TIP = "tip"
# As the Optris driver: one picture waits.
_IMAGE_QOS = QoSProfile(depth=1)


class SyntheticCameraNode(BenchNode):
    """Stands in for an infrared camera: synthetic pictures of wires of a given true temperature.

    Takes `<channel>/true_temperature`, to which a simulated bench's `<channel>/temperature` is
    remapped, and publishes `thermal_image` as the Optris drivers do, at every tick of its rate. In
    real time only.
    """

    def __init__(self) -> None:
        super().__init__("synthetic_camera")
        self.check_settings(self.settings)
        channels = self.parameters["bench.channels"]
        self._camera = synthetic_camera(self.parameters, self.settings)
        self._kelvin = [math.nan for _ in channels]
        self._deflection = 0.0
        self._pictures = self._reported = 0
        height, width = self._camera.shape
        self._message = Image(height=height, width=width, encoding=ENCODING, step=2 * width)
        self._message.data = array.array("B", bytes(2 * width * height))
        # The message's own array: without field checks it keeps a copy of what it is given.
        self._pixels = np.frombuffer(self._message.data, "<u2").reshape(self._camera.shape)
        self._publisher = self.create_publisher(Image, "thermal_image", _IMAGE_QOS)
        self.listen(Temperature, "true_temperature", self._temperature, 10, numbered=True)
        self.create_subscription(JointState, "joint_states", self._joints, 10)
        self.every(1.0 / self.settings["rate"], self._take)

    def check_settings(self, settings: dict[str, Any]) -> None:
        if settings["fault"] not in FAULTS:
            raise InputError(f"fault: {settings['fault']!r}, expected {', '.join(FAULTS)}")

    def _temperature(self, channel: int, message: Temperature) -> None:
        self._kelvin[channel] = message.temperature + CELSIUS_ZERO

    def _joints(self, message: JointState) -> None:
        if _TIP in message.name and len(message.position) == len(message.name):
            self._deflection = message.position[message.name.index(_TIP)]

    def _take(self) -> None:
        fault = self.settings["fault"]
        waiting = any(math.isnan(kelvin) for kelvin in self._kelvin)
        if fault == "silent" or waiting:
            return
        self._message.header.stamp = self.get_clock().now().to_msg()
        if fault == "shutter":
            self._pixels[:] = self._camera.shutter()
        elif fault == "moved":
            self._pixels[:] = self._camera.empty()
        elif fault != "frozen":
            # The wires' ends have moved by the bench's deflection and by the sway.
            swing = math.sin(2.0 * math.pi * time.monotonic() / _SWAY_PERIOD)
            pixels = self._deflection / self.settings["pixel_size"] + self.settings["sway"] * swing
            self._pixels[:] = self._camera.picture(self._kelvin, pixels)
        self._publisher.publish(self._message)
        self._pictures += 1

    def health(self) -> list[DiagnosticStatus]:
        waiting = any(math.isnan(kelvin) for kelvin in self._kelvin)
        fault = self.settings["fault"]
        rate, self._reported = self._pictures - self._reported, self._pictures
        return [self.status(
            "pictures",
            DiagnosticStatus.WARN if waiting or fault != "none" else DiagnosticStatus.OK,
            "waiting for <channel>/true_temperature" if waiting
            else f"synthetic pictures, fault: {fault}",
            {"picture_rate": rate}, "synthetic camera",
        )]  # fmt: skip

"""The infrared camera: wire temperatures from images, and a synthetic camera."""

import array
import math
import time
from contextlib import suppress
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import BatteryState, Image, JointState, Temperature

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import ENCODING, SyntheticCamera, decode_frame
from sma_bench.hardware.thermal_wire import CameraReport, ExpectedWarmth, FrameJudge, wire_gauges
from sma_bench.nodes.base import CAMERA, BenchNode, be_punctual
from sma_bench.ros.node import READINGS, BenchTopics, message_class, seconds_of, stamp_of

_FLAG_OPEN, _SWAY_PERIOD = 0, 7.0  # in optris_drivers2/msg/Flag; s
FAULTS = ("none", "frozen", "shutter", "silent", "moved")


class IrCamera(BenchNode):
    """Wire temperatures from thermal images: `thermal_image` in, `<channel>/temperature` out. Each
    wire has its region of the image; rejected readings are not published."""

    frozen = True
    with_uncertainty = True

    def __init__(self) -> None:
        super().__init__("ir_camera")
        if not self.simulated:
            be_punctual(CAMERA)
        channels, settings = self.parameters["bench.channels"], self.settings
        stale = settings["stale_limit"]
        self._size = settings["image_width"], settings["image_height"]
        self._judge = FrameJudge(stale, settings["shutter_spread"], settings["shutter_settle"])
        self._gauges = wire_gauges(self.parameters, settings)
        self._warmth = [ExpectedWarmth(self.parameters) for _ in channels]
        self._topics = BenchTopics(self, temperature=channels)
        self._report = CameraReport(channels, stale, time.monotonic())
        self.create_subscription(Image, "thermal_image", self.on_image, READINGS, newest=True)
        if settings["read_cold_wires"]:
            self.listen(BatteryState, "power", lambda k, message: self._warmth[k].voltage(
                float(message.voltage), time.monotonic()), numbered=True, newest=True)
        # The Optris driver publishes whether the flag is closed, in a message type of its own.
        with suppress(ImportError):
            self.create_subscription(
                message_class("optris_drivers2/msg/Flag"), "flag_state",
                lambda message: self._judge.flag(message.flag_state != _FLAG_OPEN), READINGS)
        self.serve(reset=self._reset)

    def on_image(self, message: Image) -> None:
        self._report.arrived(time.monotonic())
        stamp = seconds_of(message)
        try:
            frame = decode_frame(self._size, message.encoding, message.width, message.height,
                                 message.step, bool(message.is_bigendian), message.data)
            reason = self._judge.objection(frame, stamp, self._seconds())
        except InputError as error:
            reason = f"rejected: {error}"
        if reason:
            self._report.held(reason)
            self.get_logger().warning(reason, throttle_duration_sec=5.0)
            return
        now = time.monotonic()
        readings = [gauge.read(frame, stamp, warmth.kelvin(now))
                    for gauge, warmth in zip(self._gauges, self._warmth, strict=True)]
        for channel, reading in zip(self.parameters["bench.channels"], readings, strict=True):
            if not reading.reason:
                celsius = reading.kelvin - CELSIUS_ZERO
                self._topics.temperature(channel, celsius, stamp_of(message), reading.std**2)
        self._report.read(readings, self._seconds() - stamp, time.monotonic())

    def _reset(self) -> str:
        for gauge in self._gauges:
            gauge.reset()
        return "an unseen wire may be read as its background again"

    def _seconds(self) -> float:
        return self.get_clock().now().nanoseconds * 1e-9

    def health(self) -> list[DiagnosticStatus]:
        return [self.status(r.name, bytes([r.level]), r.message, r.values, "infrared camera")
                for r in self._report.reports(time.monotonic())]


class SyntheticCameraNode(BenchNode):
    """A synthetic infrared camera, in real time only: renders `<channel>/true_temperature` (the
    simulator's `<channel>/temperature`, remapped) as `thermal_image`, like the Optris drivers."""

    def __init__(self) -> None:
        super().__init__("synthetic_camera")
        self.check_settings(self.settings)
        self._kelvin = [math.nan for _ in self.parameters["bench.channels"]]
        self._deflection, self._pictures, self._reported = 0.0, 0, 0
        height, width = self._camera.shape
        self._message = Image(height=height, width=width, encoding=ENCODING, step=2 * width)
        self._message.data = array.array("B", bytes(2 * width * height))
        # Pixels are written into the message's own array: assigning to the field would copy them.
        self._pixels = np.frombuffer(self._message.data, "<u2").reshape(self._camera.shape)
        self._publisher = self.create_publisher(Image, "thermal_image", READINGS, newest=True)
        self.listen(Temperature, "true_temperature", self.on_temperature, True, newest=True)
        self.create_subscription(JointState, "joint_states", self.on_joints, READINGS, newest=True)
        self.every(1.0 / self.settings["rate"], self._take)

    def check_settings(self, settings: dict[str, Any]) -> None:
        if settings["fault"] not in FAULTS:
            raise InputError(f"fault: {settings['fault']!r}, expected {', '.join(FAULTS)}")
        SyntheticCamera.of(self.parameters, settings)

    def _load(self, *_: Any) -> None:
        super()._load()
        self._camera = SyntheticCamera.of(self.parameters, self.settings)

    def on_temperature(self, channel: int, message: Temperature) -> None:
        self._kelvin[channel] = message.temperature + CELSIUS_ZERO

    def on_joints(self, message: JointState) -> None:
        if "tip" in message.name and len(message.position) == len(message.name):
            self._deflection = message.position[message.name.index("tip")]

    def _take(self) -> None:
        fault = self.settings["fault"]
        if fault == "silent" or self._waiting:
            return
        self._message.header.stamp = self.stamp()
        if fault == "shutter":
            self._pixels[:] = self._camera.shutter()
        elif fault == "moved":
            self._pixels[:] = self._camera.empty()
        elif fault != "frozen":
            # The wires' ends move with the bench's deflection and with the sway.
            swing = math.sin(2.0 * math.pi * time.monotonic() / _SWAY_PERIOD)
            pixels = self._deflection / self.settings["pixel_size"] + self.settings["sway"] * swing
            self._pixels[:] = self._camera.picture(self._kelvin, pixels)
        self._publisher.publish(self._message)
        self._pictures += 1

    @property
    def _waiting(self) -> bool:
        return any(math.isnan(kelvin) for kelvin in self._kelvin)

    def health(self) -> list[DiagnosticStatus]:
        fault, text = self.settings["fault"], "waiting for <channel>/true_temperature"
        rate, self._reported = self._pictures - self._reported, self._pictures
        level = DiagnosticStatus.WARN if self._waiting or fault != "none" else DiagnosticStatus.OK
        text = text if self._waiting else f"synthetic pictures, fault: {fault}"
        return [self.status("pictures", level, text, {"picture_rate": rate}, "synthetic camera")]

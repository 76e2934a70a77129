"""Stands in for an infrared camera: synthetic pictures of wires of a given true temperature.

Takes `<channel>/true_temperature`, to which a simulated bench's `<channel>/temperature` is
remapped, and publishes `thermal_image` as the Optris drivers do. In real time only.
"""

import array
import math
import time
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, JointState, Temperature

from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import ENCODING
from sma_bench.hardware.thermal_settings import synthetic_camera
from sma_bench.nodes.base import run_node
from sma_bench.nodes.managed_node import ACTIVE, ManagedNode

FAULTS = ("none", "frozen", "shutter", "silent", "moved")
_SWAY_PERIOD = 7.0
_TIP = "tip"
# As the Optris driver: one picture waits.
_IMAGE_QOS = QoSProfile(depth=1)


class SyntheticCameraNode(ManagedNode):
    """Draws a picture at every tick of its rate; no picture before all temperatures are known."""

    def __init__(self) -> None:
        super().__init__("synthetic_camera")
        self.check_settings(self.settings)
        channels = self.parameters["bench.channels"]
        self._camera = synthetic_camera(self.parameters, self.settings)
        self._kelvin = [math.nan for _ in channels]
        self._deflection = 0.0
        self._pictures = self._reported = 0
        self._message = self._empty_message()
        # The message's own array: without field checks it keeps a copy of what it is given.
        self._pixels = np.frombuffer(self._message.data, "<u2").reshape(self._camera.shape)
        self._publisher = self.create_publisher(Image, "thermal_image", _IMAGE_QOS)
        for k, channel in enumerate(channels):
            self.create_subscription(
                Temperature, f"{channel}/true_temperature", partial(self._temperature, k), 10
            )
        self.create_subscription(JointState, "joint_states", self._joints, 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self.settings["rate"], self._take, clock=steady)
        self.start_by_itself()

    def check_settings(self, settings: dict[str, Any]) -> None:
        """Refuse an unknown fault."""
        if settings["fault"] not in FAULTS:
            raise InputError(f"fault: {settings['fault']!r}, expected {', '.join(FAULTS)}")

    def _empty_message(self) -> Image:
        height, width = self._camera.shape
        message = Image(height=height, width=width, encoding=ENCODING, step=2 * width)
        message.data = array.array("B", bytes(2 * width * height))
        return message

    def _temperature(self, channel: int, message: Temperature) -> None:
        self._kelvin[channel] = message.temperature + CELSIUS_ZERO

    def _joints(self, message: JointState) -> None:
        if _TIP in message.name and len(message.position) == len(message.name):
            self._deflection = message.position[message.name.index(_TIP)]

    def _take(self) -> None:
        fault = self.settings["fault"]
        waiting = any(math.isnan(kelvin) for kelvin in self._kelvin)
        if self.stage != ACTIVE or fault == "silent" or waiting:
            return
        self._message.header.stamp = self.get_clock().now().to_msg()
        if fault == "shutter":
            self._pixels[:] = self._camera.shutter()
        elif fault == "moved":
            self._pixels[:] = self._camera.empty()
        elif fault != "frozen":
            self._pixels[:] = self._camera.picture(self._kelvin, self._sideways())
        self._publisher.publish(self._message)
        self._pictures += 1

    def _sideways(self) -> float:
        """Pixels by which the wires' ends have moved: the bench's deflection and the sway."""
        sway = self.settings["sway"] * math.sin(2.0 * math.pi * time.monotonic() / _SWAY_PERIOD)
        return self._deflection / self.settings["pixel_size"] + sway

    def health(self) -> list[DiagnosticStatus]:
        """Whether there are pictures, and which fault they show."""
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


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_node("synthetic_camera", SyntheticCameraNode, argv)


if __name__ == "__main__":
    raise SystemExit(main())

"""Thermal pictures of a synthetic camera, in processes, become temperatures or are held back."""

import array
import os

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import BatteryState, Image, Temperature
from std_msgs.msg import Float64MultiArray

from sma_bench.hardware.safety import Freshness
from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import Surface

ROOM = 23.0
# A picture small enough for a loaded machine.
SMALL = {"image_width": 120, "image_height": 80}
QUIET = {"sensor__temperature_noise": 0.0, "sensor__temperature_resolution": 0.0}


def celsius(value):
    return Temperature(temperature=float(value))


def seconds(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


class Diagnostics:
    """Newest status of each part of the node, and all messages ever seen."""

    def __init__(self, bench):
        self._arrays = bench.hear("/diagnostics")

    def newest(self, part):
        for message in reversed(self._arrays):
            for status in message.status:
                if status.name == f"/bench/ir_camera: {part}":
                    return status
        return None

    def says(self, part, text, level):
        status = self.newest(part)
        return status is not None and text in status.message and status.level == level


class Camera:
    """The test's own camera: one small picture at a time."""

    def __init__(self, bench):
        self._bench = bench
        self._scene = SyntheticCamera(
            120, 80, [SyntheticWire((5.0, 40.0), (115.0, 42.0), 0.75)], Surface(0.95, 296.15),
            unevenness=3.0,
        )
        self._publisher = bench.talk("thermal_image", Image)

    def show(self, kelvin=350.0, **fields):
        frame = self._scene.picture([kelvin])
        big = fields.get("is_bigendian", 0)
        message = Image(width=120, height=80, step=240, encoding="mono16")
        message.data = array.array("B", frame.astype(">u2" if big else "<u2").tobytes())
        message.header.stamp = self._bench.node.get_clock().now().to_msg()
        for name, value in fields.items():
            setattr(message, name, value)
        self._publisher.publish(message)


def test_a_simulated_wire_seen_by_the_camera_reads_its_true_temperature(bench):
    truth, read = bench.hear("wire/true_temperature", "wire/temperature")
    bench.start("simulator", remap={"wire/temperature": "wire/true_temperature"}, **QUIET)
    # As on a robot: there message classes copy what they are given.
    unchecked = {"env": {**os.environ, "ROS_PYTHON_CHECK_FIELDS": "0"}}
    bench.start("synthetic_camera", options=unchecked, **SMALL)
    # Of a wire of unknown width a camera would know little more than its place.
    bench.start("ir_camera", read_cold_wires=True, wire__diameter=0.0003, **SMALL)
    command = bench.talk("voltage_command", Float64MultiArray)

    def drive(volts):
        command.publish(Float64MultiArray(data=[volts]))

    def both_above(limit):
        drive(4.0)
        return truth and read and read[-1].temperature > limit and truth[-1].temperature > limit

    bench.until(lambda: drive(0.0) or len(read) > 20)
    assert read[-1].temperature == pytest.approx(ROOM, abs=3.0)
    assert read[-1].header.frame_id == "wire"
    bench.until(lambda: both_above(50.0))
    settled = len(read)
    bench.until(lambda: both_above(50.0) and len(read) > settled + 90)
    stamps = np.array([seconds(message) for message in truth])
    true_values = np.array([message.temperature for message in truth])
    late = read[settled + 60 :]
    expected = np.interp([seconds(message) for message in late], stamps, true_values)
    off = np.array([message.temperature for message in late]) - expected
    deviation = np.array([message.variance for message in late]) ** 0.5
    assert (np.abs(off) < 2 * deviation).all()
    assert np.abs(off).mean() < 0.5 < deviation.mean() < 4.0


def test_readings_stop_and_the_diagnostics_say_why_at_one_fault_after_another(bench):
    """Judgement of frames is that of test/hardware; here, that topics and diagnostics follow it."""
    read = bench.hear("wire/temperature")
    diagnostics = Diagnostics(bench)
    camera, node = (bench.start(name, **SMALL) for name in ("synthetic_camera", "ir_camera"))
    told = bench.talk("wire/true_temperature", Temperature)
    bench.until(lambda: told.publish(celsius(80.0)) or len(read) > 20)
    answer = bench.set_parameter("synthetic_camera", "fault", "upside_down")
    assert not answer.successful and "expected none, frozen" in answer.reason
    for fault, part, said in (
        ("frozen", "camera", "frozen: frame equal to the one before"),
        ("moved", "wire", "no wire stands out"),
        ("none", "camera", "no frame for"),  # which is lost then
    ):
        bench.until(lambda: diagnostics.says("wire", "degC", DiagnosticStatus.OK))
        freshness = Freshness("wire/temperature", 1.0)
        assert bench.set_parameter("synthetic_camera", "fault", fault).successful
        if fault == "none":
            assert camera.end() == 0
        bench.until(lambda: diagnostics.says(part, said, DiagnosticStatus.ERROR))  # noqa: B023
        stopped = len(read)
        freshness.seen(seconds(read[-1]), 0.0)
        bench.until(lambda: diagnostics.says("wire", "", DiagnosticStatus.ERROR))
        assert len(read) == stopped
        # Nothing fresh comes: the experiment's rule for stale feedback trips.
        assert "stale feedback" in freshness.fault(1.1)
        if fault != "none":
            assert bench.set_parameter("synthetic_camera", "fault", "none").successful
            bench.until(lambda: len(read) > stopped + 20)  # noqa: B023
            assert read[-1].temperature == pytest.approx(80.0, abs=1.0)
    assert node.end() == 0


def test_wrong_pictures_and_unseen_wires_are_withheld_and_cold_ones_read_where_not_heated(bench):
    read = bench.hear("wire/temperature")
    diagnostics = Diagnostics(bench)
    bad = bench.start("ir_camera", **SMALL, statistic="mode", remap={"__node": "bad"})
    node = bench.start("ir_camera", **SMALL)
    camera = Camera(bench)
    for part, said, shown in (
        ("wire", "no wire stands out", {"kelvin": 297.65}),  # the background's
        ("camera", "thermal_image has encoding 'bgr8'", {"encoding": "bgr8"}),
        ("camera", "thermal_image is 60 x 80, expected 120 x 80", {"width": 60}),
    ):
        bench.until(
            lambda: camera.show(**shown)  # noqa: B023
            or diagnostics.says(part, said, DiagnosticStatus.ERROR)  # noqa: B023
        )
    assert read == []
    bench.until(lambda: camera.show() or len(read) > 5)
    assert read[-1].temperature == pytest.approx(350.0 - 273.15, abs=1.0)
    bench.until(lambda: camera.show(340.0, is_bigendian=1) or read[-1].temperature < 70.0)
    assert read[-1].temperature == pytest.approx(340.0 - 273.15, abs=1.0)
    assert node.end() == 0 and "Traceback" not in node.output
    assert bad.process.wait(30.0) == 2
    assert "statistic: 'mode', expected mean, median, hottest" in bad.output

    bench.start("ir_camera", read_cold_wires=True, **SMALL)
    read.clear()
    power = bench.talk("wire/power", BatteryState)
    bench.until(lambda: camera.show(297.65) or len(read) > 5)
    assert bench.trigger("ir_camera/reset").success
    assert read[-1].temperature == pytest.approx(24.5, abs=0.5)
    assert read[-1].variance > 0.2**2

    def heated():
        power.publish(BatteryState(voltage=4.0))
        camera.show(297.65)
        return diagnostics.says("wire", "its voltage makes it", DiagnosticStatus.ERROR)

    bench.until(heated)

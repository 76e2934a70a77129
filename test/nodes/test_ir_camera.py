"""Thermal images of a synthetic camera, between processes, become temperatures or are held back."""

import array

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import BatteryState, Image, Temperature

from sma_bench.hardware.thermal_image import Surface, SyntheticCamera, SyntheticWire
from sma_bench.nodes.bench_plan import WIRE, plan_bench
from sma_bench.ros.node import seconds_of

ROOM = 23.0
# An image small enough for a loaded machine.
SMALL = {"image_width": 120, "image_height": 80}
QUIET = {"sensor__temperature_noise": 0.0, "sensor__temperature_resolution": 0.0}


def test_planned_nodes_read_a_wire_by_its_pictures_until_the_camera_freezes(
    bench, tmp_path, monkeypatch
):
    truth, read, power, states = bench.hear(
        "wire/true_temperature", "wire/temperature", "wire/power", "experiment/state"
    )
    protocol = tmp_path / "hold.yaml"
    protocol.write_text("steps: [{kind: hold, level: 4.0, duration: 60.0}]\n")
    # Without the wire's width the camera could measure little more than its position.
    known = {"simulator": QUIET, "ir_camera": {"wire__diameter": 0.0003}}
    given = {"camera": "true", "record": "false", "nodes": "none", "protocol": str(protocol)}
    for node in plan_bench(WIRE, given):
        parameters = {k.replace(".", "__"): v for k, v in node.parameters.items()}
        parameters |= known.get(node.executable, {})
        # As on a robot, where message classes copy their fields.
        checked = "0" if node.executable == "synthetic_camera" else "1"
        monkeypatch.setenv("ROS_PYTHON_CHECK_FIELDS", checked)
        bench.start(node.executable, node.file, remap=dict(node.remappings), **parameters)
    bench.until(lambda: states and states[-1].data == "idle" and len(read) > 20)
    assert read[-1].temperature == pytest.approx(ROOM, abs=3.0)
    assert read[-1].header.frame_id == "wire"
    bench.until(lambda: bench.trigger("experiment/start").success)
    bench.until(lambda: read[-1].temperature > 50.0 and truth[-1].temperature > 50.0)
    settled = len(read) + 40
    bench.until(lambda: len(read) > settled + 30)
    true_values, late = [message.temperature for message in truth], read[settled:]
    expected = np.interp(list(map(seconds_of, late)), list(map(seconds_of, truth)), true_values)
    off = np.array([message.temperature for message in late]) - expected
    deviation = np.array([message.variance for message in late]) ** 0.5
    assert (np.abs(off) < 2 * deviation).all()
    assert np.abs(off).mean() < 0.5 < deviation.mean() < 4.0
    answer = bench.set_parameter("synthetic_camera", "fault", "upside_down")
    assert not answer.successful and "expected none, frozen" in answer.reason
    assert bench.set_parameter("synthetic_camera", "fault", "frozen").successful
    bench.until(lambda: "stale feedback" in states[-1].data)
    assert "temperature" in states[-1].data
    bench.until(lambda: power[-1].voltage < 0.1)


def test_no_temperature_is_stamped_before_its_heat(bench):
    read = bench.hear("wire/temperature")
    bench.start("synthetic_camera", **SMALL, rate=25.0)
    bench.start("ir_camera", **SMALL)
    truth = bench.talk("wire/true_temperature", Temperature)

    def heat(celsius):
        truth.publish(Temperature(temperature=celsius))

    bench.until(lambda: heat(60.0) or len(read) > 5)
    for celsius in (80.0, 100.0):
        late = bench.stamped_after(
            read, lambda m: abs(m.temperature - celsius) < 5.0, lambda: heat(celsius)  # noqa: B023
        )  # fmt: skip
        assert 0 <= late < 1e9
    answer = bench.set_parameter("synthetic_camera", "wires", ["1 2 3"])
    assert not answer.successful and "expected 'X0 Y0 X1 Y1'" in answer.reason


class Camera:
    """A camera in the test, one small image at a time, and the reports of its reader."""

    def __init__(self, bench):
        self._bench = bench
        wires = [SyntheticWire((5.0, 40.0), (115.0, 42.0), 0.75)]
        self._scene = SyntheticCamera(120, 80, wires, Surface(0.95, 296.15), unevenness=3.0)
        self._frame = None
        self._publisher = bench.talk("thermal_image", Image)

    def show(self, celsius=77.0, frozen=False, **fields):
        if not frozen or self._frame is None:
            self._frame = self._scene.picture([celsius + 273.15])
        big = fields.get("is_bigendian", 0)
        message = Image(width=120, height=80, step=240, encoding="mono16")
        message.data = array.array("B", self._frame.astype(">u2" if big else "<u2").tobytes())
        message.header.stamp = self._bench.node.get_clock().now().to_msg()
        for name, value in fields.items():
            setattr(message, name, value)
        self._publisher.publish(message)

    def says(self, part, text):
        """True if the newest status of a part of the node is an error with this text."""
        status = self._bench.status(f"ir_camera: {part}")
        is_error = status is not None and status.level == DiagnosticStatus.ERROR
        return is_error and text in status.message


def test_wrong_pictures_and_unseen_wires_are_withheld_and_cold_ones_read_where_not_heated(bench):
    """The checks of frames are tested in test/hardware; here, their topics and diagnostics."""
    read = bench.hear("wire/temperature")
    node = bench.start("ir_camera", **SMALL)
    camera, background = Camera(bench), ROOM + 1.5
    for part, said, shown in (
        ("wire", "no wire stands out", {"celsius": background}),
        ("camera", "frozen: frame equal to the one before", {"frozen": True}),
        ("camera", "thermal_image has encoding 'bgr8'", {"encoding": "bgr8"}),
        ("camera", "thermal_image is 60 x 80, expected 120 x 80", {"width": 60}),
    ):
        bench.until(lambda: camera.show(**shown) or camera.says(part, said))  # noqa: B023
    assert read == []
    bench.until(lambda: camera.says("camera", "no frame for"))
    bench.until(lambda: camera.show(77.0) or len(read) > 5)
    assert read[-1].temperature == pytest.approx(77.0, abs=1.0)
    bench.until(lambda: camera.show(67.0, is_bigendian=1) or read[-1].temperature < 70.0)
    assert read[-1].temperature == pytest.approx(67.0, abs=1.0)
    assert node.end() == 0 and "Traceback" not in node.output

    bench.start("ir_camera", read_cold_wires=True, **SMALL)
    read.clear()
    power = bench.talk("wire/power", BatteryState)
    bench.until(lambda: camera.show(background) or len(read) > 5)
    assert bench.trigger("ir_camera/reset").success
    assert read[-1].temperature == pytest.approx(background, abs=0.5)
    assert read[-1].variance > 0.2**2

    def heated():
        power.publish(BatteryState(voltage=4.0))
        camera.show(background)
        return camera.says("wire", "its voltage makes it")

    bench.until(heated)

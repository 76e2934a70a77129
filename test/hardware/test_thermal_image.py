"""The camera: Planck's law, pixels, frames that are held back, synthetic images, reports."""

from functools import partial

import numpy as np
import pytest
import thermal_scene

from sma_bench.errors import InputError
from sma_bench.hardware import thermal_image
from sma_bench.hardware.thermal_image import Surface, SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_wire import (
    ERROR,
    OK,
    WARN,
    CameraReport,
    FrameJudge,
    WireReading,
    wire_gauges,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES


def test_band_radiance_is_plancks_law_and_pixels_are_tenths_of_a_degree():
    kelvin = np.array([250.0, 296.15, 353.15, 423.15, 600.0])
    band, back = thermal_image.band_radiance, thermal_image.temperature_of
    np.testing.assert_allclose(band(kelvin), thermal_scene.radiance(kelvin), rtol=2e-7)
    kelvin = np.linspace(180.0, 1500.0, 4567)
    np.testing.assert_allclose(back(band(kelvin)), kelvin, atol=1e-4)
    assert np.isnan(back([-1.0, 0.0])).all()
    assert np.isnan(Surface(0.1, 400.0).temperature(float(band(300.0)), 0.1)).all()
    assert thermal_image.raw_from_kelvin(273.15 + 80.0) == pytest.approx(1800.0)
    assert thermal_image.kelvin_from_raw(1234) == pytest.approx(273.15 + 23.4)
    pixels = np.array([[1230, 1800]], np.uint16)
    read = thermal_image.radiance_of_raw(pixels)
    np.testing.assert_allclose(read, band(thermal_image.kelvin_from_raw(pixels)), rtol=1e-6)
    slope = thermal_image.slope_at(350.0)
    assert slope == pytest.approx(np.diff(band([349.0, 351.0]))[0] / 2.0, rel=1e-4)


def test_pictures_of_either_byte_order_and_padded_rows_are_read_and_a_wrong_one_is_one_line():
    pixels = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000
    padded = np.pad(pixels.astype("<u2"), ((0, 0), (0, 3)), constant_values=9)
    decode = partial(thermal_image.decode_frame, (6, 4))
    for step, big, data in (
        (12, False, pixels.astype("<u2")), (12, True, pixels.astype(">u2")), (18, False, padded),
    ):  # fmt: skip
        frame = decode("mono16", 6, 4, step, big, data.tobytes())
        np.testing.assert_array_equal(frame, pixels)
        assert frame.dtype == np.uint16
    for fields, expected in (
        (("bgr8", 6, 4, 12, False, bytes(48)), "encoding 'bgr8', expected 'mono16'"),
        (("mono16", 8, 4, 16, False, bytes(64)), "is 8 x 4, expected 6 x 4"),
        (("mono16", 6, 4, 6, False, bytes(48)), "step 6, expected 12 or more"),
        (("mono16", 6, 4, 12, False, bytes(40)), "40 bytes, expected 48"),
    ):
        with pytest.raises(InputError, match=f"^[^\n]*{expected}[^\n]*$"):
            decode(*fields)


def test_frames_that_are_frozen_stale_or_warned_of_are_held_back():
    camera = SyntheticCamera(120, 80, [], unevenness=5.0)
    judge = FrameJudge(stale_limit=0.25, shutter_spread=1.0, shutter_settle=0.1)

    def is_said(said, stamp, now, frame=None):
        objection = judge.objection(camera.empty() if frame is None else frame, stamp, now)
        return said in objection and bool(said) == bool(objection)

    frozen = camera.empty()
    for stamp, now, said, *frame in (
        (0.0, 0.02, ""), (0.1, 0.1, "", frozen), (0.2, 0.2, "frozen", frozen.copy()),
        (0.3, 0.3, "frozen", frozen.copy()), (0.4, 0.4, ""), (1.0, 1.5, "0.5 s old"),
        (1.6, 1.6, ""), (1.6, 1.65, "not after the one"), (1.55, 1.66, "not after the one"),
        (9.0, 1.7, "in the future"), (1.75, 1.75, ""),
    ):  # fmt: skip
        assert is_said(said, stamp, now, *frame)
    # The shutter, by its flag and by a uniform image, with the time to settle.
    assert np.ptp(camera.shutter()) < 10 < np.ptp(camera.empty())  # tenths of a kelvin
    judge.flag(closed=True)
    assert is_said("shutter", 1.8, 1.8)
    judge.flag(closed=False)
    assert is_said("", 2.0, 2.0) and is_said("shutter", 2.1, 2.1, camera.shutter())
    assert is_said("shutter", 2.15, 2.15) and is_said("", 2.25, 2.25)


WIDTH, HEIGHT = 40, 60


@pytest.mark.parametrize(("thickness", "sideways"), [(0.3, 8.0), (5.0, 8.0)])
def test_synthetic_pictures_agree_with_brute_force(thickness, sideways):
    wire = SyntheticWire((15.0, -20.0), (15.0, 80.0), thickness)
    surface = Surface(0.9, thermal_scene.ROOM)
    camera = SyntheticCamera(WIDTH, HEIGHT, [wire], surface, noise=0.0)
    frame = thermal_image.kelvin_from_raw(camera.picture([360.0], sideways))
    way = thermal_scene.bent(15.0, sideways, 100.0)
    truth = thermal_scene.scene(
        WIDTH, HEIGHT, lambda y: way(y + 20.0), thickness, 360.0, emissivity=0.9
    )
    excess = truth - thermal_scene.ROOM
    assert np.abs(frame - truth).max() < 0.06 + 0.03 * excess.max()
    assert frame.sum() == pytest.approx(truth.sum(), abs=0.01 * excess.sum())


# --- reports of the camera's node, and refusals at its start

GOOD = WireReading(kelvin=353.15, std=0.8, seen=True, background=297.0)
UNSEEN = WireReading(reason="no wire stands out from the background of 23.0 degC")


def reporting(frames, reading=GOOD):
    report = CameraReport(["wire"], silence_limit=0.25, now=100.0)
    for k in range(frames):
        report.arrived(100.0 + k / 80.0)
        report.read((reading,), latency=0.004, now=100.0 + k / 80.0)
    return report, 100.0 + frames / 80.0


def test_a_running_camera_gives_its_rates_and_its_silence_is_an_error_that_grows():
    report, end = reporting(80)
    camera, wire = report.reports(end)
    assert (camera.level, camera.message) == (OK, "running")
    assert camera.values["frame_rate"] == "80.0" == wire.values["reading_rate"]
    assert camera.values["latency_mean_s"] == "0.0040"
    assert wire.message == "80.0 degC +- 0.8" and wire.values["standard_deviation_K"] == "0.80"
    camera, wire = report.reports(end + 1.0)
    assert camera.level == wire.level == ERROR and camera.values["frame_rate"] == "0.0"
    assert camera.message == "no frame for 1.0 s" and wire.message == "no good frames"
    said = [r.message for r in reporting(0)[0].reports(102.0)]
    assert said == ["no frame for 2.0 s since the start", "no frame yet"]


def test_held_frames_and_wires_are_counted_and_an_error_once_all_are_held():
    report, end = reporting(8)
    report.arrived(end)
    report.held("shutter: the flag covers the detector")
    camera, _ = report.reports(end)
    assert camera.level == WARN and "1 of 9 frames held: shutter" in camera.message
    for k in range(40):
        report.arrived(end + k / 80.0)
        report.held("frozen: frame equal to the one before")
    camera, wire = report.reports(end + 0.5)
    assert camera.level == wire.level == ERROR and camera.message.startswith("frozen: ")
    assert camera.values["held_frozen"] == "40" and camera.values["held_shutter"] == "1"
    report, end = reporting(8, UNSEEN)
    camera, wire = report.reports(end)
    assert (camera.level, wire.level, wire.message) == (OK, ERROR, UNSEEN.reason)
    assert wire.values["held_readings"] == "8" and wire.values["reading_rate"] == "0.0"


def settings(node, **changes):
    return {p.name: p.default for p in NODE_TABLES[node]} | changes


def test_wires_have_a_camera_and_a_region_each_and_bad_ones_are_one_line():
    paper = Parameters.of_paper()
    (gauge,) = wire_gauges(paper, settings("ir_camera"))
    picture = SyntheticCamera.of(paper, settings("synthetic_camera")).picture([345.0])
    reading = gauge.read(picture, 0.0)
    assert abs(reading.kelvin - 345.0) < 0.3 < reading.std and reading.fill < 0.45
    sides = ("front", "front", "back", "back")
    four = paper.replace({"bench.channels": tuple("abcd"), "bench.channel_sides": sides})
    regions = tuple(thermal_image.regions_side_by_side(4, 382, 288))
    kelvin = [320.0, 340.0, 360.0, 380.0]
    frame = SyntheticCamera.of(four, settings("synthetic_camera")).picture(kelvin, 12.0)
    gauges = wire_gauges(four, settings("ir_camera", regions=regions))
    assert [gauge.read(frame, 0.0).kelvin for gauge in gauges] == pytest.approx(kelvin, abs=0.3)
    for wires, said in (
        (("1 2 3",), "wires: '1 2 3', expected 'X0 Y0 X1 Y1'"),
        (("1 2 30 4", "1 2 30 4"), "wires has 2 entries"),
    ):
        with pytest.raises(InputError, match=said):
            SyntheticCamera.of(paper, settings("synthetic_camera", wires=wires))

"""What the camera's node says about itself, and what it refuses at the start."""

import pytest

from sma_bench.errors import InputError
from sma_bench.hardware.node_reports import CameraReport
from sma_bench.hardware.thermal_settings import regions_side_by_side, synthetic_camera, wire_gauges
from sma_bench.hardware.thermal_wire import WireReading
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import NODE_TABLES

GOOD = WireReading(kelvin=353.15, std=0.8, seen=True, background=297.0)
UNSEEN = WireReading(reason="no wire stands out from the background of 23.0 degC")


@pytest.fixture
def report():
    return CameraReport(["wire"], silence_limit=0.25, now=100.0)


def run(report, begin, frames, readings=(GOOD,), period=0.0125):
    for k in range(frames):
        now = begin + k * period
        report.arrived(now)
        report.read(readings, latency=0.004, now=now)
    return begin + frames * period


def test_a_running_camera_gives_its_rates_and_its_silence_is_an_error_that_grows(report):
    end = run(report, 100.0, 80)
    camera, wire = report.reports(end)
    assert (camera.level, camera.message) == ("ok", "running")
    assert camera.values["frame_rate"] == "80.0" == wire.values["reading_rate"]
    assert camera.values["latency_mean_s"] == "0.0040"
    assert wire.message == "80.0 degC +- 0.8" and wire.values["standard_deviation_K"] == "0.80"
    camera, wire = report.reports(end + 1.0)
    assert camera.level == wire.level == "error" and camera.values["frame_rate"] == "0.0"
    assert camera.message == "no frame for 1.0 s" and wire.message == "no good frames"
    never = CameraReport(["wire"], 0.25, 0.0).reports(2.0)
    assert [r.message for r in never] == ["no frame for 2.0 s since the start", "no frame yet"]


def test_held_frames_and_wires_are_counted_and_an_error_once_all_are_held(report):
    end = run(report, 100.0, 8)
    report.arrived(end)
    report.held("shutter: the flag covers the detector")
    camera, _ = report.reports(end)
    assert camera.level == "warn" and "1 of 9 frames held: shutter" in camera.message
    for k in range(40):
        report.arrived(end + k * 0.0125)
        report.held("frozen: frame equal to the one before")
    camera, wire = report.reports(end + 0.5)
    assert camera.level == wire.level == "error" and camera.message.startswith("frozen: ")
    assert camera.values["held_frozen"] == "40" and camera.values["held_shutter"] == "1"
    report = CameraReport(["wire"], silence_limit=0.25, now=100.0)
    camera, wire = report.reports(run(report, 100.0, 8, (UNSEEN,)))
    assert (camera.level, wire.level, wire.message) == ("ok", "error", UNSEEN.reason)
    assert wire.values["held_readings"] == "8" and wire.values["reading_rate"] == "0.0"


# --- settings -------------------------------------------------------------------------------------


def settings(node, **changes):
    return {p.name: p.default for p in NODE_TABLES[node]} | changes


FOUR = Parameters.of_paper().replace({
    "bench.channels": ("a", "b", "c", "d"),
    "bench.channel_sides": ("front", "front", "back", "back"),
})


def test_wires_have_a_camera_and_a_region_each():
    parameters = Parameters.of_paper()
    camera = synthetic_camera(parameters, settings("synthetic_camera"))
    (gauge,) = wire_gauges(parameters, settings("ir_camera"))
    reading = gauge.read(camera.picture([345.0]), 0.0)
    assert abs(reading.kelvin - 345.0) < 0.3 < reading.std
    assert reading.fill < 0.45
    camera = synthetic_camera(FOUR, settings("synthetic_camera"))
    regions = regions_side_by_side(4, 382, 288)
    gauges = wire_gauges(FOUR, settings("ir_camera", regions=tuple(regions)))
    frame = camera.picture([320.0, 340.0, 360.0, 380.0], 12.0)
    kelvin = [gauge.read(frame, 0.0).kelvin for gauge in gauges]
    assert kelvin == pytest.approx([320.0, 340.0, 360.0, 380.0], abs=0.3)


def test_bad_wires_are_one_line():
    for wires, said in (
        (("1 2 3",), "wires: '1 2 3', expected 'X0 Y0 X1 Y1'"),
        (("1 2 30 4", "1 2 30 4"), "wires has 2 entries"),
    ):
        with pytest.raises(InputError, match=said):
            synthetic_camera(Parameters.of_paper(), settings("synthetic_camera", wires=wires))

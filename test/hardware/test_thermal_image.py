"""The camera: Planck's law in its band, pixels, frames to be held back, synthetic pictures."""

import numpy as np
import pytest
import thermal_scene

from sma_bench.errors import InputError
from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import (
    FrameFormat,
    FrameJudge,
    Surface,
    band_radiance,
    kelvin_from_raw,
    radiance_of_raw,
    raw_from_kelvin,
    slope_at,
    spread,
    temperature_of,
)

KELVIN = np.array([250.0, 296.15, 353.15, 423.15, 600.0])


def test_band_radiance_is_plancks_law_and_temperature_reads_it_backwards():
    np.testing.assert_allclose(band_radiance(KELVIN), thermal_scene.radiance(KELVIN), rtol=2e-7)
    kelvin = np.linspace(180.0, 1500.0, 4567)
    np.testing.assert_allclose(temperature_of(band_radiance(kelvin)), kelvin, atol=1e-4)
    assert np.isnan(temperature_of([-1.0, 0.0])).all()
    kelvin, std = Surface(0.1, 400.0).temperature(float(band_radiance(300.0)), 0.1)
    assert np.isnan(kelvin) and np.isnan(std)


def test_pixels_are_tenths_of_a_degree_and_the_slope_the_derivative():
    assert raw_from_kelvin(273.15 + 80.0) == pytest.approx(1800.0)
    assert kelvin_from_raw(1234) == pytest.approx(273.15 + 23.4)
    pixels = np.array([[1230, 1800]], np.uint16)
    np.testing.assert_allclose(
        radiance_of_raw(pixels), band_radiance(kelvin_from_raw(pixels)), rtol=1e-6
    )
    step = band_radiance([349.0, 351.0])
    assert slope_at(350.0) == pytest.approx((step[1] - step[0]) / 2.0, rel=1e-4)
    exponents = [kelvin * slope_at(kelvin) / float(band_radiance(kelvin)) for kelvin in (300, 400)]
    assert exponents == pytest.approx([4.85, 3.81], abs=0.01)


def test_emissivity_and_reflection_are_undone_and_the_deviation_is_that_of_many_draws():
    for emissivity, reflected in ((1.0, 280.0), (0.95, 320.0), (0.3, 320.0)):
        apparent = emissivity * thermal_scene.radiance(360.0)
        apparent += (1 - emissivity) * thermal_scene.radiance(reflected)
        kelvin, std = Surface(emissivity, reflected).temperature(float(apparent), 0.0)
        assert kelvin == pytest.approx(360.0, abs=1e-3) and std == 0.0
    random = np.random.default_rng(5)
    believed = Surface(0.3, 300.0, emissivity_std=0.01, reflected_std=1.5)
    apparent = float(Surface(0.3, 300.0).apparent(370.0))
    noise = 0.02 * slope_at(370.0)
    kelvin, std = believed.temperature(apparent, noise)
    drawn = [
        Surface(0.3 + 0.01 * a, 300.0 + 1.5 * b).temperature(apparent + noise * c, 0.0)[0]
        for a, b, c in random.standard_normal((2000, 3))
    ]
    assert kelvin == pytest.approx(370.0, abs=1e-3)
    assert std == pytest.approx(np.std(drawn), rel=0.06)


FORMAT = FrameFormat(6, 4)
PIXELS = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000


def test_pictures_of_either_byte_order_and_padded_rows_are_read():
    padded = np.pad(PIXELS.astype("<u2"), ((0, 0), (0, 3)), constant_values=9)
    for step, big, data in (
        (12, False, PIXELS.astype("<u2")), (12, True, PIXELS.astype(">u2")), (18, False, padded),
    ):
        frame = FORMAT.decode("mono16", 6, 4, step, big, data.tobytes())
        np.testing.assert_array_equal(frame, PIXELS)
        assert frame.dtype == np.uint16


def test_a_wrong_picture_is_one_line():
    for fields, expected in (
        (("bgr8", 6, 4, 12, False, bytes(48)), "encoding 'bgr8', expected 'mono16'"),
        (("mono16", 8, 4, 16, False, bytes(64)), "is 8 x 4, expected 6 x 4"),
        (("mono16", 6, 4, 6, False, bytes(48)), "step 6, expected 12 or more"),
        (("mono16", 6, 4, 12, False, bytes(40)), "40 bytes, expected 48"),
    ):
        with pytest.raises(InputError, match=expected) as error:
            FORMAT.decode(*fields)
        assert "\n" not in str(error.value)


@pytest.fixture
def camera():
    return SyntheticCamera(120, 80, [], unevenness=5.0)


@pytest.fixture
def judge():
    return FrameJudge(stale_limit=0.25, shutter_spread=1.0, shutter_settle=0.1)


def test_frames_that_are_frozen_stale_or_warned_of_are_held_back(camera, judge):
    frozen = camera.empty()
    for frame, stamp, now, said in (
        (camera.empty(), 0.0, 0.02, ""), (frozen, 0.1, 0.1, ""),
        (frozen.copy(), 0.2, 0.2, "frozen"), (frozen.copy(), 0.3, 0.3, "frozen"),
        (camera.empty(), 0.4, 0.4, ""), (camera.empty(), 1.0, 1.5, "0.5 s old"),
        (camera.empty(), 1.6, 1.6, ""), (camera.empty(), 1.6, 1.65, "there before"),
        (camera.empty(), 1.55, 1.66, "there before"), (camera.empty(), 9.0, 1.7, "in the future"),
        (camera.empty(), 1.75, 1.75, ""),
    ):
        objection = judge.objection(frame, stamp, now)
        assert said in objection and bool(said) == bool(objection)
    # The shutter, by its flag and by a uniform picture, which settles after it.
    assert spread(camera.shutter()) < 1.0 < spread(camera.empty())
    judge.flag(closed=True)
    assert "shutter" in judge.objection(camera.empty(), 1.8, 1.8)
    judge.flag(closed=False)
    for frame, now, said in (
        (camera.empty(), 2.0, ""), (camera.shutter(), 2.1, "shutter"),
        (camera.empty(), 2.15, "shutter"), (camera.empty(), 2.25, ""),
    ):
        objection = judge.objection(frame, now, now)
        assert said in objection and bool(said) == bool(objection)


WIDTH, HEIGHT = 40, 60


def quiet(wire, **options):
    return SyntheticCamera(WIDTH, HEIGHT, [wire], noise=0.0, **options)


@pytest.mark.parametrize(("thickness", "sideways"), [(0.3, 8.0), (0.75, 0.0), (5.0, 8.0)])
def test_pictures_agree_with_brute_force(thickness, sideways):
    wire = SyntheticWire((15.0, -20.0), (15.0, 80.0), thickness)
    camera = quiet(wire, surface=Surface(0.9, thermal_scene.ROOM))
    frame = kelvin_from_raw(camera.picture([360.0], sideways))
    way = thermal_scene.bent(15.0, sideways, 100.0)
    truth = thermal_scene.scene(
        WIDTH, HEIGHT, lambda y: way(y + 20.0), thickness, 360.0, emissivity=0.9
    )
    excess = truth.max() - thermal_scene.ROOM
    assert np.abs(frame - truth).max() < 0.06 + 0.03 * excess
    assert frame.sum() == pytest.approx(truth.sum(), abs=0.01 * (truth - thermal_scene.ROOM).sum())


def test_a_wire_along_rows_is_the_picture_turned_and_one_outside_leaves_no_trace():
    upright = SyntheticWire((20.3, 5.0), (22.0, 55.0), 0.8)
    lying = SyntheticWire((5.0, 20.3), (55.0, 22.0), 0.8)
    turned = SyntheticCamera(HEIGHT, WIDTH, [lying], noise=0.0)
    assert lying.along_x and not upright.along_x
    np.testing.assert_array_equal(
        turned.picture([350.0], 4.0), quiet(upright).picture([350.0], 4.0).T
    )
    camera = quiet(SyntheticWire((-20.0, 5.0), (-20.0, 55.0), 1.0))
    np.testing.assert_array_equal(camera.picture([400.0], -5.0), camera.empty())
    assert camera.picture([400.0], 60.0).max() > camera.empty().max()
    with pytest.raises(InputError, match="2 temperatures for 1 wires"):
        quiet(SyntheticWire((20.0, 5.0), (20.0, 55.0), 1.0)).picture([300.0, 300.0])
    camera = SyntheticCamera(200, 200, [], noise=0.5)
    one, other = kelvin_from_raw(camera.empty()), kelvin_from_raw(camera.empty())
    assert (one - other).std() == pytest.approx(0.5 * 2**0.5, rel=0.03)

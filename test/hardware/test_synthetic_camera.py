"""The synthetic camera's pictures against pictures painted by brute force."""

import numpy as np
import pytest
import thermal_scene

from sma_bench.errors import InputError
from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import Surface, kelvin_from_raw

WIDTH, HEIGHT = 40, 60


def quiet(wire, **options):
    return SyntheticCamera(WIDTH, HEIGHT, [wire], noise=0.0, **options)


@pytest.mark.parametrize("thickness", [0.3, 0.75, 2.0, 5.0])
@pytest.mark.parametrize("sideways", [0.0, 8.0])
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


def test_a_wire_along_rows_is_the_same_picture_turned():
    upright = SyntheticWire((20.3, 5.0), (22.0, 55.0), 0.8)
    lying = SyntheticWire((5.0, 20.3), (55.0, 22.0), 0.8)
    turned = SyntheticCamera(HEIGHT, WIDTH, [lying], noise=0.0)
    assert lying.along_x and not upright.along_x
    np.testing.assert_array_equal(
        turned.picture([350.0], 4.0), quiet(upright).picture([350.0], 4.0).T
    )


def test_noise_has_the_stated_size_and_differs_from_frame_to_frame():
    camera = SyntheticCamera(200, 200, [], noise=0.5)
    one, other = kelvin_from_raw(camera.empty()), kelvin_from_raw(camera.empty())
    assert (one - other).std() == pytest.approx(0.5 * 2**0.5, rel=0.03)


def test_a_wire_out_of_the_picture_leaves_no_trace():
    camera = quiet(SyntheticWire((-20.0, 5.0), (-20.0, 55.0), 1.0))
    np.testing.assert_array_equal(camera.picture([400.0], -5.0), camera.empty())
    assert camera.picture([400.0], 60.0).max() > camera.empty().max()


def test_each_wire_needs_its_temperature():
    with pytest.raises(InputError, match="2 temperatures for 1 wires"):
        quiet(SyntheticWire((20.0, 5.0), (20.0, 55.0), 1.0)).picture([300.0, 300.0])

"""Bytes of a picture to pixel values, and frames that must be held back."""

import numpy as np
import pytest

from sma_bench.errors import InputError
from sma_bench.hardware.synthetic_camera import SyntheticCamera
from sma_bench.hardware.thermal_image import FrameFormat, FrameJudge, spread

FORMAT = FrameFormat(6, 4)
PIXELS = np.arange(24, dtype=np.uint16).reshape(4, 6) * 1000


def test_little_endian_is_read_as_it_is():
    frame = FORMAT.decode("mono16", 6, 4, 12, False, PIXELS.astype("<u2").tobytes())
    np.testing.assert_array_equal(frame, PIXELS)
    assert frame.dtype == np.uint16


def test_big_endian_is_turned():
    frame = FORMAT.decode("mono16", 6, 4, 12, True, PIXELS.astype(">u2").tobytes())
    np.testing.assert_array_equal(frame, PIXELS)
    assert frame.dtype == np.uint16


def test_padded_rows_are_cut():
    padded = np.pad(PIXELS.astype("<u2"), ((0, 0), (0, 3)), constant_values=9)
    frame = FORMAT.decode("mono16", 6, 4, 18, False, padded.tobytes())
    np.testing.assert_array_equal(frame, PIXELS)


BAD = {
    "encoding": (("bgr8", 6, 4, 12, False, bytes(48)), "encoding 'bgr8', expected 'mono16'"),
    "size": (("mono16", 8, 4, 16, False, bytes(64)), "is 8 x 4, expected 6 x 4"),
    "step": (("mono16", 6, 4, 6, False, bytes(48)), "step 6, expected 12 or more"),
    "bytes": (("mono16", 6, 4, 12, False, bytes(40)), "40 bytes, expected 48"),
    "no bytes": (("mono16", 6, 4, 12, False, b""), "0 bytes, expected 48"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_picture_is_one_line(case):
    fields, expected = BAD[case]
    with pytest.raises(InputError, match=expected) as error:
        FORMAT.decode(*fields)
    assert "\n" not in str(error.value)


@pytest.fixture
def camera():
    return SyntheticCamera(120, 80, [], unevenness=5.0)


@pytest.fixture
def judge():
    return FrameJudge(stale_limit=0.25, shutter_spread=1.0, shutter_settle=0.1)


def test_fresh_different_frames_pass(camera, judge):
    for k in range(5):
        assert judge.objection(camera.empty(), k / 80, k / 80 + 0.02) == ""


def test_equal_frames_are_frozen_until_one_differs(camera, judge):
    frame = camera.empty()
    assert judge.objection(frame, 0.0, 0.0) == ""
    assert "frozen" in judge.objection(frame.copy(), 0.1, 0.1)
    assert "frozen" in judge.objection(frame.copy(), 0.2, 0.2)
    assert judge.objection(camera.empty(), 0.3, 0.3) == ""


def test_uniform_frames_are_the_shutter_and_the_picture_settles_after_it(camera, judge):
    assert judge.objection(camera.empty(), 0.0, 0.0) == ""
    assert "shutter" in judge.objection(camera.shutter(), 0.1, 0.1)
    assert "shutter" in judge.objection(camera.empty(), 0.15, 0.15)
    assert judge.objection(camera.empty(), 0.25, 0.25) == ""


def test_the_cameras_own_word_holds_frames_back(camera, judge):
    judge.flag(closed=True)
    assert "shutter" in judge.objection(camera.empty(), 0.0, 0.0)
    judge.flag(closed=False)
    assert judge.objection(camera.empty(), 0.2, 0.2) == ""


def test_old_repeated_and_future_stamps_are_stale(camera, judge):
    assert "0.5 s old" in judge.objection(camera.empty(), 1.0, 1.5)
    assert judge.objection(camera.empty(), 1.6, 1.6) == ""
    assert "there before" in judge.objection(camera.empty(), 1.6, 1.65)
    assert "there before" in judge.objection(camera.empty(), 1.55, 1.66)
    assert "in the future" in judge.objection(camera.empty(), 9.0, 1.7)
    assert judge.objection(camera.empty(), 1.75, 1.75) == ""


def test_spread_of_noise_lies_below_that_of_a_scene(camera):
    assert spread(camera.shutter()) < 1.0 < spread(camera.empty())

"""What an unseen wire means, frame after frame."""

import math

import pytest

from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import Surface
from sma_bench.hardware.thermal_settings import ExpectedWarmth, WireGauge
from sma_bench.hardware.thermal_wire import Optics, Region
from sma_bench.parameters import Parameters

ROOM = 296.15
BLACK = Surface(1.0, ROOM)
FRAME = 1 / 80
OPTICS = Optics(0.75, 0.0, 253.15, 523.15, 0.0)


@pytest.fixture
def camera():
    return SyntheticCamera(200, 60, [SyntheticWire((5.0, 30.0), (195.0, 31.0), 0.75)])


def gauge(cold):
    return WireGauge(Region.parse("", 200, 60, ""), OPTICS, BLACK, cold)


def test_without_leave_nothing_unseen_is_read(camera):
    reading = gauge(cold=False).read(camera.picture([ROOM]), 0.0)
    assert "no wire stands out" in reading.reason and math.isnan(reading.kelvin)


def test_at_rest_the_wire_is_its_background_give_or_take_what_could_be_seen(camera):
    reading = gauge(cold=True).read(camera.picture([ROOM]), 0.0)
    assert reading.reason == "" and not reading.seen
    assert reading.kelvin == pytest.approx(ROOM, abs=0.1)
    assert reading.std == pytest.approx(reading.limit / 2, rel=0.05)
    assert 0.1 < reading.limit < 2.0


def test_what_could_just_be_seen_is_seen_at_twice_that(camera):
    own = gauge(cold=True)
    limit = own.read(camera.picture([ROOM]), 0.0).limit
    seen = [own.read(camera.picture([ROOM + 2 * limit]), k * FRAME).seen for k in range(20)]
    assert sum(seen) == 20


def test_a_cooling_wire_is_read_all_the_way_down(camera):
    own = gauge(cold=True)
    for k in range(160):
        kelvin = ROOM + 60.0 * math.exp(-k * FRAME / 0.2)
        reading = own.read(camera.picture([kelvin]), k * FRAME)
        assert reading.reason == ""
        assert abs(reading.kelvin - kelvin) < 4 * reading.std + 0.2


def test_a_hot_wire_that_is_gone_is_lost_until_it_is_seen_again(camera):
    own = gauge(cold=True)
    assert own.read(camera.picture([350.0]), 0.0).seen
    for k in range(1, 200):
        assert "left its region" in own.read(camera.empty(), k * FRAME).reason
    assert own.read(camera.picture([340.0]), 3.0).reason == ""
    assert "left its region" in own.read(camera.empty(), 3.01).reason
    own.reset()
    assert own.read(camera.empty(), 3.02).reason == ""


def test_a_wire_that_may_have_cooled_behind_the_shutter_is_not_lost(camera):
    own = gauge(cold=True)
    assert own.read(camera.picture([350.0]), 0.0).seen
    assert own.read(camera.picture([ROOM]), 0.8).reason == ""


def test_a_heated_wire_that_is_not_seen_is_not_at_its_background(camera):
    own = gauge(cold=True)
    reading = own.read(camera.empty(), 0.0, expected=310.0)
    assert "its voltage makes it 36.9 degC or more" in reading.reason
    assert own.read(camera.picture([330.0]), 0.1, expected=310.0).reason == ""


def test_expected_warmth_is_a_share_of_the_thermal_model():
    parameters = Parameters.of_paper()
    loss = parameters["wire.heat_transfer_coefficient"] * parameters["wire.surface_area"]
    final = 16.0 / parameters["wire.resistance"] / loss
    tau = parameters["wire.mass"] * parameters["wire.specific_heat"] / loss
    warmth = ExpectedWarmth(parameters)
    assert warmth.kelvin(0.0) == ROOM
    warmth.voltage(4.0, 1.0)
    warmth.voltage(math.nan, 1.1)
    assert warmth.kelvin(1.0 + tau) == pytest.approx(ROOM + 0.3 * final * (1 - math.exp(-1)))
    assert warmth.kelvin(1.0 + 50 * tau) == pytest.approx(ROOM + 0.3 * final)
    warmth.voltage(0.0, 1.0 + 50 * tau)
    assert warmth.kelvin(1.0 + 80 * tau) == pytest.approx(ROOM, abs=1e-6)

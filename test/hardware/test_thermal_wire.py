"""Wire temperature, its standard deviation, and wires that are not seen: on synthetic images."""

import math
from statistics import NormalDist

import numpy as np
import pytest
import thermal_scene
from thermal_scene import ROOM, bent, photograph, straight

from sma_bench.errors import InputError
from sma_bench.hardware.thermal_image import Surface, SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_wire import ExpectedWarmth, Optics, Region, WireGauge, read_wire
from sma_bench.parameters import Parameters

WIDTH, HEIGHT = 60, 120
BLACK = Surface(1.0, ROOM)
HOT = 350.0


def whole(width=WIDTH, height=HEIGHT):
    return Region.parse("", width, height, "regions")


def optics(width=0.75, **changes):
    exact = {"width_std": 0.0, "lowest": 253.15, "highest": 523.15, "accuracy": 0.0}
    return Optics(**{"width": width, **exact, **changes})


def scene(way, width=0.75, kelvin=HOT, **options):
    return thermal_scene.scene(WIDTH, HEIGHT, way, width, kelvin, **options)


UPRIGHT = straight(30.0)


def readings(truth, how=None, n=10, region=None, cold=False):
    random = np.random.default_rng(1)
    how, region = how or optics(), region or whole()
    return [read_wire(photograph(truth, random), region, how, BLACK, cold=cold) for _ in range(n)]


def reading(truth, how=None, **options):
    return readings(truth, how, 1, **options)[0]


def errors(found, kelvin=HOT):
    assert [reading.reason for reading in found if reading.reason] == []
    return np.array([reading.kelvin for reading in found]) - kelvin


# --- the fill factor


def test_a_curved_background_is_in_the_standard_error():
    columns = np.arange(WIDTH) - 30.0
    for background, low, high in ((0.1 * columns, -0.1, 0.1), (0.01 * columns**2, -8.0, -1.0)):
        wall = np.broadcast_to(ROOM + background, (HEIGHT, WIDTH))
        found = readings(scene(UPRIGHT, background=wall), n=6)
        assert low < errors(found).mean() < high
        assert abs(errors(found).mean()) < 2 * np.mean([r.std for r in found])


def test_a_wide_wire_needs_no_correction_a_thin_one_does_and_a_wrong_width_is_seen():
    for width, low, high in ((6.0, -0.15, 0.15), (0.75, 10.0, 40.15)):
        found = readings(scene(UPRIGHT, width), optics(width, correct_fill=False))
        assert low < -errors(found).mean() < high
    wrong = reading(scene(UPRIGHT, 1.0, blur=0.4), optics(4.0))
    assert "narrower in the image than its 4 pixels" in wrong.reason
    assert math.isnan(wrong.kelvin)
    near = reading(scene(straight(28.0), 0.5), optics(0.52, width_std=0.04))
    assert near.kelvin - HOT == pytest.approx(-1.7, abs=0.3)
    assert abs(near.kelvin - HOT) == pytest.approx(near.std, rel=0.3)


def test_the_ends_of_the_range_and_a_second_wire_are_reported():
    for limit, said in (({"highest": 373.15}, "100 degC"), ({"lowest": 300.0}, "26.85 degC")):
        found = reading(scene(UPRIGHT, 4.0, 420.0), optics(4.0, **limit))
        assert f"end of the camera's range ({said})" in found.reason and found.seen
    truth = scene(UPRIGHT) + scene(straight(37.0), kelvin=HOT - 10.0) - ROOM
    assert "another line within 11 pixels" in reading(truth).reason


# --- where the wire is


def test_a_bent_wire_is_followed_and_neither_a_hot_spot_nor_a_clamp_attracts_the_reading():
    for sideways in (-18.0, 25.0):
        found = readings(scene(bent(28.0, sideways, HEIGHT)))
        assert abs(errors(found).mean()) < 0.1
        assert found[0].centre == pytest.approx(28.0 + sideways / 3.0, abs=0.5)
    truth = scene(UPRIGHT)
    truth[40:52, 6:14] = 480.0
    assert abs(errors(readings(truth)).mean()) < 0.1
    truth = scene(UPRIGHT)
    truth[60:84] = scene(UPRIGHT, kelvin=HOT + 20.0)[60:84]
    assert abs(errors(readings(truth)).mean()) < 0.2
    off = errors(readings(truth, optics(statistic="hottest")), HOT + 20.0)
    assert 0.0 < off.mean() < 0.6


def test_short_wires_are_read_where_they_are_and_nothing_beyond_their_ends():
    wire = SyntheticWire((30.0, 8.0), (31.0, 85.0), 0.75)
    picture = SyntheticCamera(WIDTH, HEIGHT, [wire], BLACK).picture([HOT])
    found = read_wire(picture, whole(), optics(), BLACK)
    assert abs(found.kelvin - HOT) < 0.3 and 0.5 < found.visible < 0.65
    strict = read_wire(picture, whole(), optics(least_visible=0.8), BLACK)
    assert "expected 80 % or more" in strict.reason and math.isnan(strict.kelvin)
    wire = SyntheticWire((40.0, 90.0), (340.0, 100.0), 0.75)
    camera = SyntheticCamera(382, 288, [wire], BLACK, unevenness=3.0)
    region, mean = whole(382, 288), optics(statistic="mean")
    found = [read_wire(camera.picture([HOT]), region, mean, BLACK) for _ in range(15)]
    assert np.abs(errors(found)).max() < 0.3
    assert all(0.7 < r.visible < 0.8 for r in found)


def test_a_wire_that_leaves_its_region_is_not_read_nor_taken_for_a_cold_one():
    region = Region.parse("10 0 30 120", WIDTH, HEIGHT, "regions")
    assert not reading(scene(straight(25.0)), region=region).reason
    for slope in (0.15, 0.2, 0.25, 0.3, 0.4):
        for found in readings(scene(straight(26.0, slope)), region=region, n=3):
            assert found.reason or abs(found.kelvin - HOT) < 0.5
            assert bool(found.reason) or slope < 0.3
    for place in range(40, 54, 3):
        assert reading(scene(straight(place)), region=region, cold=True).reason


# --- wires that are not visible


def test_a_wire_as_warm_as_its_background_is_not_invented_and_noise_is_no_wire():
    for found in readings(scene(UPRIGHT, kelvin=ROOM - 0.02), n=60):
        assert "no wire stands out from the background of 23.0 degC" in found.reason
        assert math.isnan(found.kelvin) and math.isnan(found.std)
    for width, height in ((382, 288), (60, 30)):
        camera, region = SyntheticCamera(width, height, [], unevenness=4.0), whole(width, height)
        found = [read_wire(camera.empty(), region, optics(), BLACK) for _ in range(60)]
        assert not any(r.seen for r in found)
    # A faint wire is read correctly or not at all: reading only visible ones causes no bias.
    truth = scene(UPRIGHT, kelvin=ROOM + 0.9)
    found = [r for r in readings(truth, n=80) if not r.reason]
    off = errors(found, ROOM + 0.9)
    assert found and abs(off.mean()) < np.mean([r.std for r in found])
    # A wire colder than its background, if requested.
    truth = scene(UPRIGHT, kelvin=280.0)
    found = reading(truth)
    assert "colder than its background" in found.reason and math.isnan(found.kelvin)
    assert abs(reading(truth, cold=True).kelvin - 280.0) < 0.3


# --- regions


def test_a_region_runs_along_its_longer_side_unless_told_and_a_bad_one_is_one_line():
    for text, expected in (
        ("1 2 3", "expected 'X Y WIDTH HEIGHT'"), ("a 0 30 30", "expected 'X Y WIDTH HEIGHT'"),
        ("-1 0 30 30", "expected 'X Y WIDTH HEIGHT'"),
        ("40 0 30 100", "beyond the frame of 60 x 120"),
        ("0 0 60 8 x", "expected 18 pixels or more along the wire and 14 across"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=f"^regions: wire[^\n]*{expected}[^\n]*$"):
            Region.parse(text, WIDTH, HEIGHT, "regions: wire")
    for text, along_x in (("5 6 40 20", True), ("5 6 20 40", False), ("5 6 40 20 y", False)):
        assert Region.parse(text, WIDTH, HEIGHT, "").along_x == along_x
    assert Region.parse("5 6 40 40 x", WIDTH, HEIGHT, "").shape == (40, 40)


WIDE, TALL, SCENES = 120, 200, 160
STDS = {"width": 0.02, "emissivity": 0.02, "reflected": 2.0, "camera": 1.2}


def drawn_error(random, seed):
    width, emissivity = random.uniform(0.2, 4.0), random.uniform(0.25, 0.95)
    kelvin = random.uniform(320, 460)
    reflected, background = random.uniform(288, 303, 2)
    off = {name: std * random.standard_normal() for name, std in STDS.items()}
    ends = (random.uniform(40, 80), -5.0), (random.uniform(40, 80), 210.0)
    camera = SyntheticCamera(
        WIDE, TALL, [SyntheticWire(*ends, width * (1 + off["width"]))],
        Surface(min(emissivity + off["emissivity"], 1.0), reflected + off["reflected"]),
        background, random.uniform(0, 5), random.uniform(0.3, 1.1), random.uniform(0.04, 0.15),
        seed,
    )  # fmt: skip
    picture = camera.picture([kelvin], random.uniform(-25, 25)).astype(int)
    frame = (picture + round(10 * off["camera"])).astype(np.uint16)
    surface = Surface(emissivity, reflected, STDS["emissivity"], STDS["reflected"])
    how = Optics(width, STDS["width"], 253.15, 700.0, STDS["camera"])
    strip = Region.parse("10 0 100 200 y", WIDE, TALL, "regions")
    reading = read_wire(frame, strip, how, surface)
    return (reading.kelvin - kelvin) / reading.std, reading.reason


def test_the_variance_covers_the_error_as_a_normal_distribution_does():
    random = np.random.default_rng(11)
    drawn = [drawn_error(random, seed) for seed in range(SCENES)]
    errors = np.array([error for error, reason in drawn if not reason])
    assert len(errors) > 0.97 * SCENES
    for times in (1.0, 2.0):
        expected = 2 * NormalDist().cdf(times) - 1
        spread = (expected * (1 - expected) / len(errors)) ** 0.5
        assert abs((np.abs(errors) < times).mean() - expected) < 3 * spread
    assert abs(errors.mean()) < 3 / len(errors) ** 0.5


# --- a wire from image to image

FRAME = 1 / 80


@pytest.fixture
def camera():
    return SyntheticCamera(200, 60, [SyntheticWire((5.0, 30.0), (195.0, 31.0), 0.75)])


def gauge(cold=True):
    return WireGauge(whole(200, 60), optics(), BLACK, cold)


def test_an_unseen_wire_has_the_temperature_of_its_background_only_if_that_is_allowed(camera):
    assert "no wire stands out" in gauge(cold=False).read(camera.picture([ROOM]), 0.0).reason
    own = gauge()
    found = own.read(camera.picture([ROOM]), 0.0)
    assert found.reason == "" and not found.seen
    assert found.kelvin == pytest.approx(ROOM, abs=0.1)
    assert found.std == pytest.approx(found.limit / 2, rel=0.05) and 0.1 < found.limit < 2.0
    warm = ROOM + 2 * found.limit
    assert all(own.read(camera.picture([warm]), k * FRAME).seen for k in range(20))


def test_a_cooling_wire_is_read_throughout_and_a_hot_one_is_lost_unless_it_can_have_cooled(camera):
    own = gauge()
    for k in range(160):
        kelvin = ROOM + 60.0 * math.exp(-k * FRAME / 0.2)
        found = own.read(camera.picture([kelvin]), k * FRAME)
        assert found.reason == "" and abs(found.kelvin - kelvin) < 4 * found.std + 0.2
    own = gauge()
    for kelvin, time, reason, *expected in (
        (350.0, 0.0, ""), (None, 0.01, "left its region"), (None, 2.5, "left its region"),
        (340.0, 3.0, ""), (None, 3.01, "left its region"), (350.0, 3.02, ""), (ROOM, 3.82, ""),
        (None, 3.9, "its voltage makes it 36.9 degC or more", 310.0), (330.0, 4.0, "", 310.0),
        (None, 4.01, "left its region"),
    ):  # fmt: skip
        frame = camera.empty() if kelvin is None else camera.picture([kelvin])
        found = own.read(frame, time, *expected)
        assert reason in found.reason and bool(reason) == bool(found.reason), time
    own.reset()
    assert own.read(camera.empty(), 4.02).reason == ""


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

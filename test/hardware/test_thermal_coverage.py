"""Over scenes drawn at random, the stated deviation is the error: nothing more, nothing less.

Width, emissivity, reflected temperature and the camera's calibration are off by what they are
stated to be uncertain by; blur, noise, background, bend, temperature are anything.
"""

from statistics import NormalDist

import numpy as np

from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import Surface
from sma_bench.hardware.thermal_wire import Optics, Region, read_wire

WIDTH, HEIGHT = 120, 200
REGION = Region.parse("10 0 100 200 y", WIDTH, HEIGHT, "regions")
STD = {"width": 0.02, "emissivity": 0.02, "reflected": 2.0, "camera": 1.2}
SCENES = 400


def draw(random, seed):
    """Error in stated deviations of one reading, and its reason."""
    width, emissivity = random.uniform(0.2, 4.0), random.uniform(0.25, 0.95)
    kelvin = random.uniform(320, 460)
    reflected, background = random.uniform(288, 303, 2)
    off = dict(zip(STD, random.standard_normal(4), strict=True))
    camera = SyntheticCamera(
        WIDTH, HEIGHT,
        [SyntheticWire((random.uniform(40, 80), -5.0), (random.uniform(40, 80), 210.0),
                       width * (1 + STD["width"] * off["width"]))],
        Surface(
            min(emissivity + STD["emissivity"] * off["emissivity"], 1.0),
            reflected + STD["reflected"] * off["reflected"],
        ),
        background,
        unevenness=random.uniform(0, 5),
        blur=random.uniform(0.3, 1.1),
        noise=random.uniform(0.04, 0.15),
        seed=seed,
    )
    picture = camera.picture([kelvin], random.uniform(-25, 25)).astype(int)
    frame = (picture + round(10 * STD["camera"] * off["camera"])).astype(np.uint16)
    optics = Optics(width, STD["width"], 253.15, 700.0, STD["camera"])
    surface = Surface(emissivity, reflected, STD["emissivity"], STD["reflected"])
    reading = read_wire(frame, REGION, optics, surface)
    return (reading.kelvin - kelvin) / reading.std, reading.reason


def test_the_variance_covers_the_error_as_a_normal_distribution_does():
    random = np.random.default_rng(11)
    drawn = [draw(random, seed) for seed in range(SCENES)]
    errors = np.array([error for error, reason in drawn if not reason])
    assert len(errors) > 0.97 * SCENES
    for times in (1.0, 2.0):
        expected = 2 * NormalDist().cdf(times) - 1
        spread = (expected * (1 - expected) / len(errors)) ** 0.5
        assert abs((np.abs(errors) < times).mean() - expected) < 3 * spread
    assert abs(errors.mean()) < 3 / len(errors) ** 0.5

"""Planck's law in the camera's band, and the emissivity of a wire, against independent sums."""

import numpy as np
import pytest
import thermal_scene

from sma_bench.hardware.thermal_image import (
    Surface,
    band_radiance,
    kelvin_from_raw,
    radiance_of_raw,
    raw_from_kelvin,
    slope_at,
    temperature_of,
)

KELVIN = np.array([250.0, 296.15, 353.15, 423.15, 600.0])


def test_band_radiance_is_plancks_law_summed_finely():
    np.testing.assert_allclose(band_radiance(KELVIN), thermal_scene.radiance(KELVIN), rtol=2e-7)


def test_temperature_reads_radiance_backwards_to_a_tenth_of_a_millikelvin():
    kelvin = np.linspace(180.0, 1500.0, 4567)
    np.testing.assert_allclose(temperature_of(band_radiance(kelvin)), kelvin, atol=1e-4)


def test_no_temperature_radiates_less_than_nothing():
    assert np.isnan(temperature_of([-1.0, 0.0])).all()


def test_pixel_values_are_the_drivers_tenths_of_a_degree():
    assert raw_from_kelvin(273.15 + 80.0) == pytest.approx(1800.0)
    assert kelvin_from_raw(1234) == pytest.approx(273.15 + 23.4)
    pixels = np.array([[1230, 1800]], np.uint16)
    np.testing.assert_allclose(
        radiance_of_raw(pixels), band_radiance(kelvin_from_raw(pixels)), rtol=1e-6
    )


def test_slope_is_the_derivative():
    step = band_radiance([349.0, 351.0])
    assert slope_at(350.0) == pytest.approx((step[1] - step[0]) / 2.0, rel=1e-4)


def test_effective_exponent_is_no_constant():
    """Why no power law: what the documentation says of n in L ~ T^n."""
    exponents = [kelvin * slope_at(kelvin) / float(band_radiance(kelvin)) for kelvin in (300, 400)]
    assert exponents == pytest.approx([4.85, 3.81], abs=0.01)


@pytest.mark.parametrize("emissivity", [1.0, 0.95, 0.3])
@pytest.mark.parametrize("reflected", [280.0, 320.0])
def test_emissivity_and_reflection_are_undone(emissivity, reflected):
    truth = 360.0
    apparent = emissivity * thermal_scene.radiance(truth) + (
        1 - emissivity
    ) * thermal_scene.radiance(reflected)
    kelvin, std = Surface(emissivity, reflected).temperature(float(apparent), 0.0)
    assert kelvin == pytest.approx(truth, abs=1e-3)
    assert std == 0.0


def test_standard_deviation_is_that_of_many_draws():
    random = np.random.default_rng(5)
    truth = Surface(0.3, 300.0)
    believed = Surface(0.3, 300.0, emissivity_std=0.01, reflected_std=1.5)
    apparent = float(truth.apparent(370.0))
    noise = 0.02 * slope_at(370.0)
    kelvin, std = believed.temperature(apparent, noise)
    drawn = [
        Surface(0.3 + 0.01 * a, 300.0 + 1.5 * b).temperature(apparent + noise * c, 0.0)[0]
        for a, b, c in random.standard_normal((2000, 3))
    ]
    assert kelvin == pytest.approx(370.0, abs=1e-3)
    assert std == pytest.approx(np.std(drawn), rel=0.06)


def test_less_than_the_reflected_radiance_is_no_temperature():
    kelvin, std = Surface(0.1, 400.0).temperature(float(band_radiance(300.0)), 0.1)
    assert np.isnan(kelvin) and np.isnan(std)

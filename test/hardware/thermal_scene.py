"""Thermal pictures by brute force, independent of the package: Planck's law summed on a fine grid,
a wire painted on pixels divided by eight, blurred and averaged."""

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter

FINE = 8
WAVELENGTHS = np.linspace(7.5e-6, 13e-6, 4001)
ROOM = 296.15


def radiance(kelvin):
    """Band radiance, W/(m2 sr), of temperatures of any shape."""
    exponent = 6.62607015e-34 * 299792458.0 / 1.380649e-23 / WAVELENGTHS
    factor = 2 * 6.62607015e-34 * 299792458.0**2 / WAVELENGTHS**5
    spectral = factor / (np.exp(exponent / np.asarray(kelvin)[..., None]) - 1)
    return (
        np.trapezoid(spectral, WAVELENGTHS)
        if hasattr(np, "trapezoid")
        else np.trapz(spectral, WAVELENGTHS)
    )


@cache
def grid():
    """Temperatures and their radiances."""
    kelvin = np.arange(220.0, 640.0, 0.25)
    return kelvin, radiance(kelvin)


def temperature(value):
    kelvin, radiances = grid()
    return np.interp(value, radiances, kelvin)


def scene(
    width, height, way, thickness, kelvin, emissivity=1.0, background=ROOM, blur=0.7, reflected=ROOM
):
    """True temperatures (height, width) in K, without noise, of a wire at `way(y)` (x, slope)."""
    y, x = (np.mgrid[0 : height * FINE, 0 : width * FINE] + 0.5) / FINE - 0.5
    centre, slope = way(y)
    depth = thickness / 2 - np.abs(x - centre) / np.hypot(1.0, slope)
    wire = np.clip(depth * FINE + 0.5, 0.0, 1.0)
    blurred = gaussian_filter(wire, blur * FINE, mode="nearest")
    share = blurred.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    surface = emissivity * radiance(kelvin) + (1 - emissivity) * radiance(reflected)
    behind = radiance(background)
    return temperature(behind + share * (surface - behind))


def photograph(kelvin, random, noise=0.08):
    """Pixel values of true temperatures: noise, then steps of 0.1 K."""
    noisy = kelvin + noise * random.standard_normal(kelvin.shape)
    return np.rint((noisy - 273.15) * 10 + 1000).astype(np.uint16)


def straight(x, slope=0.0):
    return lambda y: (x + slope * y, slope)


def bent(x, sideways, length):
    """Moved by `sideways` at y = length, with constant curvature."""
    return lambda y: (x + sideways * (y / length) ** 2, 2 * sideways * y / length**2)

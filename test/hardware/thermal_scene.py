"""Thermal images by brute force, independent of the package: Planck's law summed on a fine grid, a
wire drawn on pixels divided by eight, blurred and averaged."""

from functools import cache

import numpy as np
from scipy.constants import c, h, k
from scipy.integrate import trapezoid
from scipy.ndimage import gaussian_filter

FINE = 8
WAVELENGTHS = np.linspace(7.5e-6, 13e-6, 2001)
ROOM = 296.15


def radiance(kelvin):
    exponent = h * c / (k * WAVELENGTHS * np.asarray(kelvin)[..., None])
    return trapezoid(2 * h * c**2 / WAVELENGTHS**5 / np.expm1(exponent), WAVELENGTHS)


@cache
def grid():
    kelvin = np.arange(220.0, 640.0, 0.25)
    return kelvin, radiance(kelvin)


def scene(width, height, way, thickness, kelvin, emissivity=1.0, background=ROOM, blur=0.7,
          reflected=ROOM):
    """True temperatures (height, width) in K, without noise, of a wire at `way(y)` (x, slope)."""
    y, x = (np.mgrid[0 : height * FINE, 0 : width * FINE] + 0.5) / FINE - 0.5
    centre, slope = way(y)
    depth = thickness / 2 - np.abs(x - centre) / np.hypot(1.0, slope)
    wire = np.clip(depth * FINE + 0.5, 0.0, 1.0)
    blurred = gaussian_filter(wire, blur * FINE, mode="nearest")
    share = blurred.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    surface = emissivity * radiance(kelvin) + (1 - emissivity) * radiance(reflected)
    temperatures, radiances = grid()
    behind = np.interp(background, temperatures, radiances)
    return np.interp(behind + share * (surface - behind), radiances, temperatures)


def photograph(kelvin, random, noise=0.08):
    noisy = kelvin + noise * random.standard_normal(kelvin.shape)
    return np.rint((noisy - 273.15) * 10 + 1000).astype(np.uint16)


def straight(x, slope=0.0):
    return lambda y: (x + slope * y, slope)


def bent(x, sideways, length):
    return lambda y: (x + sideways * (y / length) ** 2, 2 * sideways * y / length**2)

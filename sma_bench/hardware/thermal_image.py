"""Images of an infrared camera, real and synthetic: pixel values, radiance, emissivity of a wire.

A frame is an array (height, width) of pixel values as the Optris drivers publish them, T[degC] =
(value - 1000)/10. The band is 7.5 to 13 um (Optris PI and Xi data sheets) with a flat response, as
the maker publishes none. It matters little, as only ratios of radiances count: a response that
falls to half at 13 um changes the correction of an emissivity of 0.5 at 100 degC by 0.4 K."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.parameters import Parameters

Frame = NDArray[np.uint16]

ENCODING, RAW_OFFSET, RAW_PER_KELVIN = "mono16", 1000, 10
BAND = (7.5e-6, 13e-6)  # m, shortest and longest wavelength
_PLANCK_1 = 1.191042972e-16  # 2 h c^2, W m2/sr
_PLANCK_2 = 1.438776877e-2  # h c/k, m K
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_HALF_BAND = (BAND[1] - BAND[0]) / 2
_WAVELENGTHS = (BAND[0] + BAND[1]) / 2 + _HALF_BAND * _NODES
_PLANCK_FACTORS = _PLANCK_1 / _WAVELENGTHS**5 * _WEIGHTS * _HALF_BAND
_NOISE_PICTURES = 8  # synthetic noise is drawn once, for so many images
_BLURRED_AWAY = 5.0  # standard deviations of the blur, from a wire's edge to where it has no effect
_MARGIN = 0.05  # of the image's width, from its border to the ends of a wire


def decode_frame(size: tuple[int, int], encoding: str, width: int, height: int, step: int,
                 big_endian: bool, data: object) -> Frame:
    """Pixel values (height, width) of an image message's fields; `size`: expected width and height;
    `step`: bytes from row to row. Raises InputError: wrong encoding, size or number of bytes."""
    flat = np.frombuffer(data, np.uint8)  # type: ignore[call-overload]
    for wrong, problem in (
        (encoding != ENCODING, f"has encoding {encoding!r}, expected {ENCODING!r}"),
        ((width, height) != size, f"is {width} x {height}, expected {size[0]} x {size[1]}"),
        (step < 2 * width, f"has step {step}, expected {2 * width} or more"),
        (flat.size < height * step,
         f"has {flat.size} bytes, expected {height * step} ({height} x {step})")):
        if wrong:
            raise InputError(f"thermal_image {problem}")
    rows = flat[: height * step].reshape(height, step)[:, : 2 * width]
    pixels = np.ascontiguousarray(rows).view(">u2" if big_endian else "<u2")
    return pixels.astype(np.uint16, copy=False)


def raw_from_kelvin(kelvin: ArrayLike) -> Array:
    """Pixel values, not yet rounded, of temperatures in K."""
    return (np.asarray(kelvin) - CELSIUS_ZERO) * RAW_PER_KELVIN + RAW_OFFSET


def kelvin_from_raw(raw: ArrayLike) -> Array:
    return (np.asarray(raw, float) - RAW_OFFSET) / RAW_PER_KELVIN + CELSIUS_ZERO


def band_radiance(kelvin: ArrayLike) -> Array:
    """Black body radiance in the band, W/(m2 sr), of temperatures (any shape) in K above 0.
    Planck's law integrated with 24 Gauss points: exact to 1e-12 between 200 and 2000 K."""
    temperature = np.asarray(kelvin, float)[..., np.newaxis]
    return (_PLANCK_FACTORS / np.expm1(_PLANCK_2 / (_WAVELENGTHS * temperature))).sum(axis=-1)


# Radiance of every possible pixel value; strictly rising, hence invertible.
_TABLE_KELVIN = kelvin_from_raw(np.arange(2**16))
_TABLE = band_radiance(_TABLE_KELVIN)
_TABLE_SLOPE = np.gradient(_TABLE) * RAW_PER_KELVIN
_TABLE_SINGLE = _TABLE.astype(np.float32)


def radiance_of_raw(raw: NDArray[np.uint16]) -> NDArray[np.float32]:
    """Radiance of pixel values (any shape), single precision (1e-7)."""
    return _TABLE_SINGLE[raw]


def temperature_of(radiance: ArrayLike) -> Array:
    """Black body temperature in K of band radiances; NaN outside 173 K to 6700 K."""
    return np.interp(np.asarray(radiance, float), _TABLE, _TABLE_KELVIN, left=np.nan, right=np.nan)


def slope_at(kelvin: float) -> float:
    """dL/dT in W/(m2 sr K)."""
    return float(np.interp(kelvin, _TABLE_KELVIN, _TABLE_SLOPE))


@dataclass(frozen=True)
class Surface:
    """Radiative properties of a wire, with one standard deviation each."""

    emissivity: float  # in the camera's band, above 0, at most 1
    reflected_temperature: float  # K, of the surroundings that the wire reflects (black bodies)
    emissivity_std: float = 0.0
    reflected_std: float = 0.0

    @classmethod
    def of(cls, parameters: Parameters, settings: Mapping[str, Any]) -> "Surface":
        """From the parameters of `ir_camera` or `synthetic_camera`."""
        ambient = parameters["environment.ambient_temperature"]
        stds = (settings.get(name, 0.0) for name in ("emissivity_std", "reflected_temperature_std"))
        return cls(settings["emissivity"], settings["reflected_temperature"] or ambient, *stds)

    @cached_property
    def _reflected(self) -> float:
        return float(band_radiance(self.reflected_temperature))

    def apparent(self, kelvin: ArrayLike) -> Array:
        """Radiance, emitted and reflected, of the surface of a wire at these K."""
        return self.emissivity * band_radiance(kelvin) + (1.0 - self.emissivity) * self._reflected

    def temperature(self, apparent: float, apparent_std: float) -> tuple[float, float]:
        """Temperature (K) and its standard deviation (first order) from the radiance apparent =
        e L(T) + (1 - e) L(T_reflected); NaN if L(T) is less than that of 173 K."""
        reflected, mirrored = self._reflected, 1.0 - self.emissivity
        emitted = (apparent - mirrored * reflected) / self.emissivity
        kelvin = float(temperature_of(emitted))
        deviation = math.hypot(apparent_std, (emitted - reflected) * self.emissivity_std,
                               mirrored * slope_at(self.reflected_temperature) * self.reflected_std)
        return kelvin, deviation / self.emissivity / slope_at(kelvin)


class SyntheticWire(NamedTuple):
    """A wire, straight at rest: (x, y) of its clamped and its free end, and its width; pixels."""

    start: tuple[float, float]
    end: tuple[float, float]
    width: float

    @property
    def along_x(self) -> bool:
        return abs(self.end[0] - self.start[0]) > abs(self.end[1] - self.start[1])


class SyntheticCamera:
    """Renders images of wires of known temperature; the same seed gives the same images."""

    def __init__(self, width: int, height: int, wires: Sequence[SyntheticWire],
                 surface: Surface = Surface(1.0, 296.15),  # noqa: B008 (frozen)
                 background: float = 296.15, unevenness: float = 0.0, blur: float = 0.7,
                 noise: float = 0.08, seed: int = 1) -> None:
        """Image size (pixels), the wires' surface, the apparent `background` (K), `unevenness` (K)
        by which its lower right corner is warmer, `blur` of lens and detector (standard deviation
        in pixels, without a pixel's own square), `noise` of a pixel (K, NETD)."""
        self.shape = (height, width)
        self._wires, self._surface, self._blur = tuple(wires), surface, blur
        y, x = np.mgrid[0:height, 0:width]
        kelvin = background + unevenness * (x / width + y / height) / 2.0
        self._scene = raw_from_kelvin(kelvin).astype(np.float32)
        self._scene_radiance = band_radiance(kelvin)
        self._random = np.random.default_rng(seed)
        drawn = self._random.standard_normal(_NOISE_PICTURES * width * height, np.float32)
        self._noise = drawn * np.float32(noise * 10.0)

    @classmethod
    def of(cls, parameters: Parameters, settings: Mapping[str, Any]) -> "SyntheticCamera":
        """From the parameters of `synthetic_camera`, one wire per channel. InputError: another
        number of wires than of channels, or a wire that is not four numbers."""
        width, height = settings["image_width"], settings["image_height"]
        channels, texts = parameters["bench.channels"], settings["wires"]
        if not any(texts):  # side by side across the whole image
            rows = [height * (k + 0.5) / len(channels) for k in range(len(channels))]
            left, right = _MARGIN * width, (1.0 - _MARGIN) * width
            texts = [f"{left!r} {row!r} {right!r} {row!r}" for row in rows]
        if len(texts) != len(channels):
            raise InputError(f"wires has {len(texts)} entries, expected one for each of {channels}")
        wires, thickness = [], parameters["wire.diameter"] / settings["pixel_size"]
        for text in texts:
            try:
                x0, y0, x1, y1 = (float(word) for word in text.split())
            except ValueError:
                raise InputError(f"wires: {text!r}, expected 'X0 Y0 X1 Y1' in pixels") from None
            if (x0, y0) == (x1, y1):
                raise InputError(f"wires: {text!r} has no length")
            wires.append(SyntheticWire((x0, y0), (x1, y1), thickness))
        return cls(width, height, wires, Surface.of(parameters, settings),
                   settings["background"] or parameters["environment.ambient_temperature"],
                   **{name: settings[name] for name in ("unevenness", "blur", "noise", "seed")})

    def picture(self, kelvin: Sequence[float], sideways: float | Sequence[float] = 0.0) -> Frame:
        """A frame (height, width) of wires at these temperatures (K), with free ends moved by
        `sideways` pixels (all or each), as constant curvature. InputError: not one K per wire."""
        if len(kelvin) != len(self._wires):
            raise InputError(f"synthetic camera: {len(kelvin)} temperatures for "
                             f"{len(self._wires)} wires")
        moved = np.broadcast_to(np.asarray(sideways, float), (len(self._wires),))
        raw = self._noisy(self._scene)
        for wire, temperature, shift in zip(self._wires, kelvin, moved, strict=True):
            self._draw(raw, wire, float(self._surface.apparent(temperature)), float(shift))
        return _rounded(raw)

    def empty(self) -> Frame:
        return _rounded(self._noisy(self._scene))

    def shutter(self, kelvin: float = 303.15) -> Frame:
        """The closed flag: a uniform surface."""
        return _rounded(self._noisy(np.float32(raw_from_kelvin(kelvin))))

    def _noisy(self, raw: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
        size = self.shape[0] * self.shape[1]
        begin = int(self._random.integers(0, self._noise.size - size + 1))
        return raw + self._noise[begin : begin + size].reshape(self.shape)

    def _draw(self, raw: NDArray[np.float32], wire: SyntheticWire, surface: float,
              shift: float) -> None:
        """Add the change that the wire makes to the pixel values of the scene."""
        turned = wire.along_x
        scene, bare, target = (a.T if turned else a
                               for a in (self._scene_radiance, self._scene, raw))
        # Lines that it crosses, its centre in each, and its width along a line over its true width.
        (first, begin), (last, end) = (p if turned else p[::-1] for p in (wire.start, wire.end))
        low, high = math.ceil(min(first, last)), math.floor(max(first, last))
        line = np.arange(max(low, 0), min(high, len(scene) - 1) + 1)
        position = (line - first) / (last - first)
        centre = begin + (end - begin) * position + shift * position**2
        tilt = np.hypot(1.0, (end - begin + 2.0 * shift * position) / (last - first))
        # The pixels near it see a share of it, and the scene behind it.
        reach = math.ceil((wire.width / 2 + _BLURRED_AWAY * self._blur + 1) * tilt.max(initial=1.0))
        columns = np.rint(centre).astype(int)[:, np.newaxis] + np.arange(-reach, reach + 1)
        inside = (columns >= 0) & (columns < scene.shape[1])
        columns = columns.clip(0, scene.shape[1] - 1)
        distance = (columns - centre[:, np.newaxis]) / tilt[:, np.newaxis]
        share = pixel_share(distance, wire.width, self._blur)
        near = line[:, np.newaxis], columns
        seen = raw_from_kelvin(temperature_of(scene[near] + share * (surface - scene[near])))
        target[near] += np.where(inside, seen - bare[near], 0.0).astype(np.float32)


def pixel_share(distance: Array, width: float, blur: float) -> Array:
    """Share of a pixel's view filled by a wire whose middle is `distance` pixels away: a slit (the
    wire), a square (the pixel) and a Gaussian of standard deviation `blur`, convolved."""
    half = np.array([1.0 + width, 1.0 - width, width - 1.0, -1.0 - width]) / 2.0
    edges = distance + half.reshape(4, *(1,) * np.ndim(distance))
    if blur == 0.0:
        ramps = np.maximum(edges, 0.0)
    else:  # max(u, 0), smeared
        z = edges / blur
        ramps = edges * ndtr(z) + blur * np.exp(-z * z / 2.0) / math.sqrt(2.0 * math.pi)
    return ramps[0] - ramps[1] - ramps[2] + ramps[3]


def _rounded(raw: NDArray[np.float32]) -> Frame:
    return np.clip(np.rint(raw), 0, 2**16 - 1).astype(np.uint16)


def regions_side_by_side(channels: int, width: int, height: int) -> list[str]:
    """Regions for wires side by side across the whole image, as `SyntheticCamera` draws them."""
    strip = height // channels
    return [f"0 {k * strip} {width} {strip} x" for k in range(channels)]

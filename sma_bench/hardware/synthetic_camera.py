"""Pictures of wires as an infrared camera would take them: synthetic, with known truth. No ROS.

    camera = SyntheticCamera(382, 288, [SyntheticWire(start=(40, 90), end=(340, 100), width=0.8)])
    frame = camera.picture([350.0])       # K, one a wire; uint16 (288, 382)
    frame = camera.picture([350.0], sideways=3.5)   # the wires' far ends moved by 3.5 pixels
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sma_bench.errors import InputError
from sma_bench.hardware.thermal_image import (
    Frame,
    Surface,
    band_radiance,
    raw_from_kelvin,
    temperature_of,
)

Array = NDArray[np.float64]

_NOISE_PICTURES = 8
_HIGHEST_RAW = 2**16 - 1
# Pixels from the middle of a wire to where its blur has ended, in standard deviations.
_BLURRED_AWAY = 5.0


@dataclass(frozen=True)
class SyntheticWire:
    """A straight wire in the picture, until it bends.

    Attributes:
        start, end: (x, y) in pixels, of the clamped end and of the one that moves.
        width: in pixels.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    width: float

    @property
    def along_x(self) -> bool:
        """Whether it runs along the rows of the picture."""
        return abs(self.end[0] - self.start[0]) > abs(self.end[1] - self.start[1])


class SyntheticCamera:
    """Takes pictures; the same seed takes the same ones."""

    def __init__(
        self,
        width: int,
        height: int,
        wires: Sequence[SyntheticWire],
        surface: Surface = Surface(1.0, 296.15),  # noqa: B008 (frozen)
        background: float = 296.15,
        unevenness: float = 0.0,
        blur: float = 0.7,
        noise: float = 0.08,
        seed: int = 1,
    ) -> None:
        """A scene with everything but the wires' temperatures.

        Args:
            width, height: pixels of the picture.
            surface: of all wires.
            background: K, apparent; `unevenness` K is how much warmer its lower right corner is.
            blur: standard deviation in pixels of lens and detector; a pixel's own square adds.
            noise: K, standard deviation of every pixel (the data sheets' NETD).
        """
        self.shape = (height, width)
        self._wires = tuple(wires)
        self._surface = surface
        self._blur = blur
        y, x = np.mgrid[0:height, 0:width]
        corner = (x / width + y / height) / 2.0
        kelvin = background + unevenness * corner
        self._scene = raw_from_kelvin(kelvin).astype(np.float32)
        self._scene_radiance = band_radiance(kelvin)
        self._random = np.random.default_rng(seed)
        drawn = self._random.standard_normal(_NOISE_PICTURES * width * height, np.float32)
        self._noise = drawn * np.float32(noise * 10.0)

    def picture(
        self, kelvin: Sequence[float], sideways: float | Sequence[float] = 0.0
    ) -> Frame:
        """A frame (height, width) of wires at these temperatures in K, one a wire.

        `sideways` pixels, one for all or one a wire: how far the end has moved across the wire,
        toward larger x or y; the wire between bends as a beam of constant curvature.

        Raises:
            InputError: not one temperature a wire.
        """
        if len(kelvin) != len(self._wires):
            raise InputError(
                f"synthetic camera: {len(kelvin)} temperatures for {len(self._wires)} wires"
            )
        moved = np.broadcast_to(np.asarray(sideways, float), (len(self._wires),))
        raw = self._scene + self._noise_picture()
        for wire, temperature, shift in zip(self._wires, kelvin, moved, strict=True):
            self._draw(raw, wire, float(self._surface.apparent(temperature)), float(shift))
        return _rounded(raw)

    def empty(self) -> Frame:
        """A frame without the wires."""
        return _rounded(self._scene + self._noise_picture())

    def shutter(self, kelvin: float = 303.15) -> Frame:
        """The closed flag: a uniform surface."""
        return _rounded(np.float32(raw_from_kelvin(kelvin)) + self._noise_picture())

    def _noise_picture(self) -> NDArray[np.float32]:
        size = self.shape[0] * self.shape[1]
        begin = int(self._random.integers(0, self._noise.size - size + 1))
        return self._noise[begin : begin + size].reshape(self.shape)

    def _draw(
        self, raw: NDArray[np.float32], wire: SyntheticWire, surface: float, shift: float
    ) -> None:
        """Add the wire's part to pixel values: what it changes in the scene without it."""
        scene = self._scene_radiance.T if wire.along_x else self._scene_radiance
        bare = self._scene.T if wire.along_x else self._scene
        target = raw.T if wire.along_x else raw
        line, centre, tilt = _way(wire, shift, scene.shape[0])
        reach = math.ceil((wire.width / 2 + _BLURRED_AWAY * self._blur + 1) * tilt.max(initial=1.0))
        columns = np.rint(centre).astype(int)[:, np.newaxis] + np.arange(-reach, reach + 1)
        inside = (columns >= 0) & (columns < scene.shape[1])
        columns = columns.clip(0, scene.shape[1] - 1)
        share = pixel_share(
            (columns - centre[:, np.newaxis]) / tilt[:, np.newaxis], wire.width, self._blur
        )
        behind = scene[line[:, np.newaxis], columns]
        seen = temperature_of(behind + share * (surface - behind))
        change = raw_from_kelvin(seen) - bare[line[:, np.newaxis], columns]
        target[line[:, np.newaxis], columns] += np.where(inside, change, 0.0).astype(np.float32)


def _rounded(raw: NDArray[np.float32]) -> Frame:
    return np.clip(np.rint(raw), 0, _HIGHEST_RAW).astype(np.uint16)


def _way(wire: SyntheticWire, shift: float, lines: int) -> tuple[NDArray[np.intp], Array, Array]:
    """Lines that the wire crosses, where it does, and its width along a line over that across."""
    along = 0 if wire.along_x else 1
    begin, end = wire.start[along], wire.end[along]
    low, high = math.ceil(min(begin, end)), math.floor(max(begin, end))
    line = np.arange(max(low, 0), min(high, lines - 1) + 1)
    position = (line - begin) / (end - begin)
    rise = wire.end[1 - along] - wire.start[1 - along]
    centre = wire.start[1 - along] + rise * position + shift * position**2
    slope = (rise + 2.0 * shift * position) / (end - begin)
    return line, centre, np.hypot(1.0, slope)


def pixel_share(distance: Array, width: float, blur: float) -> Array:
    """Share of a pixel's view that a wire fills, its middle `distance` pixels away.

    The wire's slit, the pixel's square and a Gaussian of standard deviation `blur`, convolved.
    """
    outer, inner = (1.0 + width) / 2.0, (1.0 - width) / 2.0
    return (
        _ramp(distance + outer, blur) - _ramp(distance + inner, blur)
        - _ramp(distance - inner, blur) + _ramp(distance - outer, blur)
    )


def _ramp(u: Array, blur: float) -> Array:
    """max(u, 0), smeared by a Gaussian."""
    if blur == 0.0:
        return np.maximum(u, 0.0)
    z = u / blur
    return u * ndtr(z) + blur * np.exp(-z * z / 2.0) / math.sqrt(2.0 * math.pi)

"""A camera and its wires as the nodes' parameters describe them, and one wire frame after frame. No
ROS.

A wire as warm as its background cannot be seen, and at rest it is just that. Where `cold` wires are
to be read, an unseen one is read as its background, give or take what could just be seen: but not
when it was clear to see in the frame before (it left its region), and not when its heating should
show.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from sma_bench.errors import InputError
from sma_bench.hardware.expectation import WireModel
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import (
    Frame,
    FrameFormat,
    FrameJudge,
    Surface,
    band_radiance,
    slope_at,
)
from sma_bench.hardware.thermal_wire import (
    CLEAR,
    STATISTICS,
    Optics,
    Region,
    WireReading,
    read_wire,
)
from sma_bench.parameters import Parameters

# A wire this many times clearer than the least visible one does not fade within this time [s].
_TOO_CLEAR_TO_FADE = 4.0
_NO_TIME_TO_FADE = 0.1
# Share of the modelled temperature rise that is believed: parameters may be off by a factor.
_BELIEVED = 0.3


class ExpectedWarmth:
    """Temperature that a wire should have from its voltage, by eq. (2)."""

    def __init__(self, parameters: Parameters) -> None:
        """Starts at the ambient temperature."""
        self._model = WireModel.from_parameters(parameters)
        self._kelvin = self._model.ambient
        self._volts = 0.0
        self._time = math.nan

    def voltage(self, volts: float, time: float) -> None:
        """The wire has `volts` V from `time` s on; not a number is passed over."""
        if not math.isfinite(volts):
            return
        self._advance(time)
        self._volts = volts

    def kelvin(self, time: float) -> float:
        """Temperature in K at `time` s that can be relied upon: a share of the model's rise."""
        self._advance(time)
        ambient = self._model.ambient
        return ambient + _BELIEVED * (self._kelvin - ambient)

    def _advance(self, time: float) -> None:
        elapsed = time - self._time
        if elapsed > 0.0:
            self._kelvin = self._model.warmed(self._kelvin, self._volts, elapsed)
        self._time = time


class WireGauge:
    """Reads one wire in frame after frame."""

    def __init__(
        self, region: Region, optics: Optics, surface: Surface, cold: bool = False
    ) -> None:
        """`cold` wires, not warmer than their background, are read as well."""
        self.region = region
        self._optics = optics
        self._surface = surface
        self._cold = cold
        self.reset()

    def reset(self) -> None:
        """Forget where the wire was, and that it was lost."""
        self._seen = -math.inf
        self._clearness = 0.0
        self._lost = False

    def read(self, frame: Frame, time: float, expected: float = 0.0) -> WireReading:
        """The wire in a frame taken at `time` s, when it should have `expected` K or more."""
        reading = read_wire(frame, self.region, self._optics, self._surface, self._cold)
        if reading.seen:
            self._seen, self._clearness, self._lost = time, reading.clearness, False
        elif time - self._seen <= _NO_TIME_TO_FADE:
            self._lost |= self._clearness > _TOO_CLEAR_TO_FADE * CLEAR
        held_for_itself = bool(reading.seen and reading.reason) or math.isnan(reading.background)
        if not self._cold or held_for_itself or reading.kelvin > reading.background:
            return reading
        if expected > reading.background + reading.limit:
            celsius = expected - CELSIUS_ZERO
            return WireReading(
                reason=f"wire not seen where its voltage makes it {celsius:.1f} degC or more"
            )
        if reading.seen:
            return reading
        if self._lost:
            return WireReading(reason="wire lost while clear to see: it left its region")
        slope = slope_at(reading.background)
        deviation = math.hypot(reading.limit / 2.0, self._optics.accuracy) * slope
        apparent = float(band_radiance(reading.background))
        kelvin, std = self._surface.temperature(apparent, deviation)
        return WireReading(
            kelvin=kelvin, std=std, background=reading.background, limit=reading.limit,
            reason="less radiance than the reflected one alone" if math.isnan(kelvin) else "",
        )


Settings = Mapping[str, Any]

# A wire across the whole picture ends this far from its border, as a share of its size.
_MARGIN = 0.05


def frame_format(settings: Settings) -> FrameFormat:
    """What pictures must be."""
    return FrameFormat(settings["image_width"], settings["image_height"])


def frame_judge(settings: Settings) -> FrameJudge:
    """The judge with the node's limits."""
    names = ("stale_limit", "shutter_spread", "shutter_settle")
    return FrameJudge(*(settings[name] for name in names))


def wire_gauges(parameters: Parameters, settings: Settings) -> list[WireGauge]:
    """One gauge a channel, from the parameters of `ir_camera`.

    Raises:
        InputError: regions that do not fit channels or picture, an unknown statistic, a range of
            the camera that ends before it begins.
    """
    channels = parameters["bench.channels"]
    optics, surface = _optics(parameters, settings), _surface(parameters, settings)
    width, height = settings["image_width"], settings["image_height"]
    return [
        WireGauge(
            Region.parse(text, width, height, f"regions: {channel}"),
            optics, surface, settings["read_cold_wires"],
        )
        for channel, text in zip(
            channels, _one_a_channel("regions", settings["regions"], channels), strict=True
        )
    ]


def synthetic_camera(parameters: Parameters, settings: Settings) -> SyntheticCamera:
    """The camera of `synthetic_camera`'s parameters, a wire a channel.

    Raises:
        InputError: wires that do not fit the channels, or that are not four numbers each.
    """
    width, height = settings["image_width"], settings["image_height"]
    thickness = parameters["wire.diameter"] / settings["pixel_size"]
    ambient = parameters["environment.ambient_temperature"]
    return SyntheticCamera(
        width, height,
        [
            SyntheticWire(start, end, thickness)
            for start, end in _wire_ends(parameters["bench.channels"], settings)
        ],
        surface=_surface(parameters, settings),
        background=settings["background"] or ambient,
        unevenness=settings["unevenness"],
        blur=settings["blur"],
        noise=settings["noise"],
        seed=settings["seed"],
    )


def regions_side_by_side(channels: int, width: int, height: int) -> list[str]:
    """Regions for wires side by side across the whole picture, as `synthetic_camera` draws them."""
    strip = height // channels
    return [f"0 {k * strip} {width} {strip} x" for k in range(channels)]


def _optics(parameters: Parameters, settings: Settings) -> Optics:
    if settings["statistic"] not in STATISTICS:
        raise InputError(
            f"statistic: {settings['statistic']!r}, expected {', '.join(STATISTICS)}"
        )
    if settings["camera_lowest"] >= settings["camera_highest"]:
        raise InputError(
            f"camera_lowest {settings['camera_lowest']:g} K must lie below camera_highest "
            f"{settings['camera_highest']:g} K"
        )
    diameter, pixel = parameters["wire.diameter"], settings["pixel_size"]
    relative = (parameters.std("wire.diameter") / diameter, settings["pixel_size_std"] / pixel)
    return Optics(
        width=diameter / pixel,
        width_std=(relative[0] ** 2 + relative[1] ** 2) ** 0.5,
        lowest=settings["camera_lowest"],
        highest=settings["camera_highest"],
        accuracy=settings["camera_accuracy"],
        correct_fill=settings["correct_fill"],
        statistic=settings["statistic"],
        least_visible=settings["least_visible"],
    )


def _surface(parameters: Parameters, settings: Settings) -> Surface:
    ambient = parameters["environment.ambient_temperature"]
    return Surface(
        settings["emissivity"],
        settings["reflected_temperature"] or ambient,
        settings.get("emissivity_std", 0.0),
        settings.get("reflected_temperature_std", 0.0),
    )


def _wire_ends(
    channels: Sequence[str], settings: Settings
) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    width, height = settings["image_width"], settings["image_height"]
    if not any(settings["wires"]):
        rows = [height * (k + 0.5) / len(channels) for k in range(len(channels))]
        return [((_MARGIN * width, row), ((1.0 - _MARGIN) * width, row)) for row in rows]
    ends = []
    for text in _one_a_channel("wires", settings["wires"], channels):
        try:
            x0, y0, x1, y1 = (float(word) for word in text.split())
        except ValueError:
            raise InputError(f"wires: {text!r}, expected 'X0 Y0 X1 Y1' in pixels") from None
        if (x0, y0) == (x1, y1):
            raise InputError(f"wires: {text!r} has no length")
        ends.append(((x0, y0), (x1, y1)))
    return ends


def _one_a_channel(name: str, texts: Sequence[str], channels: Sequence[str]) -> Sequence[str]:
    if len(texts) != len(channels):
        raise InputError(f"{name} has {len(texts)} entries, expected one for each of {channels}")
    return texts

"""A camera and its wires as the nodes' parameters describe them. No ROS."""

from collections.abc import Mapping, Sequence
from typing import Any

from sma_bench.errors import InputError
from sma_bench.hardware.synthetic_camera import SyntheticCamera, SyntheticWire
from sma_bench.hardware.thermal_image import FrameFormat, FrameJudge, Surface
from sma_bench.hardware.thermal_wire import STATISTICS, Optics, Region
from sma_bench.hardware.wire_gauge import WireGauge
from sma_bench.parameters import Parameters

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

"""Protocol and reference files: YAML in, a checked Protocol out, every mistake in one line."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml, shown
from sma_bench.errors import InputError, did_you_mean
from sma_bench.installation import share_directory
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import LOAD_KINDS
from sma_bench.protocols.protocol import Protocol, Segment, Until

# --- The kinds of step a protocol is written with, each expanded into straight segments.
#
# A kind is a row of KINDS: the numbers it needs and the function that makes (label, duration,
# start level, stop level) lines of them. Levels are volts of the driven channels, or what else a
# protocol is about: a Scale says in which unit, and which level is rest.

Line = tuple[str, float, float, float]
Numbers = Mapping[str, float]

MAXIMUM_LEVELS = 10_000


@dataclass(frozen=True)
class Scale:
    """Unit of the levels, and the level of rest."""

    unit: str
    rest: float


@dataclass(frozen=True)
class StepKind:
    """Numbers of a kind of step, levels and seconds apart, and what it expands to."""

    levels: tuple[str, ...]
    seconds: tuple[str, ...]
    lines: Callable[[Numbers, Scale], list[Line]]
    drives: bool = True
    waits: bool = True


def _staircase(n: Numbers, scale: Scale) -> list[Line]:
    """From start to stop in equal increments, each level held for dwell."""
    span = n["stop"] - n["start"]
    if n["increment"] == 0.0:
        raise InputError(f"increment is 0 {scale.unit}, expected more")
    count = abs(span) / n["increment"]
    if count > MAXIMUM_LEVELS:
        raise InputError(f"{count:.3g} levels, expected at most {MAXIMUM_LEVELS}")
    if abs(count - round(count)) > 1e-6:
        raise InputError(
            f"increment {n['increment']:g} {scale.unit} does not divide "
            f"{n['start']:g} to {n['stop']:g} {scale.unit}"
        )
    steps = round(count)
    levels = [n["start"] + span * k / max(steps, 1) for k in range(steps + 1)]
    return [(f"{level:g} {scale.unit}", n["dwell"], level, level) for level in levels]


def _hold(n: Numbers, _: Scale) -> list[Line]:
    return [("", n["duration"], n["level"], n["level"])]


KINDS: dict[str, StepKind] = {
    "staircase": StepKind(("start", "stop", "increment"), ("dwell",), _staircase),
    "ramp": StepKind(
        ("start", "stop"), ("duration",),
        lambda n, _: [("", n["duration"], n["start"], n["stop"])],
    ),
    "triangle": StepKind(
        ("peak",), ("rise", "fall"),
        lambda n, scale: [
            ("rise", n["rise"], scale.rest, n["peak"]), ("fall", n["fall"], n["peak"], scale.rest),
        ],
        waits=False,
    ),
    "step": StepKind(("level",), ("duration",), _hold),
    "hold": StepKind(("level",), ("duration",), _hold),
    "rest": StepKind(
        (), ("duration",),
        lambda n, scale: [("", n["duration"], scale.rest, scale.rest)],
        drives=False,
    ),
}


# --- Protocol files.
#
#     name: triangle            # optional, else the file's name
#     description: ...          # optional
#     repeat: 2                 # optional, of the whole
#     load: force               # optional: what a bench without load.kind holds meanwhile
#     steps:
#       - {kind: triangle, name: heat, drive: front, peak: 6.0, rise: 30.0, fall: 30.0}
#       - {kind: rest, duration: 60.0}
#
# `drive` is front, back, all (default) or a list of channels; what is not driven is at 0 V.
# `until` ends a step, or every level of a staircase, before its time: settled, or
#
#       until: {temperature_above: 330.0, deflection_below: -0.01, settled: temperature, over: 5.0}
#
# `force` is the N that the frame of a protocol with `load: force` has come to, evenly, by the end
# of a step; `simulate` pulls so, at a real frame it is the frame's own program.

SUFFIX = ".yaml"
PROTOCOL_KEYS = ("name", "description", "repeat", "steps")
STEP_KEYS = ("kind", "name", "drive", "repeat", "until", "force")
_LARGEST_FORCE = 1e4  # N
_THRESHOLDS = {
    f"{quantity}_{side}": (quantity, side, unit)
    for quantity, unit in (("temperature", "K"), ("deflection", "m"))
    for side in ("above", "below")
}
MAXIMUM_REPEAT = 10_000
MAXIMUM_SEGMENTS = 100_000
MAXIMUM_SECONDS = 7 * 24 * 3600.0


@dataclass(frozen=True)
class Quantity:
    """What the levels of a file are.

    Attributes:
        what: how error lines call such a file; folder: below config, where named ones lie.
        unit: of the levels; keys: of the document.
        targets: names that a step may drive, and the side of each.
        rest: level of what is not driven.
        require: InputError for a level (key, value, parameters, where) that is out of bounds.
    """

    what: str
    folder: str
    unit: str
    keys: tuple[str, ...]
    targets: Callable[[Parameters], tuple[tuple[str, ...], tuple[str, ...]]]
    rest: Callable[[Parameters], float]
    require: Callable[[str, float, Parameters, str], None] = lambda *_: None


def protocol_names() -> list[str]:
    """Names of the protocols that come with the package."""
    return shipped_names(VOLTAGE)


def shipped_names(quantity: Quantity) -> list[str]:
    """Names of the files of a quantity that come with the package."""
    return sorted(path.stem for path in _folder(quantity).glob(f"*{SUFFIX}"))


def load_protocol(name_or_path: str | Path, parameters: Parameters) -> Protocol:
    """Read a protocol by its name (in the share folder's config/protocols) or by its path.

    Args:
        name_or_path: `staircase` or `some/folder/mine.yaml`.
        parameters: channels, sides and limits of the bench.

    Raises:
        InputError: no such file, not YAML, or a step that is wrong or above the bench's limits;
            the line names file and step.
    """
    path = locate(name_or_path, VOLTAGE)
    return parse_protocol(read_yaml(path), parameters, where=str(path), name=path.stem)


def parse_protocol(
    document: Any, parameters: Parameters, where: str = "protocol", name: str = "protocol"
) -> Protocol:
    """A Protocol from the plain mapping of a protocol file.

    Args:
        document: what the YAML file holds.
        parameters: channels, sides and limits of the bench.
        where: leads every error line.
        name: of the protocol where the document has none.

    Raises:
        InputError: as load_protocol.
    """
    return parse_levels(document, parameters, VOLTAGE, where, name)


def parse_levels(
    document: Any, parameters: Parameters, quantity: Quantity, where: str = "", name: str = ""
) -> Protocol:
    """A Protocol whose levels are those of a quantity; arguments as for parse_protocol."""
    where = where or quantity.what
    with_unit = isinstance(document, dict) and "unit" in quantity.keys
    if with_unit and document.get("unit") != quantity.unit:
        raise InputError(f"{where}: unit is {document.get('unit')!r}, expected {quantity.unit}")
    _require_keys(document, quantity.keys, ("steps",), where)
    steps, times = document["steps"], _repeat(document, where)
    if not isinstance(steps, list) or not steps:
        raise InputError(f"{where}: steps: expected a list of one step or more")
    once: list[Segment] = []
    for number, step in enumerate(steps, 1):
        once += _segments(step, number, parameters, quantity, where)
        _require_count(len(once), where)
    _require_count(len(once) * times, where)
    seconds = sum(segment.duration for segment in once) * times
    if seconds > MAXIMUM_SECONDS:
        raise InputError(f"{where}: lasts {seconds:g} s, expected at most {MAXIMUM_SECONDS:g} s")
    load = _text(document, "load", where)
    if load and load not in LOAD_KINDS:
        raise InputError(f"{where}: load is {load!r}, expected {', '.join(LOAD_KINDS)}")
    protocol = Protocol(
        name=_text(document, "name", where) or name or quantity.what,
        channels=quantity.targets(parameters)[0],
        segments=tuple(_numbered(once, times)),
        description=_text(document, "description", where),
        load=load,
        rest=quantity.rest(parameters),
    )
    if protocol.pulls and (protocol.load != "force" or protocol.waits):
        raise InputError(
            f"{where}: a step has a force, expected load: force beside the steps, and no until"
        )
    return protocol


def _folder(quantity: Quantity) -> Path:
    return share_directory() / "config" / quantity.folder


def is_path(name_or_path: str) -> bool:
    """Whether a text is the path of a file rather than the name of one of the package's."""
    path = Path(name_or_path)
    return path.suffix in (SUFFIX, ".yml") or path.parent != Path(".")


def locate(name_or_path: str | Path, quantity: Quantity) -> Path:
    """Path of a file given by its name or path; InputError when there is no such name."""
    text = str(name_or_path)
    shipped = shipped_names(quantity)
    names = ", ".join(shipped)
    if not text:
        raise InputError(f"{quantity.what}: no name given, there are {names}")
    if is_path(text):
        return Path(text)
    path = _folder(quantity) / f"{text}{SUFFIX}"
    if not path.is_file():
        hint = did_you_mean(text, shipped)
        if " " in text:
            hint = "; steps in words are not taken, a file has them: docs/how_to/own_protocol.md"
        raise InputError(
            f"{quantity.what} {shown(text)}: not one of {names} nor a {SUFFIX} file{hint}"
        )
    return path


def _segments(
    step: Any, number: int, parameters: Parameters, quantity: Quantity, where: str
) -> list[Segment]:
    """The straight segments of one step."""
    where = f"{where}: step {number}"
    if not isinstance(step, dict):
        raise InputError(f"{where}: is {step!r}, expected a mapping with a kind")
    name = _text(step, "name", where) or str(step.get("kind"))
    where = f"{where} ({shown(name)})"

    # Its kind, and the numbers that such a step has.
    if not isinstance(step.get("kind"), str) or step["kind"] not in KINDS:
        raise InputError(
            f"{where}: kind is {step.get('kind')!r}, expected one of {', '.join(KINDS)}"
        )
    kind = KINDS[step["kind"]]
    required = (*kind.levels, *kind.seconds)
    _require_keys(step, (*STEP_KEYS, *required), required, where)
    if not kind.drives and "drive" in step:
        raise InputError(f"{where}: drive: a {step['kind']} drives nothing")
    numbers = {key: _number(step, key, quantity.unit, where) for key in kind.levels}
    numbers |= {key: _number(step, key, "s", where) for key in kind.seconds}
    for key in kind.seconds:
        if numbers[key] <= 0.0:
            raise InputError(f"{where}: {key} is {numbers[key]:g} s, expected more than 0")
    for key in kind.levels:
        quantity.require(key, numbers[key], parameters, where)

    # Its lines, of the channels that it drives.
    scale = Scale(quantity.unit, quantity.rest(parameters))
    try:
        lines = kind.lines(numbers, scale)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    times = _repeat(step, where)
    _require_count(len(lines) * times, where)
    driven = _driven(step, kind, quantity.targets(parameters), where)
    until = _until(step["until"], kind, parameters, where) if "until" in step else None
    segments = [
        Segment(
            step=f"{name} {label}".strip(),
            duration=duration,
            start=tuple(start if on else scale.rest for on in driven),
            stop=tuple(stop if on else scale.rest for on in driven),
            until=until,
        )
        for label, duration, start, stop in lines
    ]
    if "force" in step:
        force = _number(step, "force", "N", where)
        if not 0.0 <= force <= _LARGEST_FORCE or len(segments) > 1:
            raise InputError(
                f"{where}: force is {force:g} N, expected 0 to {_LARGEST_FORCE:g} N in a step of "
                "one line"
            )
        own = segments[0]
        segments = [replace(own, step=f"{own.step} to {force:g} N", force=force)]
    return _numbered(segments, times)


def _until(given: Any, kind: StepKind, parameters: Parameters, where: str) -> Until:
    where = f"{where}: until"
    if not kind.waits:
        raise InputError(f"{where}: a triangle ends with its time, write ramps")
    if given == "settled":
        given = {"settled": True}
    _require_keys(given, (*_THRESHOLDS, "settled", "over"), (), where)
    found: dict[str, dict[str, float]] = {"above": {}, "below": {}}
    for key in given:
        if key in _THRESHOLDS:
            quantity, side, unit = _THRESHOLDS[key]
            found[side][quantity] = _number(given, key, unit, where)
    highest = parameters["bench.maximum_temperature"]
    if found["above"].get("temperature", 0.0) >= highest:
        raise InputError(
            f"{where}: temperature_above is {found['above']['temperature']:g} K, expected less "
            f"than bench.maximum_temperature, {highest:g} K, where the bench switches off"
        )
    settled = given.get("settled", False)
    names = {True: ("",), False: (), "temperature": ("temperature",), "deflection": ("deflection",)}
    if not isinstance(settled, bool | str) or settled not in names:
        raise InputError(f"{where}: settled is {settled!r}, expected temperature or deflection")
    over = _number(given, "over", "s", where) if "over" in given else Until.over
    if over <= 0.0:
        raise InputError(f"{where}: over is {over:g} s, expected more than 0")
    if not any((*found.values(), names[settled])):
        raise InputError(f"{where}: says nothing, expected {', '.join(_THRESHOLDS)} or settled")
    return Until(found["above"], found["below"], names[settled], over)


def _numbered(segments: list[Segment], times: int) -> list[Segment]:
    if times == 1:
        return segments
    return [
        replace(s, step=f"{s.step} {k} of {times}")
        for k in range(1, times + 1)
        for s in segments
    ]


def _driven(
    step: dict[str, Any],
    kind: StepKind,
    targets: tuple[tuple[str, ...], tuple[str, ...]],
    where: str,
) -> tuple[bool, ...]:
    channels, sides = targets
    drive = step.get("drive", "all") if kind.drives else []
    if drive == "all":
        return tuple(True for _ in channels)
    if drive in ("front", "back"):
        if drive not in sides:
            raise InputError(
                f"{where}: drive is {drive}, but no channel is on that side: the parameters are of "
                f"a bench of {', '.join(channels)} ({', '.join(dict.fromkeys(sides))})"
            )
        return tuple(side == drive for side in sides)
    if not isinstance(drive, list):
        raise InputError(
            f"{where}: drive is {drive!r}, expected front, back, all or a list of channels"
        )
    for channel in drive:
        if channel not in channels:
            raise InputError(
                f"{where}: drive: channel {channel!r} is not one of {', '.join(channels)}"
            )
    return tuple(channel in drive for channel in channels)


def _require_within_limits(key: str, level: float, parameters: Parameters, where: str) -> None:
    highest = parameters["bench.maximum_voltage"]
    if not 0.0 <= level <= highest:
        raise InputError(f"{where}: {key} is {level:g} V, expected 0 to {highest:g} V")
    current = level / parameters["wire.resistance"]
    if current > parameters["bench.maximum_current"]:
        raise InputError(
            f"{where}: {key} is {level:g} V, which drives {current:.3g} A through "
            f"{parameters['wire.resistance']:g} ohm, expected at most "
            f"{parameters['bench.maximum_current']:g} A"
        )


def bench_channels(parameters: Parameters) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Power channels and the side of each."""
    return tuple(parameters["bench.channels"]), tuple(parameters["bench.channel_sides"])


VOLTAGE = Quantity(
    what="protocol",
    folder="protocols",
    unit="V",
    keys=(*PROTOCOL_KEYS, "load"),
    targets=bench_channels,
    rest=lambda _: 0.0,
    require=_require_within_limits,
)


def _require_keys(
    mapping: Any, allowed: Iterable[str], required: Iterable[str], where: str
) -> None:
    if not isinstance(mapping, dict):
        raise InputError(f"{where}: expected a mapping with {', '.join(allowed)}")
    allowed = list(allowed)
    for key in mapping:
        if key not in allowed:
            hint = did_you_mean(key, allowed) or f", expected {', '.join(allowed)}"
            raise InputError(f"{where}: unknown key {key!r}{hint}")
    missing = [key for key in required if key not in mapping]
    if missing:
        raise InputError(f"{where}: {missing[0]} is missing")


def _require_count(segments: int, where: str) -> None:
    if segments > MAXIMUM_SEGMENTS:
        raise InputError(f"{where}: more than {MAXIMUM_SEGMENTS} segments")


def _number(step: Mapping[str, Any], key: str, unit: str, where: str) -> float:
    value = step[key]
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{where}: {key} is {value!r}, expected a number in {unit}")
    return number


def _repeat(mapping: Mapping[str, Any], where: str) -> int:
    times = mapping.get("repeat", 1)
    if isinstance(times, bool) or not isinstance(times, int) or not 1 <= times <= MAXIMUM_REPEAT:
        raise InputError(f"{where}: repeat is {times!r}, expected 1 to {MAXIMUM_REPEAT}")
    return times


def _text(mapping: Mapping[str, Any], key: str, where: str) -> str:
    value = mapping.get(key, "")
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} is {value!r}, expected a string")
    return value


# --- Reference files: what a controller shall follow, with the same steps as a protocol.
#
#     name: temperature_staircase
#     unit: K                   # K: wire temperatures; m: deflection, positive toward the front
#     steps:
#       - {kind: staircase, name: up, start: 303.15, stop: 328.15, increment: 5.0, dwell: 10.0}
#
# Rest is ambient temperature, or no deflection; a triangle starts and ends there. A file of
# temperatures drives channels, one of deflections the tip, and has no `drive`. How far a bench
# can go is not known here: controllers refuse what it cannot reach.

TIP = "tip"


TEMPERATURE = Quantity(
    what="reference",
    folder="references",
    unit="K",
    keys=("unit", *PROTOCOL_KEYS),
    targets=bench_channels,
    rest=lambda parameters: float(parameters["environment.ambient_temperature"]),
)
DEFLECTION = Quantity(
    what="reference",
    folder="references",
    unit="m",
    keys=("unit", *PROTOCOL_KEYS),
    targets=lambda _: ((TIP,), ()),
    rest=lambda _: 0.0,
)
QUANTITIES = {quantity.unit: quantity for quantity in (TEMPERATURE, DEFLECTION)}


def load_reference(
    name_or_path: str | Path, parameters: Parameters, quantity: Quantity
) -> Protocol:
    """Read a reference by its name (in the share folder's config/references) or by its path.

    Args:
        parameters: channels, sides and ambient temperature of the bench.
        quantity: TEMPERATURE or DEFLECTION, which the file's unit must be.

    Raises:
        InputError: as load_protocol, or another unit.
    """
    path = locate(name_or_path, quantity)
    return parse_levels(read_yaml(path), parameters, quantity, str(path), path.stem)

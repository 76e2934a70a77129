"""Protocol files: YAML in, a checked Protocol out, every mistake in one line.

    name: triangle            # optional, else the file's name
    description: ...          # optional
    repeat: 2                 # optional, of the whole
    load: force               # optional: what a bench without load.kind holds meanwhile
    steps:
      - {kind: triangle, name: heat, drive: front, peak: 6.0, rise: 30.0, fall: 30.0}
      - {kind: rest, duration: 60.0}

`drive` is front, back, all (default) or a list of channels; what is not driven is at 0 V.
"""

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.border import read_yaml
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import LOAD_KINDS
from sma_bench.protocols.protocol import Protocol, Segment
from sma_bench.protocols.steps import KINDS, Line, Scale, StepKind
from sma_bench.share import share_directory

SUFFIX = ".yaml"
PROTOCOL_KEYS = ("name", "description", "repeat", "steps")
STEP_KEYS = ("kind", "name", "drive", "repeat")
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
    require: Callable[[str, float, Parameters, str], None]


def protocol_names() -> list[str]:
    """Names of the protocols that come with the package."""
    return shipped_names(VOLTAGE)


def shipped_names(quantity: Quantity) -> list[str]:
    """Names of the files of a quantity that come with the package."""
    return sorted(path.stem for path in _folder(quantity).glob(f"*{SUFFIX}"))


def load_protocol(name_or_path: str | Path, parameters: Parameters) -> Protocol:
    """Read a protocol by its name (in the share folder's config/protocols) or by its path.

    Args:
        name_or_path: `staircase`, or `some/folder/mine.yaml`.
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
    document: Any, parameters: Parameters, quantity: Quantity, where: str, name: str
) -> Protocol:
    """A Protocol whose levels are those of a quantity; arguments as for parse_protocol."""
    _require_keys(document, quantity.keys, ("steps",), where)
    steps = document["steps"]
    if not isinstance(steps, list) or not steps:
        raise InputError(f"{where}: steps: expected a list of one step or more")
    once: list[Segment] = []
    for number, step in enumerate(steps, 1):
        once += _segments(step, number, parameters, quantity, where)
        _require_count(len(once), where)
    times = _repeat(document, where)
    _require_count(len(once) * times, where)
    _require_length(sum(segment.duration for segment in once) * times, where)
    return Protocol(
        name=_text(document, "name", where) or name,
        channels=quantity.targets(parameters)[0],
        segments=tuple(_numbered(once, times)),
        description=_text(document, "description", where),
        load=_load(document, where),
        rest=quantity.rest(parameters),
    )


def _load(document: Any, where: str) -> str:
    load = _text(document, "load", where)
    if load and load not in LOAD_KINDS:
        raise InputError(f"{where}: load is {load!r}, expected {', '.join(LOAD_KINDS)}")
    return load


def _folder(quantity: Quantity) -> Path:
    return share_directory() / "config" / quantity.folder


def is_path(name_or_path: str) -> bool:
    """Whether a text is the path of a file rather than the name of one of the package's."""
    path = Path(name_or_path)
    return path.suffix in (SUFFIX, ".yml") or path.parent != Path(".")


def locate(name_or_path: str | Path, quantity: Quantity) -> Path:
    """Path of a file given by its name or path; InputError when there is no such name."""
    text = str(name_or_path)
    names = ", ".join(shipped_names(quantity))
    if not text:
        raise InputError(f"{quantity.what}: no name given, there are {names}")
    if is_path(text):
        return Path(text)
    path = _folder(quantity) / f"{text}{SUFFIX}"
    if not path.is_file():
        raise InputError(f"{quantity.what} {text}: not one of {names} nor a {SUFFIX} file")
    return path


def _segments(
    step: Any, number: int, parameters: Parameters, quantity: Quantity, where: str
) -> list[Segment]:
    where = f"{where}: step {number}"
    if not isinstance(step, dict):
        raise InputError(f"{where}: is {step!r}, expected a mapping with a kind")
    name = _text(step, "name", where) or str(step.get("kind"))
    where = f"{where} ({name})"
    kind = _kind(step, where)
    numbers = {key: _number(step, key, quantity.unit, where) for key in kind.levels}
    numbers |= {key: _number(step, key, "s", where) for key in kind.seconds}
    for key in kind.seconds:
        if numbers[key] <= 0.0:
            raise InputError(f"{where}: {key} is {numbers[key]:g} s, expected more than 0")
    for key in kind.levels:
        quantity.require(key, numbers[key], parameters, where)
    scale = Scale(quantity.unit, quantity.rest(parameters))
    try:
        lines = kind.lines(numbers, scale)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    times = _repeat(step, where)
    _require_count(len(lines) * times, where)
    driven = _driven(step, kind, quantity.targets(parameters), where)
    return _numbered([_segment(name, line, driven, scale.rest) for line in lines], times)


def _kind(step: dict[str, Any], where: str) -> StepKind:
    kind = step.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"{where}: kind is {kind!r}, expected one of {', '.join(KINDS)}")
    row = KINDS[kind]
    required = (*row.levels, *row.seconds)
    _require_keys(step, (*STEP_KEYS, *required), required, where)
    if not row.drives and "drive" in step:
        raise InputError(f"{where}: drive: a {kind} drives nothing")
    return row


def _segment(name: str, line: Line, driven: tuple[bool, ...], rest: float) -> Segment:
    label, duration, start, stop = line
    return Segment(
        step=f"{name} {label}".strip(),
        duration=duration,
        start=tuple(start if on else rest for on in driven),
        stop=tuple(stop if on else rest for on in driven),
    )


def _numbered(segments: list[Segment], times: int) -> list[Segment]:
    if times == 1:
        return segments
    return [
        Segment(f"{s.step} {k} of {times}", s.duration, s.start, s.stop)
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
            raise InputError(f"{where}: drive is {drive}, but no channel is on that side")
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
            close = difflib.get_close_matches(str(key), allowed, n=1)
            hint = f"did you mean {close[0]}?" if close else f"expected {', '.join(allowed)}"
            raise InputError(f"{where}: unknown key {key!r}, {hint}")
    missing = [key for key in required if key not in mapping]
    if missing:
        raise InputError(f"{where}: {missing[0]} is missing")


def _require_count(segments: int, where: str) -> None:
    if segments > MAXIMUM_SEGMENTS:
        raise InputError(f"{where}: more than {MAXIMUM_SEGMENTS} segments")


def _require_length(seconds: float, where: str) -> None:
    if seconds > MAXIMUM_SECONDS:
        raise InputError(f"{where}: lasts {seconds:g} s, expected at most {MAXIMUM_SECONDS:g} s")


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

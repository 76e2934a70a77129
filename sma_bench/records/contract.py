"""The topics of the bench contract: the name and message type of each, and its signals."""

from collections.abc import Mapping
from typing import NamedTuple

from sma_bench.errors import InputError
from sma_bench.findings import Finding

BATTERY_STATE, TEMPERATURE = "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Temperature"
RANGE, JOINT_STATE = "sensor_msgs/msg/Range", "sensor_msgs/msg/JointState"
IMAGE, MULTI_ARRAY = "sensor_msgs/msg/Image", "std_msgs/msg/Float64MultiArray"
STRING = "std_msgs/msg/String"
HEADERLESS = frozenset({MULTI_ARRAY, STRING})
# Last parts of a topic's name (* is any channel), and its message type.
CONTRACT: tuple[tuple[tuple[str, ...], str], ...] = (
    (("voltage_command",), MULTI_ARRAY), (("joint_states",), JOINT_STATE),
    (("*", "power"), BATTERY_STATE), (("*", "temperature"), TEMPERATURE),
    (("front", "range"), RANGE), (("back", "range"), RANGE),
    (("thermal_image",), IMAGE), (("experiment", "marker"), STRING))
CELSIUS_ZERO = 273.15
# SI units of signals, by the last part of their names.
_UNITS = {"voltage": "V", "current": "A", "temperature": "K", "range": "m", "deflection": "m",
          "elongation": "m", "force": "N", "voltage_command": "V"}
# By joint: its signals and the field of joint_states that carries each.
JOINT_SIGNALS: dict[str, dict[str, str]] = {"tip": {"deflection": "position"},
                                            "wire": {"elongation": "position", "force": "effort"}}
JOINT_OF = {signal: joint for joint, signals in JOINT_SIGNALS.items() for signal in signals}
_TOPICS = {"voltage": "power", "current": "power", "temperature": "temperature", "range": "range"}


class Place(NamedTuple):
    """What a topic's name means by the contract: `wire/power` in `/lab/rig`, for example."""

    meaning: str
    namespace: str
    type: str


def place_of(topic: str) -> Place | None:
    """The meaning of a topic by its name; None for topics outside the contract."""
    parts = [part for part in topic.split("/") if part]
    for suffix, msgtype in CONTRACT:
        above, tail = parts[: -len(suffix)], parts[-len(suffix) :]
        is_whole, pairs = len(tail) == len(suffix), zip(suffix, tail, strict=False)
        if is_whole and all(wanted in ("*", part) for wanted, part in pairs):
            # Topics below `twin` are predictions: neither recorded nor read.
            is_measured = "twin" not in above
            return Place("/".join(tail), "/" + "/".join(above), msgtype) if is_measured else None
    return None


def topic_of(signal: str) -> tuple[str, str] | None:
    """Topic and column that carry a signal (`wire.voltage`); None for other names."""
    channel, _, field = signal.rpartition(".")
    topic = f"{channel}/{_TOPICS.get(field, '')}"
    if channel and (place := place_of(topic)) and place.meaning == topic:
        return topic, field
    if signal in JOINT_OF:
        return "joint_states", signal
    return (signal, "data") if signal == "voltage_command" else None


def unit_of(signal: str) -> str | None:
    """SI unit of a signal by its name; None for other names than the contract's."""
    return _UNITS[signal.rpartition(".")[2]] if topic_of(signal) else None


def is_decoded(topic: str, msgtype: str) -> bool:
    """True if messages of this topic become signals here (images do in a node of their own)."""
    place = place_of(topic)
    return place is not None and place.type == msgtype != IMAGE


def inside(topic: str, namespace: str | None) -> bool:
    """True if a topic is in a namespace; None stands for all topics."""
    return namespace is None or topic.startswith("/" + namespace.strip("/") + "/")


def choose_topics(where: str,
                  counts: Mapping[tuple[str, str], int]) -> tuple[dict[str, str], list[Finding]]:
    """The topic that carries each meaning, and findings; `counts`: messages by topic and type.
    InputError: two topics have one meaning, or a topic of the bench has the wrong type."""
    chosen: dict[str, str] = {}
    places = [(*key, place) for key in counts if (place := place_of(key[0]))]
    for topic, msgtype, place in places:
        other, count = chosen.get(place.meaning), counts[topic, msgtype]
        if msgtype != place.type:
            continue
        if other is not None and count and counts[other, msgtype]:
            both = " and ".join(sorted((other, topic)))
            how = "expected one; choose by namespace, or by sma-bench import"
            raise InputError(f"{where}: both {both} could be {place.meaning}, {how}")
        if other is None or count:
            chosen[place.meaning] = topic
    # A wrong type is an error in the bench's own namespace; elsewhere the topic is ignored.
    own = {p.namespace for topic, _, p in places if chosen.get(p.meaning) == topic}
    findings = []
    for topic, msgtype, place in (p for p in places if p[1] != p[2].type):
        if place.meaning not in chosen and (not own or place.namespace in own):
            wanted = f"{place.type} for {place.meaning}"
            raise InputError(f"{where}: topic {topic} has type {msgtype}, expected {wanted}; "
                             "sma-bench import reads it all the same")
        text = f"type {msgtype}, the contract has {place.type}; not taken for a topic of the bench"
        findings.append(Finding("info", topic, text))
    return chosen, findings

"""Are bags from other recorders read right, or refused, and never silently wrong?

Bags of a bench are drawn at random (synthetic data) and read with `read_record`, and the result is
compared with what was written.

    ./bench check bags --bags 500 --seed 9 --json result.json
"""

import contextlib
import sqlite3
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zstandard
from mcap.writer import CompressionType, IndexType, Writer

from examination import pieces
from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.records import contract, describe, read_record
from sma_bench.records.bag_writer import TYPES, message

OUTCOMES = RIGHT, LOSS, REFUSED, WRONG, RAISED = "right", "loss said", "refused", "wrong", "raised"
MEMORY, SECONDS = 1 << 30, 20.0  # bytes, s: limits for reading one of these small bags
_DATA = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
HABITS: dict[str, list[str]] = _DATA["habits"]
_EPOCH, _HOUR, _DAY = 1_750_000_000 * 10**9, 3600 * 10**9, 86_400 * 10**9
_DELAY, _CHUNK, _PAGE = 2_000_000, 2000, 4096  # ns, longest from stamp to receipt; bytes; bytes
_SAME_TIME, _SAME = 1e-6, 1e-12  # s; V, A, K, m, N: tolerances between written and read numbers
_PROFILES = "- history: 1\n  depth: 10\n  reliability: 2\n  durability: 2\n"
# Time of receipt, topic, type, bytes, number of the stream, number of the message.
Row = tuple[int, str, str, bytes, tuple[int, int]]


@dataclass
class Stream:
    """Messages of one topic: stamps, receipts and order in the file (n,) [ns]; their fields, and
    the expected signals in SI, (n,) by name; whether the messages contain stamps."""

    topic: str
    type: str
    stamp: IntArray
    received: IntArray
    order: IntArray
    fields: dict[str, Array] = field(default_factory=dict)
    signals: dict[str, Array] = field(default_factory=dict)
    is_stamped: bool = True


@dataclass
class Bag:
    """A bag on disk: the messages `whole`, as (stream, message), before the damage; `apart`, s that
    receipts may be off; `tells`: True if nothing is lost or ambiguous."""

    path: Path
    streams: list[Stream]
    habits: dict[str, str]
    whole: set[tuple[int, int]] = field(default_factory=set)
    apart: float = 0.0

    @property
    def tells(self) -> bool:
        return not any(self.habits[kind] in odd for kind, odd in _DATA["tells_not"].items())


def draw_habits(rng: np.random.Generator) -> dict[str, str]:
    """One habit of each kind (of a recorder, a program, a mishap); most are plain."""
    drawn = {kind: str(rng.choice(habits[1:])) if rng.random() > 0.7 else habits[0]
             for kind, habits in HABITS.items()}
    return pieces.without_exclusions(drawn, HABITS, _DATA["exclusions"])


def true_streams(rng: np.random.Generator, habits: dict[str, str]) -> list[Stream]:
    """A wire heated and cooled, measured at several rates."""
    content, stamps = habits["content"], habits["stamps"]
    seconds, begin = rng.uniform(8.0, 20.0), _EPOCH + int(rng.integers(_DAY))
    if habits["clock"].startswith("from 0"):
        begin = 0 if content != "one message each" else 10**9
    prefix = {"/": "/", "/lab/a/rig": "/lab/a/rig/"}.get(habits["topics"], "/bench/")
    streams = []
    for name, kind, rate, fields in _DATA["measured"]:
        time = np.arange(1 if content == "one message each" else int(seconds * rate)) / rate
        if stamps == "jitter":
            time += rng.uniform(0.0, 0.9 / rate, len(time))
        if stamps == "messages lost":
            time = time[(rng.random(len(time)) > 0.1) | (time == 0.0)]
        stamp = begin + np.rint(time * 1e9).astype(np.int64)
        received = stamp + np.sort(rng.integers(_DELAY // 10, _DELAY, len(time)))
        s = Stream(prefix + name, kind, stamp, received, received.copy())
        for part, (signal, low, high, width) in fields.items():
            values = np.arange(len(time), dtype=float)
            if kind != contract.STRING:
                values = rng.uniform(low, high, len(time)).astype(width).astype(float)
            if content in ("NaN", "infinite") and kind not in contract.HEADERLESS:
                values[rng.random(len(time)) < 0.1] = np.nan if content == "NaN" else np.inf
            s.fields[part] = values
            s.signals[signal] = values + contract.CELSIUS_ZERO * (kind == contract.TEMPERATURE)
        streams.append(s)
    others = [s for s in streams[1:] if rng.random() < 0.7]
    return streams[-1:] if content == "markers alone" else [streams[0], *others]


def set_clocks(bag: Bag, rng: np.random.Generator) -> None:
    clock, stamps = bag.habits["clock"], bag.habits["stamps"]
    apart = clock == "from 0, computer's beside" or "apart" in clock
    begin, middle = (int(q(bag.streams[0].received)) for q in (np.min, np.median))
    for number, s in enumerate(bag.streams):
        s.is_stamped = s.type not in contract.HEADERLESS and clock != "never stamped"
        s.is_stamped &= number > 0 or not clock.startswith("one ")
    # If no stamps can be read, the times of receipt are the expected times.
    apart &= any(s.is_stamped and _encoding(s.topic, bag.habits) == "cdr" for s in bag.streams)
    bag.apart = 3e-9 * _DELAY if apart else 0.0
    for number, s in enumerate(bag.streams):
        n = len(s.stamp)
        if apart:
            s.received += _EPOCH if clock.startswith("from 0") else _HOUR
        if clock == "drifting apart":
            s.received += (1e-3 * (s.order - begin)).astype(np.int64)
        s.received += 300_000_000 * (clock == "received late")
        leap = {"set while recording": 40 * _DAY, "set back a little": -3 * 10**9}.get(clock, 0)
        s.stamp[s.order > middle] += leap
        s.received[s.order > middle] += leap
        if not s.is_stamped:
            s.stamp = s.stamp if apart else s.received.copy()
        elif stamps == "repeated":
            s.stamp[1:] = np.where(rng.random(n - 1) < 0.1, s.stamp[:-1], s.stamp[1:])
        elif stamps == "out of order" and n > 4:
            k = int(rng.integers(n - 3))
            s.stamp[k : k + 3] = s.stamp[k : k + 3][::-1].copy()
        elif stamps == "one far away" and number == 0 and n > 1:
            s.stamp[-1] += 300 * _DAY


def serialised(s: Stream, k: int, habits: dict[str, str], stamp: int) -> bytes:
    """Message `k` of a stream."""
    content, row = habits["content"], {name: float(v[k]) for name, v in s.fields.items()}
    frame = f"frame {k % 13 * 'x'}" if content == "frames differ" else "wire"
    fields: dict[str, Any] = {}
    if s.type not in contract.HEADERLESS:
        time = message("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        if habits["clock"] == "impossible stamps" and k % 7 == 3:
            time.nanosec = 4_000_000_000
        fields["header"] = message("std_msgs/msg/Header", stamp=time, frame_id=frame)
    if s.type == contract.JOINT_STATE:
        tip, wire = ("tip", row["tip"], 0.0), ("wire", row["wire"], row["effort"])
        orders = [[tip, wire], [wire, tip], [wire, ("gripper", 9.0, 9.0), tip]]
        joints = orders[k % 3 if content == "joints change places" else 0]
        names, position, effort = zip(*joints, strict=True)
        fields |= {"name": list(names), "position": np.array(position), "effort": np.array(effort)}
        fields["velocity"] = np.zeros(len(names) * (k % 2))
    elif s.type == contract.MULTI_ARRAY:
        fields["data"] = np.array([row["data"]])
    elif s.type == contract.STRING:
        fields["data"] = f"step {k}"
    else:
        fields |= row
    if s.type == contract.BATTERY_STATE and content == "cells":
        fields["cell_voltage"] = np.full(k % 4, 3.7, "f4")
        fields["serial_number"] = "x" * (k % 5)
    if s.type == contract.RANGE:
        fields |= {"min_range": 0.01, "max_range": 4.0}
    return bytes(TYPES.serialize_cdr(message(s.type, **fields), s.type,
                                     little_endian=content != "big-endian"))


def write_bag(folder: Path, rng: np.random.Generator, habits: dict[str, str],
              alter: Callable[[list[Stream]], None] = lambda _: None) -> Bag:
    """Draw true signals, alter them, and write them according to the habits."""
    bag = Bag(folder / "bag", true_streams(rng, habits), habits)
    set_clocks(bag, rng)
    alter(bag.streams)
    bag.path.mkdir()
    rows: list[Row] = []
    for i, s in enumerate(bag.streams):
        for k in range(len(s.stamp)):
            unset = not s.is_stamped or (habits["clock"] == "some not stamped" and k % 7 == 3)
            blob = serialised(s, k, habits, 0 if unset else int(s.stamp[k]))
            rows.append((int(s.received[k]), s.topic, s.type, blob, (i, k)))
    rows.sort(key=lambda row: bag.streams[row[4][0]].order[row[4][1]])
    if habits["stamps"] == "received out of order":
        for k in rng.integers(0, len(rows) - 1, 20) if len(rows) > 1 else ():
            rows[k], rows[k + 1] = rows[k + 1], rows[k]
    rows += [(rows[-1][0], *other, (-1, 0)) for other in _beside(bag.streams[0], habits)]
    if habits["topics"] == "old type names":
        rows = [(at, name, kind.replace("/msg/", "/"), *rest) for at, name, kind, *rest in rows]
    if habits["compression"] == "of messages":
        rows = [(*head, zstandard.compress(blob), where) for *head, blob, where in rows]
    # In files of equal length; the last one is damaged.
    count, names = {"three": 3, "one missing": 3, "twelve": 12}.get(habits["files"], 1), []
    write, suffix = (_write_mcap, "mcap") if habits["storage"] == "mcap" else (_write_db3, "db3")
    for number in range(count):
        part = rows[number * len(rows) // count : (number + 1) * len(rows) // count]
        path = bag.path / f"bag_{number}.{suffix}"
        ends = write(path, part, habits, number)
        if habits["compression"] == "of files":
            packed = path.with_name(path.name + ".zstd")
            packed.write_bytes(zstandard.compress(path.read_bytes()))
            path.unlink()
            path, ends = packed, [packed.stat().st_size] * len(part)
        names.append(path.name)
        before = ends[-1] if ends else 0
        if number == count - 1 and habits["end"] != "whole":
            before = _damage(path, habits["end"], rng)
        if number == 1 and habits["files"] == "one missing":
            path.unlink()
            before = -1
        bag.whole |= {row[4] for row, end in zip(part, ends, strict=True) if end <= before}
    if habits["metadata"] != "missing":
        _write_metadata(bag.path, names, rows, habits)
    if habits["path"] == "file":
        bag.path = bag.path / names[0]
    return bag


def _beside(of: Stream, habits: dict[str, str]) -> list[tuple[str, str, bytes]]:
    """Topic, type and message of other contents of the bag."""
    place, blob = of.topic.removesuffix("wire/power").removesuffix("experiment/marker"), b""
    if habits["beside"] in ("another bench", "twin"):
        blob = serialised(of, 0, {**habits, "content": "plain"}, int(of.stamp[0]))
    name = of.topic.removeprefix(place)
    return {
        "unknown type": [("/lidar", "acme_msgs/msg/Sweep", b"\0\1\0\0" + bytes(40))],
        "image": [(place + "thermal_image", "sensor_msgs/msg/Image", b"\0\1\0\0" + bytes(400))],
        "another bench": [(f"/other/{name}", of.type, blob)],
        "another type": [(place + "back/range", "std_msgs/msg/Float64", b"\0\1\0\0" + bytes(8))],
        "twin": [(f"{place}twin/{name}", of.type, blob)],
        "no schema": [("/log", "", b"{}")], "json": [("/state", "std_msgs/msg/String", b"{}")],
    }.get(habits["beside"], [])


def _encoding(topic: str, habits: dict[str, str]) -> str:
    odd = ("/log", "/state", "/bench/wire/temperature" if habits["topics"] == "not cdr" else "")
    return "json" if topic in odd else "cdr"


def _write_mcap(path: Path, rows: list[Row], habits: dict[str, str], number: int) -> list[int]:
    """Write; the positions in the file at which each message is complete."""
    inside, ends = habits["inside"], list[int]()
    codec = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=_CHUNK, use_chunking=inside != "no chunks",
            compression=codec.get(habits["compression"], CompressionType.NONE),
            index_types=IndexType.ALL if inside == "chunks and index" else IndexType.NONE,
            use_statistics=inside != "chunks, no index",
            enable_crcs=inside not in ("no checksums", "no chunks"))
        writer.start("ros2")
        if habits["beside"] == "attachment":
            writer.add_attachment(0, 0, "notes.txt", "text/plain", b"a wire")
            writer.add_metadata("rosbag2", {"serialized_metadata": "x"})
        for k in range(number):  # numbers of channels differ from file to file
            writer.register_schema(f"unused/msg/Type{k}", "ros2msg", b"")
        channels: dict[tuple[str, int], int] = {}
        for k, (received, topic, kind, blob, _) in enumerate(rows):
            key = topic, k % 2 if habits["beside"] == "two channels" else 0
            if key not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"") if kind else 0
                profiles = {"offered_qos_profiles": _PROFILES * (habits["qos"] == "profiles")}
                channels[key] = writer.register_channel(topic, _encoding(topic, habits), schema,
                                                        profiles)
            before = file.tell()
            writer.add_message(channels[key], received, blob, received)
            if file.tell() > before:  # all messages of a chunk are complete with its end
                ends += [file.tell()] * (k + 1 - len(ends))
        writer.finish()
        ends += [file.tell()] * (len(rows) - len(ends))
    return ends


def _write_db3(path: Path, rows: list[Row], habits: dict[str, str], number: int) -> list[int]:
    """Write. A damaged file need not be readable at all."""
    profiles = _PROFILES * (habits["qos"] == "profiles")
    kinds = {topic: kind for _, topic, kind, *_ in reversed(rows)}
    ids = {topic: number + k for k, topic in enumerate(dict.fromkeys(row[1] for row in rows), 1)}
    topics = [(ids[name], name, kinds[name], _encoding(name, habits), profiles) for name in ids]
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.executescript(_DATA["tables"])
        database.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", topics)
        database.executemany("INSERT INTO messages VALUES (NULL, ?, ?, ?)",
                             ((ids[topic], received, blob) for received, topic, _, blob, _ in rows))
        database.commit()
    return [path.stat().st_size] * len(rows)


def _damage(path: Path, how: str, rng: np.random.Generator) -> int:
    """Damage a storage file; the position before which it is unchanged."""
    raw = path.read_bytes()
    at, size = int(rng.integers(len(raw) // 4, len(raw) - 1)), int(rng.integers(1, _PAGE))
    if how == "not closed" and path.suffix == ".mcap":  # no data end, summary and footer
        at = raw.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    elif how == "zeros" or (how == "garbage" and path.suffix == ".db3"):  # whole blocks of a disk
        at, size = at // _PAGE * _PAGE, _PAGE
    bit = bytes([raw[at] ^ 1 << int(rng.integers(8))])
    path.write_bytes(raw[:at] + {
        "not closed": b"", "cut": b"", "zeros": bytes(len(raw) - at), "bit": bit + raw[at + 1 :],
        "garbage": rng.bytes(min(size, len(raw) - at)) + raw[at + size :],
        "block gone": raw[at + size :], "block twice": raw[at : at + size] + raw[at:]}[how])
    return at


def _write_metadata(bag: Path, names: list[str], rows: list[Row], habits: dict[str, str]) -> None:
    how, modes = habits["metadata"], {"of files": "FILE", "of messages": "MESSAGE"}
    counts = Counter((topic, kind) for _, topic, kind, *_ in rows)
    counts = dict.fromkeys(counts, 0) if how == "of the start" else counts
    if how == "of rosbag2 2":  # file names that include the folder
        names = [f"{bag.name}/{name}" for name in names]
    listed = {"of the start": names[:1], "one file less": names[:-1]}.get(how, names)
    information = {
        "version": 2 if how == "of rosbag2 2" else 9, "storage_identifier": habits["storage"],
        "relative_file_paths": listed, "message_count": sum(counts.values()),
        "starting_time": {"nanoseconds_since_epoch": rows[0][0]},
        "topics_with_message_count": [
            {"message_count": count, "topic_metadata": {
                "name": topic, "type": kind, "serialization_format": _encoding(topic, habits),
                "offered_qos_profiles": _PROFILES * (habits["qos"] == "profiles")}}
            for (topic, kind), count in counts.items()],
        "compression_format": "zstd" if habits["compression"] in modes else "",
        "compression_mode": modes.get(habits["compression"], "")}
    text = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
    (bag / "metadata.yaml").write_text(text[: len(text) // 2] if how == "cut off" else text)


def outcome(bag: Bag) -> tuple[str, str]:
    """Read the bag; one of OUTCOMES, and the reason."""
    try:
        with pieces.allowance(MEMORY, SECONDS):
            record = read_record(bag.path)
            describe(record)
    except InputError as error:
        return (RAISED if "\n" in str(error) else REFUSED), str(error)
    except Exception:  # any exception is a finding
        return RAISED, traceback.format_exc()
    faults, lost = [], 0
    read = {name: (signal.time, signal.values) for name, signal in record.signals.items()}
    if record.markers:
        numbers = [float(text.removeprefix("step ")) for _, text in record.markers]
        read["markers"] = np.array([time for time, _ in record.markers]), np.array(numbers)
    said = {f.subject for f in record.findings if f.severity != "info" or "nan" in f.numbers}
    of_files = any(not subject.startswith("/") for subject in said - {"metadata.yaml"})
    for number, s in enumerate(bag.streams):
        for name, true in s.signals.items():
            time, values = read.pop(name, (np.empty(0), np.empty(0)))
            time = time + (record.start_ns - int(s.order[0])) * 1e-9
            fault = _fault(bag, number, true, time, values.reshape(-1))
            lost += (missing := len(true) - len(time))
            if missing and not of_files and s.topic not in said:
                fault = f"{missing} of {len(true)} silently lost"
            faults += [f"{name}: {fault}"] if fault else []
        if bag.habits["clock"] == "set back a little" and (np.diff(s.stamp) < 0).any():
            faults += [] if said else [f"{s.topic}: a clock set back, without a warning"]
    faults += [f"{name}: not in the bag" for name in read]
    if faults:
        return WRONG, "; ".join(faults)
    return (LOSS, f"{lost} numbers") if lost else (RIGHT, "")


def _fault(bag: Bag, number: int, true: Array, time: Array, values: Array) -> str:
    """What is wrong with the values (m,) read at times (m,) for a signal (n,); "" if nothing."""
    s = bag.streams[number]
    limit = _SAME_TIME + (0.0 if s.is_stamped else bag.apart)
    near = np.abs(time[:, None] - (s.stamp - s.order[0]) * 1e-9) <= limit
    with np.errstate(invalid="ignore"):
        same = (values[:, None] == true) | (np.abs(values[:, None] - true) < _SAME)
    if wrong := int(np.count_nonzero(~near.any(axis=1))):
        return f"{wrong} of {len(time)} times are not in the bag"
    if wrong := int(np.count_nonzero(~(near & same).any(axis=1))):
        return f"{wrong} of {len(time)} values are not in the bag"
    # Everything before the damage of an mcap file must be read, unless its stamps prevent that.
    told = (_DATA["tells_not"] | {"end": (), "files": ()}).items()
    if bag.habits["storage"] == "mcap" and not any(bag.habits[kind] in odd for kind, odd in told):
        first = set(np.unique(s.stamp, return_index=True)[1].tolist())
        due = [k for i, k in bag.whole if i == number and k in first and not np.isnan(true[k])]
        if missed := int(np.count_nonzero(~near.any(axis=0)[due])):
            return f"{missed} of {len(due)} before the damage not read"
    return ""


def main(argv: Sequence[str] | None = None) -> int:
    """Draw, read, compare; 0 if nothing was silently wrong, 1 if something was."""
    found = pieces.judged("bags", __doc__, argv, "bags", try_bag, OUTCOMES, HABITS)
    if telling := [one["outcome"] for one in found if one["tells"]]:
        read = sum(end in (RIGHT, LOSS) for end in telling)
        print(f"read of the complete and unambiguous bags: {read / len(telling):.1%}")
    return int(any(one["outcome"] in (WRONG, RAISED) for one in found))


def try_bag(seed: int, number: int) -> dict[str, Any]:
    rng = np.random.default_rng([50, seed, number])
    habits = draw_habits(rng)
    with tempfile.TemporaryDirectory() as folder:
        bag = write_bag(Path(folder), rng, habits)
        end, why = outcome(bag)
    return {"habits": habits, "tells": bag.tells, "outcome": end, "why": why.replace(folder, "")}

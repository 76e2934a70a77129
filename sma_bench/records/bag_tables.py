"""Reads a bag of another bench, ROS 1 bags, too, as tables: one for each topic, with a column for
each number of its messages, whose type is known or defined in the bag."""

import re
from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.border import OverBudget, printable
from sma_bench.errors import InputError
from sma_bench.records import bag
from sma_bench.records.cells import WORDS, message, split_title, words_of
from sma_bench.records.contract import inside
from sma_bench.records.storage import RawTopic, read_storage
from sma_bench.records.tables import Column, Table, TableFile

_UNREAD = re.compile(r"/(?:\w*Image|PointCloud2?|LaserScan|OccupancyGrid|Log|String|TFMessage|"
                     r"Marker(?:Array)?|Clock|CameraInfo|ParameterEvent)\Z")
_MOST_FIELDS, _LONGEST_DEFINITION = 500, 1 << 16  # of a type; characters
_DATED = 86_400.0  # s; later stamps are dates
_NAMES = ("name", "key", "label")  # fields whose texts name the numbers next to them
_CODES = {"bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "string": "string"}
_CODES |= {f"{sign}int{8 * n}": f"{sign or 'i'}{n}" for sign in ("", "u") for n in (1, 2, 4, 8)}
_CODES |= {"float32": "f4", "float64": "f8"}
_NAMED, _ARRAY, _SEQUENCE = 2, 3, 4  # kinds of fields, as rosbags counts them


def read_bag_tables(path: Path, namespace: str | None = None) -> TableFile:
    """The topics of a bag in `namespace` as tables on one clock. InputError: nothing readable."""
    raw_topics = read_storage(
        path, lambda n, t: inside(n, namespace) and not _UNREAD.search(t), is_foreign=True)
    decoded, outside, tables, digest = list[bag.Samples](), list[str](), list[Table](), sha256()
    for raw in sorted(raw_topics.topics.values(), key=lambda raw: raw.name):
        digest.update(raw.data)
        why = "not read"
        if raw.wanted:
            try:
                decoded.append(bag.samples_of(raw, raw_topics, _fields_of(raw), _named))
                continue
            except (bag.CdrError, OverBudget) as error:
                why = str(error)
        outside.append(f"{raw.name} ({raw.type}, {why})")
    bag.put_on_one_clock(decoded, raw_topics)
    decoded = [samples for samples in decoded if len(samples.stamp) and samples.columns]
    if not decoded:
        raise InputError(f"{path}: no numbers in its topics: {', '.join(outside) or 'none'}")
    zero = min(int(samples.stamp[0]) for samples in decoded)
    start = zero / 1e9 if zero / 1e9 > _DATED else None
    notes = [f"{f.subject}: {f.text}" for f in raw_topics.findings if f.severity != "info"]
    for samples in decoded:
        topic, clock = samples.topic, (samples.stamp - zero) / 1e9
        columns = [Column(f"{topic} stamp", f"{topic} time", "s", clock, topic, start, 3)]
        units = WORDS["messages"].get(samples.type.replace("/msg/", "/"))
        # Words such as `battery` in the topic's name count, too: it may be a robot's.
        doubtful = {*words_of(topic)} & {*WORDS["doubtful"], *WORDS["supplies"]}
        for name, values in samples.columns.items():
            label, parts = f"{topic}/{name}".removesuffix("/data"), re.split("[./]", name)
            known = [unit for key, unit in (units or {}).items() if key in parts]
            named = label if name == "data" else " ".join([*doubtful, *parts[-2:]])
            title, unit = split_title(named, *known[:1])
            if known or units is None:
                columns.append(Column(label, title, unit, np.asarray(values), topic))
        lines = np.arange(1, len(clock) + 1)
        tables.append(Table(topic, tuple(columns), lines, len(clock), notes=tuple(notes)))
        notes = []
    return TableFile(path, "rosbag", digest.hexdigest(), ()).with_tables(tables, outside)


def _fields_of(raw: RawTopic) -> bag.Fields:
    """Fields of a topic's type, those of messages inside it with their path. CdrError: unknown."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    types: dict[str, Any] = dict(get_typestore(Stores.ROS2_JAZZY).fielddefs)

    @cache
    def fields(kind: str) -> bag.Fields:
        if kind not in types:
            raise bag.CdrError(message("undefined"))
        found = list[tuple[str, Any]]()
        for name, (node, of) in types[kind][1]:
            (inner, held), count = of if node in (_ARRAY, _SEQUENCE) else ((node, of), 1)
            if inner == _NAMED:
                element: Any = fields(held)
                own = [(f"{name}.{part}", what) for part, what in element]
            else:
                element = _CODES.get(held[0], "")
                if element == "string" and (node == _SEQUENCE or name in _NAMES):
                    element = "text"
                own = [(name, element)]
            if not element:
                raise bag.CdrError(f"its field {name} is of a type that is not read")
            if node == _SEQUENCE:
                own = [(name, element if inner == _NAMED else f"{element}[]")]
            elif node == _ARRAY:
                own = [(f"{part}.{k}", what) for k in range(min(count, _MOST_FIELDS))
                       for part, what in own]
            found += own
            if len(found) > _MOST_FIELDS:
                raise bag.CdrError(f"more than {_MOST_FIELDS} fields")
        return tuple(found)
    try:
        if raw.definition:
            types |= get_types_from_msg(raw.definition[:_LONGEST_DEFINITION], raw.type)
        return fields(raw.type)
    except bag.CdrError:
        raise
    except Exception:  # of the parser's many types, or a type inside itself
        raise bag.CdrError("the definition of its type cannot be understood") from None


def _named(batch: bag.Batch) -> Iterator[tuple[str, Any]]:
    """Name and values (n,) of each number in messages, named by the texts next to it."""
    labels = [text for name, texts in batch.texts.items() for text in texts if name[-5:] == "label"]
    lists = [texts for name, texts in batch.texts.items() if not re.search(r"\.\d", name)]
    lists += [tuple(labels), *(tuple(re.split(r"[,;]\s*|\s+", text)) for text in labels[:1])]
    for name, block in batch.columns.items():
        parts, width = name.split("."), block.shape[1]
        if parts[0] in ("header", "layout"):
            continue
        for k in (k for k, part in enumerate(parts) if part.isdigit()):
            texts = (batch.texts.get(".".join([*parts[: k + 1], n]), ("",))[0] for n in _NAMES)
            parts[k] = next(filter(None, texts), parts[k])
        own = next((list(t) for t in lists if len(t) == width and any(t)), [])
        field = ".".join(parts)
        for k in range(width):
            full = f"{own[k]}/{field}" if own else f"{field} {k + 1}" if width > 1 else field
            if field == "data" and (own or width > 1):
                full = own[k] if own else str(k + 1)
            yield printable(full), block[:, k]

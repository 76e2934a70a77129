"""Writes signals as a bag of the contract."""

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from math import inf
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from sma_bench.errors import InputError
from sma_bench.progress import Report, in_turn, silent
from sma_bench.records.bag_files import PROVENANCE
from sma_bench.records.bag_writer import STILL_READABLE, BagWriter
from sma_bench.records.messages import Stream, marker_stream, streams_of
from sma_bench.records.record import Record, Signal

_MESSAGES = 50_000
"""about as many are written between two reports"""

_SignalSource = Record | Mapping[str, Signal] | Iterable[Signal]


def write_record(
    path: str | Path,
    source: _SignalSource,
    namespace: str = "bench",
    storage: str = "mcap",
    start_ns: int | None = None,
    markers: Iterable[tuple[float, str]] = (),
    provenance: Mapping[str, Any] | None = None,
    report: Report = silent,
    replace: bool = False,
) -> None:
    """Write a record, or signals, as a bag; the bag appears whole or not at all.

    The same signals give the same bytes.

    Signals that share a message type and place (voltage and current of a wire) share messages;
    where their times differ the other one is NaN, that is not measured. Voltage, current and range
    are 32-bit on the wire: about 7 digits.

    Args:
        path: new folder.
        source: a Record, or Signals (by name or just a sequence).
        namespace: of the topics, without slashes at the ends.
        storage: "mcap" or "sqlite3".
        start_ns: epoch time of t = 0 in ns; the record's own, else 0.
        markers: (time in s, text), added to the record's own.
        provenance: where the signals come from, kept in metadata.yaml (`source`, `sha256`, `how`
            and whatever else, as JSON) and given back by `read_record`.
        report: called with how far it is.
        replace: a bag that lies at the path, once the new one is whole.

    Raises:
        InputError: the path exists (and is not to be replaced) or cannot be written, a signal has
            no place in the contract or times that cannot be stamped.
    """
    path = Path(path)
    signals, start, texts = _unpack(source, start_ns, markers)
    prefix = "/" + namespace.strip("/") + "/" if namespace.strip("/") else "/"
    streams = [*streams_of(signals, prefix, start)]
    if texts:
        streams.append(marker_stream(texts, prefix, start))
    if not streams:
        raise InputError(f"{path}: no signals to write, expected at least one")
    custom = {PROVENANCE: json.dumps(dict(provenance))} if provenance else None
    with (
        _beside(path, replace) as temporary,
        BagWriter(temporary, storage, flush_every=inf, custom_data=custom) as writer,
    ):
        _write_streams(writer, streams, report)


def _unpack(
    source: _SignalSource, start_ns: int | None, markers: Iterable[tuple[float, str]]
) -> tuple[dict[str, Signal], int, list[tuple[float, str]]]:
    texts = [*markers]
    if isinstance(source, Record):
        start = source.start_ns if start_ns is None else start_ns
        return dict(source.signals), start, [*source.markers, *texts]
    given = source.values() if isinstance(source, Mapping) else source
    return {signal.name: signal for signal in given}, start_ns or 0, texts


@contextmanager
def _beside(path: Path, replace: bool) -> Iterator[Path]:
    """A path to write to that becomes `path` when all went well."""
    if path.exists() and not replace:
        raise InputError(f"{path}: exists already, expected a new path for the bag")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    try:
        yield folder / path.name
        if path.exists() and not replace:
            raise InputError(f"{path}: exists already, expected a new path for the bag")
        old = folder / f"{path.name}.replaced"
        if path.exists():
            path.rename(old)
        try:
            (folder / path.name).rename(path)
        except OSError:
            if old.exists():
                old.rename(path)
            raise
    except InputError as error:
        # Of a bag that appears whole or not at all nothing is left to read.
        text = str(error).replace(str(folder / path.name), str(path)).removesuffix(STILL_READABLE)
        raise InputError(text) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_streams(writer: BagWriter, streams: list[Stream], report: Report) -> None:
    for stream in streams:
        writer.add_topic(stream.topic, stream.type)
    received = np.concatenate([stream.received for stream in streams])
    owner = np.repeat(np.arange(len(streams)), [len(stream.blobs) for stream in streams])
    index = np.concatenate([np.arange(len(stream.blobs)) for stream in streams])
    order = np.argsort(received, kind="stable")
    parts = np.array_split(order, max(1, len(order) // _MESSAGES))
    for chosen in in_turn(parts, report, lambda _: "writing"):
        rows = zip(*(a[chosen].tolist() for a in (owner, index, received)), strict=True)
        writer.write_many(
            (streams[which].topic, stamp, streams[which].blobs[row]) for which, row, stamp in rows
        )

"""Which storage files make up a bag, what its metadata.yaml says about them, and their messages."""

import os
import re
from itertools import pairwise
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from sma_bench.border import (
    OverBudget,
    is_inside,
    read_json_object,
    read_yaml,
    require_there,
    shown,
)
from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.records.storage import (
    MCAP_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    RawTopics,
    decompress_file,
    read_mcap,
    read_sqlite,
)

T = TypeVar("T")

METADATA = "metadata.yaml"
PROVENANCE = "sma_bench_provenance"  # key of custom_data in it
_LONGEST_NAME = 255  # bytes, on every file system
_LONGEST_TOLD, _MOST_SENTENCES = 2000, 50  # of a provenance: characters, signals
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".mat", ".h5", ".hdf5", ".parquet")


def is_bag(path: Path) -> bool:
    """Whether a path is meant to be a bag: a folder, or a file with a storage's content or name.

    Raises:
        InputError: there is neither a folder nor a regular file that can be read.
    """
    require_there(path)
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            head = file.read(len(SQLITE_MAGIC))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    magic = (MCAP_MAGIC, SQLITE_MAGIC, ZSTD_MAGIC)
    return path.name.endswith(_SUFFIXES) or head.startswith(magic)


def find_bag_files(path: Path, topics: RawTopics) -> tuple[list[Path], dict[str, int]]:
    """The storage files of a bag's folder, or of a storage file by itself, in order.

    Returns:
        The files, and the number of messages by topic that the metadata promises.

    Raises:
        InputError: nothing there, not a bag, or a folder of several bags.
    """
    if not is_bag(path):
        how = ""
        if path.suffix.lower() in _TABLES:
            how = f"; make a record of a table: sma-bench import {path.name} --out {path.stem}"
        raise InputError(f"{path}: not a bag: expected a folder, an .mcap or a .db3 file{how}")
    if not path.is_dir():
        return [path], {}

    # Storage files of the folder in order of their numbers; links out of it are not followed.
    try:
        names = {file.name for file in path.iterdir() if file.is_file()}
        own = {name for name in names if is_inside(path / name, path)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    for name in sorted(names - own):
        if name == METADATA or name.endswith(_SUFFIXES):
            topics.lost(name, "a link out of the bag's folder; not followed")
    numbered = {re.sub(r"\d+", lambda m: m[0].zfill(9), n): n for n in own if n.endswith(_SUFFIXES)}
    present = [path / numbered[key] for key in sorted(numbered)]
    if METADATA not in names:
        return _without_metadata(path, present, topics), {}

    # What the metadata says, from a file that may be anybody's.
    try:
        if METADATA not in own:
            raise ValueError("a link")
        information = read_yaml(path / METADATA, aliases=True)["rosbag2_bagfile_information"]
        listed = [PurePath(_of(str, name)).name for name in information["relative_file_paths"]]
        promised: dict[str, int] = {}
        for entry in information.get("topics_with_message_count") or ():
            topic = _of(str, entry["topic_metadata"]["name"])
            promised[topic] = promised.get(topic, 0) + _of(int, entry["message_count"])
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        topics.lost(METADATA, "cannot be understood; the storage files found beside it are read")
        _tell_gaps(present, topics)
        return present, {}
    _tell_provenance(information.get("custom_data"), topics)
    listed = [name for name in dict.fromkeys(listed) if len(os.fsencode(name)) <= _LONGEST_NAME]
    files = [path / name for name in listed if is_inside(path / name, path)]
    for missing in (file for file in files if not file.is_file()):
        text = f"the storage file {missing.name} is missing; the others are read"
        topics.lost(missing.name, text)
    for extra in (file for file in present if file not in files):
        # A recorder that died right after a split has not listed its newest file.
        topics.lost(extra.name, f"not listed in {METADATA}; read all the same")
        files.append(extra)
    return [file for file in files if file.is_file()], promised


def _without_metadata(path: Path, present: list[Path], topics: RawTopics) -> list[Path]:
    """All files of one bag: a single one, or those that a recorder has numbered."""
    if not present:
        raise InputError(
            f"{path}: not a bag: the folder holds no {METADATA} and no .mcap or .db3 file"
        )
    stems = {re.sub(r"_\d+$", "", file.name.partition(".")[0]) for file in present}
    if len(stems) > 1:
        some = ", ".join(file.name for file in present[:3])
        raise InputError(
            f"{path}: no {METADATA} in the folder, and files of several bags: {some}; expected one "
            "bag, or the path of a file"
        )
    _tell_gaps(present, topics)
    text = f"is missing; {len(present)} storage file{'s' * (len(present) > 1)} beside it read"
    topics.findings.append(Finding("info", METADATA, text))
    return present


def _tell_gaps(present: list[Path], topics: RawTopics) -> None:
    """A loss where the files of a folder, in order of their numbers, lack some between others."""
    numbered = [(re.search(r"_(\d+)\.", file.name), file.name) for file in present]
    known = [(int(number[1]), name) for number, name in numbered if number]
    for (before, _), (after, name) in pairwise(known):
        if after > before + 1:
            topics.lost(name, f"files {before + 1} to {after - 1} in front of it are missing")


def _tell_provenance(custom: Any, topics: RawTopics) -> None:
    """A finding of where an imported bag comes from."""
    text = custom.get(PROVENANCE) if isinstance(custom, dict) else None
    if not isinstance(text, str):
        return
    try:
        said = read_json_object(text, PROVENANCE)
    except InputError as error:
        topics.findings.append(Finding("warning", METADATA, str(error)))
        return
    how = said.get("how")
    parts = [f"imported from {said.get('source', '?')}, sha256 {said.get('sha256', '?')}"]
    parts += [str(part) for part in how[:_MOST_SENTENCES]] if isinstance(how, list) else []
    topics.findings.append(Finding("info", "record", shown("; ".join(parts), _LONGEST_TOLD)))
    repeated = said.get("repeated")
    if isinstance(repeated, int) and repeated > 0:
        told = f"{repeated} rows had the stamp of the row before and were spread evenly at import"
        topics.findings.append(Finding("warning", "record", told, {"repeated": float(repeated)}))


def _of(kind: type[T], value: Any) -> T:
    """A value of its type; of any other the text alone may be gigabytes, by YAML's aliases."""
    if not isinstance(value, kind):
        raise TypeError(kind.__name__)
    return value


def read_files(files: list[Path], topics: RawTopics) -> None:
    """Take the messages of all storage files; what cannot be read becomes a finding.

    Raises:
        InputError: an sqlite3 file is damaged.
    """
    for file in files:
        try:
            with TemporaryDirectory() as folder, file.open("rb") as opened:
                plain = file
                if opened.read(4) == ZSTD_MAGIC or file.name.endswith(".zstd"):
                    plain = Path(folder, file.name.removesuffix(".zstd"))
                    if ended := decompress_file(file, plain, topics.budget):
                        topics.lost(file.name, f"{ended}; read up to there")
                # By content; by name where the beginning is damaged.
                with plain.open("rb") as unpacked:
                    head = unpacked.read(len(SQLITE_MAGIC))
                is_mcap = head.startswith(MCAP_MAGIC)
                if head == SQLITE_MAGIC or (plain.suffix == ".db3" and not is_mcap):
                    read_sqlite(plain, topics, file)
                else:
                    read_mcap(plain, topics, file.name)
        except OverBudget as error:
            topics.lost(file.name, f"{error}; read up to there")
        except OSError as error:
            topics.lost(file.name, f"cannot be read: {error.strerror or error}")

"""Which storage files make up a bag, and what its metadata.yaml says about them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
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
from sma_bench.records import mcap_scan, sqlite_scan
from sma_bench.records.harvest import ZSTD_MAGIC, Harvest, decompress_file

T = TypeVar("T")

METADATA = "metadata.yaml"
PROVENANCE = "sma_bench_provenance"  # key of custom_data in it
_LONGEST_NAME = 255  # bytes, on every file system
_LONGEST_TOLD, _MOST_SENTENCES = 2000, 50  # of a provenance: characters, signals
_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_TABLES = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".mat", ".h5", ".hdf5", ".parquet")
_SCANNERS = {
    mcap_scan.MAGIC: mcap_scan.scan_mcap,
    sqlite_scan.MAGIC: sqlite_scan.scan_sqlite,
}
_SCANNERS_BY_SUFFIX = {".mcap": mcap_scan.scan_mcap, ".db3": sqlite_scan.scan_sqlite}


@dataclass
class BagFiles:
    """Storage files in order, and the message counts promised by the metadata."""

    files: list[Path]
    promised: dict[str, int] = field(default_factory=dict)


def is_bag(path: Path) -> bool:
    """Whether a path is meant to be a bag: a folder, or a file with a storage's content or name.

    Raises:
        InputError: there is neither a folder nor a regular file that can be read.
    """
    require_there(path)
    if path.is_dir():
        return True
    head = first_bytes(path)
    return path.name.endswith(_SUFFIXES) or head.startswith((*_SCANNERS, ZSTD_MAGIC))


def first_bytes(path: Path) -> bytes:
    """The first 16 bytes of a file.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def find_bag_files(path: Path, harvest: Harvest) -> BagFiles:
    """The storage files of a bag folder or of a bare storage file.

    Raises:
        InputError: nothing there, not a bag, or no metadata.yaml in the folder.
    """
    is_one = is_bag(path)
    if not path.is_dir():
        if not is_one:
            how = ""
            if path.suffix.lower() in _TABLES:
                how = f"; make a record of a table: sma-bench import {path.name} --out {path.stem}"
            raise InputError(
                f"{path}: not a bag: expected a folder, an .mcap or a .db3 file{how}"
            )
        return BagFiles([path])
    try:
        names = {p.name for p in path.iterdir() if p.is_file()}
        exists = METADATA in names
        own = {name for name in names if is_inside(path / name, path)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    present = sorted(path / name for name in own if name.endswith(_SUFFIXES))
    for name in sorted(names - own):
        if name == METADATA or name.endswith(_SUFFIXES):
            harvest.lost(name, "a link out of the bag's folder; not followed")
    if not exists:
        raise InputError(f"{path}: {_without_metadata(present)}")
    return _from_metadata(path, present, harvest)


def _without_metadata(present: list[Path]) -> str:
    if not present:
        return f"not a bag: the folder holds no {METADATA} and no .mcap or .db3 file"
    return f"no {METADATA} in the folder; its storage file can be opened by itself: {present[0]}"


def _from_metadata(path: Path, present: list[Path], harvest: Harvest) -> BagFiles:
    try:
        if not is_inside(path / METADATA, path):
            raise ValueError("a link")
        information = read_yaml(path / METADATA, aliases=True)["rosbag2_bagfile_information"]
        names = [PurePath(_of(str, name)).name for name in information["relative_file_paths"]]
        promised: dict[str, int] = {}
        for entry in information.get("topics_with_message_count") or ():
            topic = _of(str, entry["topic_metadata"]["name"])
            promised[topic] = promised.get(topic, 0) + _of(int, entry["message_count"])
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        text = "cannot be understood; the storage files found beside it are read"
        harvest.lost(METADATA, text)
        return BagFiles(present)
    _tell_provenance(information.get("custom_data"), harvest)
    names = [name for name in dict.fromkeys(names) if len(os.fsencode(name)) <= _LONGEST_NAME]
    files = [path / name for name in names if is_inside(path / name, path)]
    for missing in (file for file in files if not file.is_file()):
        text = f"the storage file {missing.name} is missing; the others are read"
        harvest.lost(missing.name, text)
    for extra in present:
        if extra not in files:
            # A recorder that died right after a split has not listed its newest file.
            text = f"not listed in {METADATA}; read all the same"
            harvest.lost(extra.name, text)
            files.append(extra)
    return BagFiles([file for file in files if file.is_file()], promised)


def _tell_provenance(custom: Any, harvest: Harvest) -> None:
    """A finding of where an imported bag comes from."""
    text = custom.get(PROVENANCE) if isinstance(custom, dict) else None
    if not isinstance(text, str):
        return
    try:
        said = read_json_object(text, PROVENANCE)
    except InputError as error:
        harvest.findings.append(Finding("warning", METADATA, str(error)))
        return
    how = said.get("how")
    parts = [f"imported from {said.get('source', '?')}, sha256 {said.get('sha256', '?')}"]
    parts += [str(part) for part in how[:_MOST_SENTENCES]] if isinstance(how, list) else []
    harvest.findings.append(Finding("info", "record", shown("; ".join(parts), _LONGEST_TOLD)))


def _of(kind: type[T], value: Any) -> T:
    """A value of its type; of any other the text alone may be gigabytes, by YAML's aliases."""
    if not isinstance(value, kind):
        raise TypeError(kind.__name__)
    return value


def scan_files(files: list[Path], harvest: Harvest) -> None:
    """Gather the messages of all storage files; what cannot be read becomes a finding."""
    for file in files:
        try:
            with _plain(file, harvest) as plain:
                _scanner(file, plain)(plain, harvest)
        except OSError as error:
            harvest.lost(file.name, f"cannot be read: {error.strerror or error}")
        except OverBudget as error:
            harvest.lost(file.name, f"{error}; read up to there")


@contextmanager
def _plain(file: Path, harvest: Harvest) -> Iterator[Path]:
    """The file itself, or a temporary copy without its file compression."""
    with file.open("rb") as opened:
        compressed = opened.read(4) == ZSTD_MAGIC or file.name.endswith(".zstd")
    if not compressed:
        yield file
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder, file.name.removesuffix(".zstd"))
        if ended := decompress_file(file, plain, harvest.budget):
            harvest.lost(file.name, f"{ended}; read up to there")
        yield plain


def _scanner(file: Path, plain: Path) -> Any:
    """By content; by name where the content's beginning is damaged."""
    with plain.open("rb") as opened:
        head = opened.read(16)
    for magic, scanner in _SCANNERS.items():
        if head.startswith(magic):
            return scanner
    suffix = Path(file.name.removesuffix(".zstd")).suffix
    return _SCANNERS_BY_SUFFIX.get(suffix, mcap_scan.scan_mcap)

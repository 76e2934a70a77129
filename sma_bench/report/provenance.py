"""What a report was made of: files with their hashes, versions, parameters, the command."""

import hashlib
import platform
from collections.abc import Iterator, Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path

from sma_bench import __version__
from sma_bench.border import is_inside
from sma_bench.errors import InputError
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import TABLE
from sma_bench.report.page import Section, Table

_PACKAGES = ("numpy", "scipy", "numba", "matplotlib", "rosbags")
_BLOCK = 1 << 20


def digest(path: Path) -> tuple[str, int]:
    """SHA-256 and size in bytes of a file; of a folder, over names and contents of its files,
    not of those that links lead to outside.

    Raises:
        InputError: a file cannot be read.
    """
    total, size = hashlib.sha256(), 0
    try:
        for part in _own_files(path) if path.is_dir() else [path]:
            if path.is_dir():
                head = f"{part.relative_to(path)}\0{part.stat().st_size}\0"
                total.update(head.encode("utf-8", "surrogateescape"))
            for block in _blocks(part):
                total.update(block)
                size += len(block)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return total.hexdigest(), size


def _own_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file() and is_inside(p, folder))


def _blocks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            yield block


def versions() -> dict[str, str]:
    """Of this package, what it computes with, Python and the machine."""
    found = {"sma_bench": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found | {"system": f"{platform.system()} {platform.machine()}"}


def provenance_section(
    digests: Sequence[tuple[str, str, int]], command: str, made: datetime
) -> Section:
    """Files, versions and the command.

    Args:
        digests: path, SHA-256 and bytes of every input.
        command: as typed; made: when.
    """
    files = [(path, sha, f"{size}") for path, sha, size in digests]
    about = {
        "command": command, "made": made.astimezone().isoformat(timespec="seconds"), **versions()
    }
    return Section(
        "Provenance",
        ["A folder's hash covers the names, sizes and contents of its files in alphabetical "
         "order."],
        tables=[
            Table(("file", "SHA-256", "bytes"), files, frozenset({2}), "provenance_files", "Files"),
            Table(("", ""), list(about.items()), frozenset(), "provenance_versions",
                  "Made by"),
        ],
    )  # fmt: skip


def parameter_section(parameters: Parameters, path: str) -> Section:
    """The parameters that were given, with their uncertainties."""
    rows = []
    for p in TABLE:
        if p.name not in parameters.given:
            continue
        value = parameters[p.name]
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        known = p.uncertainty is not None or p.name in parameters.given_uncertainty
        rows.append((p.name, shown, f"{parameters.std(p.name):.2g}" if known else "", p.unit))
    header = ("parameter", "value", "standard deviation", "unit")
    table = Table(header, rows, frozenset({1, 2}), "parameters")
    return Section("Parameters", [f"As given in {path}; all others as in docs/parameters.md."],
                   tables=[table])  # fmt: skip

"""A set of cases as the examination sees it: folders and names, and labels that stay sealed."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.blind.sealed import unseal
from sma_bench.errors import InputError

MANIFEST, CASES, LABELS, ANSWERS = "manifest.json", "cases", "labels.sealed", "answers"
_CASE_NAME = re.compile(r"[0-9A-Za-z_]+\Z")


@dataclass(frozen=True)
class CaseSet:
    """What a manifest tells.

    Attributes:
        root: folder of the set.
        names: of the cases, each a folder below `folder`.
        seed, split: that made it.
        sealed_sha256: of the labels' file.
    """

    root: Path
    names: tuple[str, ...]
    seed: int
    split: str
    sealed_sha256: str

    @property
    def folder(self) -> Path:
        """Where the cases lie."""
        return self.root / CASES

    @property
    def answers(self) -> Path:
        """Where answers lie unless told otherwise."""
        return self.root / ANSWERS

    def labels(self) -> list[dict[str, Any]]:
        """The sealed labels; raises InputError unless they are the ones that the manifest names."""
        return unseal(self.root / LABELS, self.sealed_sha256)


def read_case_set(root: str | Path) -> CaseSet:
    """The set in a folder that `sma-bench blind make` has written; labels are not touched.

    Raises:
        InputError: no such folder, or a damaged manifest.
    """
    path = Path(root) / MANIFEST
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not JSON") from None
    try:
        names = tuple(_name(entry) for entry in document["cases"])
        found = CaseSet(
            Path(root), names, int(document["seed"]), str(document["split"]), document["sha256"]
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}") from None
    if not names:
        raise InputError(f"{path}: names no cases")
    return found


def _name(entry: Any) -> str:
    if not isinstance(entry, str) or not _CASE_NAME.match(entry):
        raise ValueError(f"case {entry!r}")
    return entry

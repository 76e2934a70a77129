"""Labels under seal: one deflated file whose digest the manifest names."""

import hashlib
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError

_HEAD = b"sma-bench labels, sealed: only the scorer opens them, after the last answer\n"


def seal(path: Path, labels: Sequence[dict[str, Any]]) -> str:
    """Write labels to a new file; the sha256 of the file."""
    text = json.dumps(list(labels), separators=(",", ":"), allow_nan=False)
    content = _HEAD + zlib.compress(text.encode(), 9)
    path.write_bytes(content)
    return hashlib.sha256(content).hexdigest()


def unseal(path: str | Path, sha256: str | None = None) -> list[dict[str, Any]]:
    """The labels of a sealed file.

    Args:
        path: the file.
        sha256: that it must have; None takes any.

    Raises:
        InputError: unreadable, no sealed labels, or not the ones that were sealed.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror}") from None
    if sha256 is not None and hashlib.sha256(content).hexdigest() != sha256:
        raise InputError(f"{path}: not the labels that the manifest names (sha256 differs)")
    try:
        if not content.startswith(_HEAD):
            raise ValueError("head")
        labels = json.loads(zlib.decompress(content[len(_HEAD) :]))
    except (ValueError, zlib.error):
        raise InputError(f"{path}: damaged, expected labels sealed by blind make") from None
    return list(labels)

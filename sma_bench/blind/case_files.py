"""Files of an examination: a set of cases, its sealed labels, and the answers that were given."""

import hashlib
import json
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sma_bench.blind.answers import Answer, checked_answer
from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically

# --- A set of cases as the examination sees it: folders and names, and labels that stay sealed.

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


# --- Labels under seal: one deflated file whose digest the manifest names.

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


# --- The folder of one examinee's answers: one folder a case, and who gave them to which set.
#
#     examination.json            program, time limit, sha256 of the set's sealed labels
#     0001/answer.json            {"case", "line", "seconds", "result"}: written last
#     0001/improved.yaml          the parameters with the cause in them
#     second/0001/                the same after the suggested experiment

ANSWER, IMPROVED, EXAMINATION, SECOND = (
    "answer.json", "improved.yaml", "examination.json", "second",
)  # fmt: skip


@dataclass(frozen=True)
class Kept:
    """One answer as it was given; `answer` is None where `line` says why it failed."""

    case: str
    answer: Answer | None
    line: str
    seconds: float
    improved: Path | None


@dataclass(frozen=True)
class Examination:
    """Who was examined on what.

    Attributes:
        name: how tables call the examinee.
        program: command line that takes the arguments of `sma-bench diagnose`.
        time_limit: s for one case.
        sealed: sha256 of the labels of the set.
    """

    name: str
    program: tuple[str, ...]
    time_limit: float
    sealed: str


def keep(
    folder: Path, case: str, result: Any, line: str, seconds: float, improved: str | None = None
) -> None:
    """Keep an answer (result None: failed, line says why); it is there once answer.json is.

    Args:
        folder: of the examinee; case: its name.
        result: plain document of the answer; improved: text of its parameter file.

    Raises:
        InputError: the folder cannot be written.
    """
    place = folder / case
    try:
        place.mkdir(parents=True, exist_ok=True)
        (place / IMPROVED).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{place}: cannot write: {error.strerror}") from None
    if improved is not None:
        write_text_atomically(place / IMPROVED, improved)
    document = {"case": case, "line": line, "seconds": round(seconds, 3), "result": result}
    write_text_atomically(place / ANSWER, json.dumps(document, indent=1) + "\n")


def is_kept(folder: Path, case: str) -> bool:
    """Whether the case has been answered, or has failed."""
    return (folder / case / ANSWER).is_file()


def read_kept(folder: Path, case: str) -> Kept:
    """The answer to a case.

    Raises:
        InputError: there is none, or its file is damaged.
    """
    path = folder / case / ANSWER
    document = _read(path)
    result, seconds = document.get("result"), document.get("seconds", math.nan)
    answer = None if result is None else checked_answer(result, str(path))
    improved = folder / case / IMPROVED
    return Kept(
        case, answer, document.get("line", ""), seconds, improved if improved.is_file() else None
    )


def write_examination(folder: Path, examination: Examination) -> None:
    """Begin a folder of answers, or go on with it.

    Raises:
        InputError: the folder holds answers to another set or of another program.
    """
    path = folder / EXAMINATION
    if path.is_file():
        there = read_examination(folder)
        if there.sealed != examination.sealed:
            raise InputError(f"{folder}: holds answers to another set of cases")
        # The interpreter may lie elsewhere by now.
        if (there.name, there.program[1:]) != (examination.name, examination.program[1:]):
            raise InputError(f"{folder}: holds the answers of {' '.join(there.program)}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from None
    write_text_atomically(path, json.dumps(vars(examination), indent=1) + "\n")


def read_examination(folder: Path) -> Examination:
    """Who gave the answers of a folder.

    Raises:
        InputError: nobody, or the file is damaged.
    """
    document = _read(folder / EXAMINATION)
    try:
        return Examination(
            document["name"],
            tuple(document["program"]),
            float(document["time_limit"]),
            document["sealed"],
        )
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{folder / EXAMINATION}: damaged") from None


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file: run sma-bench blind run first") from None
    except (OSError, ValueError, RecursionError):
        raise InputError(f"{path}: damaged") from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: damaged")
    return document

"""Safe input and output: data from outside are limited in bytes, depth and time.

Files, topics and bags may be hostile: read them by these functions, or with a Budget. Show names
from outside by `printable`; write files by `write_files`, which writes all or none."""

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import socket
import stat
import struct
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from sma_bench.errors import InputError, errors_in

MEGABYTE = 1 << 20
LARGEST_YAML = LARGEST_TOPIC = MEGABYTE  # the latter: JSON in one message
LONGEST_SHOWN, DEEPEST = 500, 64  # characters of a topic's text shown to users; levels of nesting
# Limits of unpacking a bag or table, in bytes and s: more than any recorder's files need.
_BYTES, _BYTES_OF_EACH = 64 * MEGABYTE, 64
_SECONDS, _SECONDS_OF_EACH = 5.0, 2.0 / MEGABYTE
_LOOK = 16 * 1024  # bytes between two checks of the time
_LARGEST_INTEGER = 2**63  # the range of ROS parameters and messages
_LONGEST_INTEGER, _LONGEST_REASON = 80, 150  # characters
_STILL_HELD = 2.0  # s that a process which is ending may still hold a name
_PEER = struct.Struct("3i")  # process, user and group at the other end of a socket
_IRREGULAR = "is a pipe, socket or device, expected a regular file"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_TELLING = (  # characters that are plausible in a logger's file, if decoded rightly
    r"(?<![^\W\d_])[°º](?= ?[CFKcfk]?(?:\W|\Z))|µ(?=[msVAeN])|[²³]|(?<=[0-9])\u00a0(?=[0-9]{3})"
    r"|(?<=[A-Za-z])[äöüßéèàçñíóúáùìòêîôâ]|[ÄÖÜÉ](?=[a-z])|[ぁ-んァ-ヶ一-龥]{2}|[！-～]"
)


class OverBudget(InputError):
    """An input exceeds the limits for its kind."""


class Budget:
    """Limits for unpacking one input: bytes, and s of this thread's CPU time."""

    def __init__(self, size: int, seconds: float) -> None:
        self.left = self.size = size
        self.seconds, self._until = seconds, time.thread_time() + seconds
        self._next = size - _LOOK

    def take(self, size: int) -> None:
        """Spend bytes. Raises OverBudget: not enough bytes left, or the time is over."""
        self.left -= size
        if self.left < 0:
            raise OverBudget(f"unfolds to more than {self.size / MEGABYTE:.0f} MB")
        if self.left <= self._next:
            self._next = self.left - _LOOK
            self.check()

    def check(self) -> None:
        """Raises OverBudget: the time is over."""
        if self.is_over():
            raise OverBudget(f"takes more than {self.seconds:.3g} s to read")

    def is_over(self) -> bool:
        return time.thread_time() > self._until


def reading_budget(size: int) -> Budget:
    """The budget for reading files of `size` bytes."""
    return Budget(_BYTES + _BYTES_OF_EACH * size, _SECONDS + _SECONDS_OF_EACH * size)


# --- files --------------------------------------------------------------------------------------

def read_bytes(path: str | Path, largest: int) -> bytes:
    """The content of a regular file (a pipe would block, a device never end). Raises InputError:
    unreadable, not a regular file, or larger than `largest` bytes."""
    with errors_in(f"{path}: cannot read"):
        if "\0" in str(path):
            raise InputError("no such file")
        with open(path, "rb", opener=lambda name, how: os.open(name, how | os.O_NONBLOCK)) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise InputError(_IRREGULAR)
            content = file.read(largest + 1)
    if len(content) > largest:
        raise InputError(f"{path}: larger than {largest} bytes, expected at most that")
    return content


def read_text(path: str | Path, largest: int) -> str:
    """The content of a UTF-8 file. Raises InputError as `read_bytes`, and if it is not text."""
    try:
        return read_bytes(path, largest).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file") from None


def decoded_lines(content: bytes, names: Sequence[str], known: Callable[[str], int]) -> list[str]:
    """Lines of a text, in that of the encodings `names` in which most is `known`, or which gives
    accents and degree signs. InputError: binary."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", "replace").splitlines()
    if b"\0" in content:
        raise InputError("holds zero bytes, expected text in UTF-8, or UTF-16 with byte-order mark")
    with contextlib.suppress(UnicodeDecodeError):
        return content.decode("utf-8-sig").splitlines()
    strange = dict.fromkeys(s for s in content[:400_000].splitlines() if not s.isascii())
    begun = {n: b"\n".join(strange).decode(n, "replace") for n in names}
    found = {n: (known(text), n in names[:4] and len(re.findall(_TELLING, text)))
             for n, text in begun.items()}
    return content.decode(max(names, key=lambda n: found[n]), "replace").splitlines()


def require_there(path: Path) -> None:
    """Raises InputError: there is neither a regular file nor a folder."""
    with errors_in(f"{path}: cannot be read"):
        is_there, is_regular = path.exists(), path.is_file() or path.is_dir()
    if not is_there:
        raise InputError(f"{path}: no such file or folder")
    if not is_regular:
        raise InputError(f"{path}: {_IRREGULAR}")


def is_inside(path: Path, folder: Path) -> bool:
    """True if a path lies in a folder, with all links and `..` in both resolved."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # no permission, a zero byte, a circle of links
        return False


# --- JSON and YAML ------------------------------------------------------------------------------

def read_json(text: str | bytes, where: str, largest: int = LARGEST_TOPIC) -> Any:
    """Parse JSON of a topic, a service or a file. `where` begins an error message; `largest`: in
    characters. Raises InputError: too long, not JSON, nested deeper than DEEPEST, a number that is
    not finite or an integer beyond 64 bits."""
    def integer(digits: str) -> int:
        if not -_LARGEST_INTEGER <= int(digits) < _LARGEST_INTEGER:
            raise ValueError(f"an integer of {len(digits)} digits, expected one of 64 bits")
        return int(digits)

    def finite(number: str) -> float:
        if not math.isfinite(float(number)):
            raise ValueError(f"the number {number:.20}, expected a finite one or null")
        return float(number)

    if len(text) > largest:
        raise InputError(f"{where}: {len(text)} characters, expected at most {largest}")
    try:
        document = json.loads(text, parse_int=integer, parse_float=finite, parse_constant=finite)
        json.dumps(document, ensure_ascii=False).encode()  # refuses lone surrogates
    except (ValueError, RecursionError) as error:
        reason = printable(" ".join(str(error).split()))[:_LONGEST_REASON]
        raise InputError(f"{where}: not JSON: {reason}") from None
    level = [[document]]
    for _ in range(DEEPEST + 1):
        found = [child for node in level for child in node if isinstance(child, (dict, list))]
        level = [list(child.values()) if isinstance(child, dict) else child for child in found]
    if level:
        raise InputError(f"{where}: nested deeper than {DEEPEST} levels")
    return document


# Kinds of fields of a JSON object on a topic.
TEXT, NUMBER, NUMBER_OR_NULL, COUNTS = "a text", "a number", "a number or null", "counts by name"
AN_OBJECT, A_LIST = "an object", "a list"
_KINDS = {dict: AN_OBJECT, list: A_LIST, str: TEXT, bool: "true or false", type(None): "null"}


def read_json_object(text: str | bytes, where: str) -> dict[str, Any]:
    """As `read_json`, for a text that must be a JSON object."""
    document = read_json(text, where)
    if not isinstance(document, dict):
        raise InputError(f"{where}: {_KINDS.get(type(document), NUMBER)}, expected a JSON object")
    return document


def read_fields(text: str, fields: Mapping[str, str], where: str) -> dict[str, Any]:
    """Required fields of a JSON object. InputError: not an object, a field is missing or wrong."""
    document = read_json_object(text, where)
    for name, kind in fields.items():
        if name not in document:
            raise InputError(f"{where}: {name} is missing")
        value = document[name]
        found = _KINDS.get(type(value), NUMBER)
        counts = isinstance(value, dict) and all(type(count) is int for count in value.values())
        if found not in kind and not (kind == COUNTS and counts):
            raise InputError(f"{where}: {name} is {found}, expected {kind}")
    return {name: document[name] for name in fields}


class _Loader(yaml.CSafeLoader):
    """YAML as ROS reads it: 1e-4 is a number, launch_ros's type names pass, merge keys do not."""

    def flatten_mapping(self, node: Any) -> None:
        keys = set()
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                raise _refusal("merge keys (<<) are not supported", key)
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise _refusal(f"{key.value} stands twice", key)
            keys.add(key.value if isinstance(key, yaml.ScalarNode) else None)

    def integer(self, node: Any) -> int:
        if len(node.value) > _LONGEST_INTEGER:
            raise _refusal(f"an integer of {len(node.value)} digits", node)
        number = int(self.construct_yaml_int(node))
        if not -_LARGEST_INTEGER <= number < _LARGEST_INTEGER:
            raise _refusal("an integer of more than 64 bits", node)
        return number

    def text(self, node: Any) -> str:
        found = str(self.construct_scalar(node))
        if any("\ud800" <= letter <= "\udfff" for letter in found):
            raise _refusal("half a character (a lone surrogate)", node)
        return found


def _refusal(problem: str, node: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(None, None, problem, node.start_mark)


_FLOAT = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.integer)
_Loader.add_constructor("tag:yaml.org,2002:str", _Loader.text)
_Loader.add_constructor("tag:yaml.org,2002:value", _Loader.text)  # a plain =
_Loader.add_constructor("tag:yaml.org,2002:python/tuple", _Loader.construct_yaml_seq)
# PyYAML's constructors of dates, sets and numbers raise these on unexpected text.
_WRONG_YAML = (yaml.YAMLError, ValueError, RecursionError, TypeError, LookupError, AttributeError)


def load_yaml(text: str, aliases: bool = False) -> Any:
    """Parse YAML as ROS does. With `aliases`, a kilobyte can expand to gigabytes: check
    types before you walk through it. InputError (no file name): not YAML, too long or too deep."""
    if len(text) > LARGEST_YAML:
        raise InputError(f"{len(text)} characters, expected at most {LARGEST_YAML}")
    try:
        depth = 0  # the C parser recurses, and a stack overflow would end the process
        for event in yaml.parse(text, Loader=yaml.CSafeLoader):
            if isinstance(event, yaml.AliasEvent) and not aliases:
                raise _refusal("aliases (*name) are not supported", event)
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise _refusal(f"nested deeper than {DEEPEST} levels", event)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 (a safe loader)
    except _WRONG_YAML as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1} " if mark else ""
        problem = getattr(error, "problem", None) or (str(error).splitlines() or ["?"])[0]
        raise InputError(f"{line}not YAML: {printable(problem)[:_LONGEST_REASON]}") from None


def read_yaml(path: str | Path, aliases: bool = False) -> Any:
    """The parsed content of a YAML file, as `load_yaml`. InputError: unreadable or not YAML."""
    text = read_text(path, LARGEST_YAML)
    with errors_in(str(path)):
        content = load_yaml(text, aliases)
    return content


# --- names and files on their way out ------------------------------------------------------------

def printable(text: str, keep: str = "") -> str:
    r"""Text that is safe in terminals and files: unprintable characters, except `keep`, escaped."""
    if text.isprintable():
        return text
    hidden = {letter for letter in text if not letter.isprintable()} - set(keep)
    return text.translate({ord(c): c.encode("unicode_escape").decode("ascii") for c in hidden})


def shown(text: str, longest: int = LONGEST_SHOWN) -> str:
    """Text of a topic for users: in one line, of limited length."""
    line = printable(" ".join(text[: 2 * longest].split()))
    return line if len(line) <= longest else f"{line[:longest]}…"


def csv_cell(text: str) -> str:
    """Text for a spreadsheet: an apostrophe is put before text that could be run as a formula."""
    text = printable(text)
    with contextlib.suppress(ValueError):
        float(text)
        return text
    return f"'{text}" if text.startswith(_FORMULA) else text


def make_folder(folder: Path) -> Path:
    """Create a folder, with parents, if it does not exist. InputError: it cannot be created."""
    with errors_in(f"{folder}: cannot be made"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def claimed(name: str, problem: str = "") -> socket.socket:
    """Claim a name on this machine until the socket is closed or the process ends. Names are
    separate for each ROS domain, or for each `problem`, which is also the error message. Waits a
    moment for a process that is ending. InputError: this or another process holds the name."""
    problem = problem or f"there already in ROS domain {os.environ.get('ROS_DOMAIN_ID') or '0'}"
    named = hashlib.sha1(f"{problem}/{name}".encode("utf-8", "surrogateescape"))
    address = f"\0sma_bench/{named.hexdigest()}"
    end = time.monotonic() + _STILL_HELD
    while True:
        held = socket.socket(socket.AF_UNIX)
        try:
            held.bind(address)
            held.listen()
            return held
        except OSError:
            held.close()
        if time.monotonic() > end:
            holder = "unknown"
            with socket.socket(socket.AF_UNIX) as asking, contextlib.suppress(OSError):
                asking.connect(address)
                peer = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
                holder = str(_PEER.unpack(peer)[0])
            raise InputError(f"{name} is {problem}: process {holder}")
        time.sleep(0.05)


def write_files(files: Mapping[Path, bytes]) -> None:
    """Write all files or none. A file that is replaced keeps its mode, and a link stays a link.
    Raises OSError: a folder cannot be written, or something other than a file has the name."""
    def beside(target: Path, content: bytes, mode: int) -> Path:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=".sma_bench.")
        staged.callback(Path(name).unlink, missing_ok=True)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(name, mode)
        return Path(name)

    umask = os.umask(0)
    os.umask(umask)
    new, old = dict[Path, Path](), dict[Path, Path]()
    with contextlib.ExitStack() as staged, contextlib.ExitStack() as undo:
        for path, content in files.items():
            target = Path(os.path.realpath(path))
            mode = target.stat().st_mode if target.exists() else stat.S_IFREG | 0o666 & ~umask
            if not stat.S_ISREG(mode):
                raise OSError(0, "something other than a file has this name")
            new[target] = beside(target, content, stat.S_IMODE(mode))
            if target.exists() and len(files) > 1:
                old[target] = beside(target, b"", 0o600)
                shutil.copy2(target, old[target])
        for target, source in new.items():
            os.replace(source, target)
            undo.callback(old[target].replace if target in old else Path.unlink, target)
        undo.pop_all()

"""Compile with numba where it is installed; run the same code as plain Python where it is not, and
in a node until it is compiled: a bench that has just been installed answers at once.
"""

import fcntl
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

from sma_bench.lifeline import tied_to_this_process

try:
    import numba
except ImportError:
    numba = None

COMPILES = numba is not None
PACKAGE = Path(__file__).resolve().parent

_turns: set[Path] = set()
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


@cache
def warn_if_plain() -> None:
    """A warning, once a process, where simulations run without numba."""
    if numba is None:
        warnings.warn(
            "numba is not installed: simulations run as plain Python, a hundred times slower",
            RuntimeWarning,
            stacklevel=3,
        )


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call and cache the machine code on disk.

    The GIL is let go while it runs, so threads simulate side by side.
    """
    return _cached(function, _OPTIONS)


def borrowing(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, for a function that allocates nothing: it does not count references.

    Its caller holds all arrays. Where named tuples of arrays go from function to function, the
    counting takes several times as long as the arithmetic.
    """
    return _cached(function, {**_OPTIONS, "_nrt": False})


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` into the `borrowing` functions that call it."""
    if numba is None:
        return function
    return numba.njit(function, **_OPTIONS, _nrt=False, forceinline=True)


def is_compiled(function: Callable[..., Any]) -> bool:
    """Whether machine code of a compiled function is on the disk; that of the physics takes half a
    minute, once after an installation. Without numba there is nothing to wait for."""
    if numba is None:
        return True
    source = getattr(function, "py_func", function)
    folder = _cache_folder(_room(Path(source.__code__.co_filename).resolve()))
    module = source.__module__.rpartition(".")[2]
    return folder is not None and any(folder.rglob(f"{module}.{source.__name__}-*.nbi"))


class Meanwhile:
    """A compiled function as Python calls it. After `run_plain_meanwhile` a call without machine
    code yet runs as plain Python, to the same result, while another process compiles.

    Whatever a node calls, and takes long to compile, is called through one of these.
    """

    notify: Callable[[str], None] | None = None
    """gets what there is to say; None: whoever calls waits for the compiler"""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function: Any = function
        self._call: Callable[..., Any] = function
        self._begun = False

    def __call__(self, *arguments: Any) -> Any:
        """As the function."""
        if Meanwhile.notify is None or numba is None:
            return self.function(*arguments)
        if not self._begun:
            self._begun = True
            self._begin(tuple(map(numba.typeof, arguments)), Meanwhile.notify)
        return self._call(*arguments)

    def _begin(self, signature: tuple[Any, ...], notify: Callable[[str], None]) -> None:
        if signature in self.function.overloads or _on_disk(self.function, signature):
            return
        notify("compiling beside, once after an installation; slower until then")
        self._call = _quietly(plain(self.function))
        work = threading.Thread(target=self._compile, args=(signature, notify), daemon=True)
        work.start()

    def _compile(self, signature: tuple[Any, ...], notify: Callable[[str], None]) -> None:
        """Another process, as the compiler holds Python's lock; then its machine code is read."""
        name = self.function.__module__, self.function.__name__
        with suppress(OSError):
            subprocess.run(
                [sys.executable, "-P", "-c", _OTHER_PROCESS], check=False,
                input=json.dumps([*name, *map(_described, signature)]), text=True,
                env=tied_to_this_process(), start_new_session=True,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        self.function.compile(signature)
        self._call = self.function
        notify("compiled")


def run_plain_meanwhile(notify: Callable[[str], None]) -> None:
    """From now on this process does not wait for the compiler; `notify` gets a line about it."""
    Meanwhile.notify = notify


@cache
def plain(function: Any) -> Callable[..., Any]:
    """A compiled function as plain Python, with all that it calls."""
    source = function.py_func
    names = dict(source.__globals__)
    for name in source.__code__.co_names:
        if hasattr(names.get(name), "py_func"):
            names[name] = plain(names[name])
    return FunctionType(source.__code__, names, source.__name__, source.__defaults__)


def _quietly(function: Callable[..., Any]) -> Callable[..., Any]:
    """Without the warnings of a division by zero, which compiled code has none of."""
    import numpy as np

    def call(*arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*arguments)

    return call


def _on_disk(function: Any, signature: tuple[Any, ...]) -> bool:
    """Whether the machine code of these types can be read; False where numba does not tell."""
    with suppress(Exception):  # numba's own affairs, which may change
        stored, target = function._cache, function.targetctx
        key = stored._index_key(signature, target.codegen())
        return key in stored._cache_file._load_index()
    return False


def _described(kind: Any) -> list[Any]:
    """A type of numba in words: its name, and of an array its dimensions, layout and mutability."""
    if isinstance(kind, numba.types.Array):
        return [str(kind.dtype), kind.ndim, kind.layout, not kind.mutable]
    return [str(kind)]


def _type_of(described: list[Any]) -> Any:
    name, *array = described
    kind = getattr(numba.types, name)
    return numba.types.Array(kind, *array) if array else kind


# Tied before numba is imported, which takes a second in which the node may end.
_OTHER_PROCESS = (
    "from sma_bench.lifeline import end_with_parent; end_with_parent(); "
    "from sma_bench.compiled import compile_here; compile_here()"
)


def compile_here() -> None:
    """The other process: what its standard input names is compiled, and kept on the disk."""
    if hasattr(os, "sched_setscheduler"):
        # The child of a node that has real-time priority inherits it, and has no hurry.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(5)
    module, name, *described = json.load(sys.stdin)
    function = getattr(import_module(module), name)
    signature = tuple(map(_type_of, described))
    folder = _cache_folder(_room(Path(function.py_func.__code__.co_filename).resolve()))
    if folder is not None:  # else nothing could be kept
        function.compile(signature)


def when_compiling(notify: Callable[[], None]) -> Any:
    """Have `notify` called whenever this process begins to compile a function; numba's listener."""
    if numba is None:
        return None
    from numba.core import event

    class Notified(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            notify()

        def on_end(self, _: Any) -> None:
            pass

    listener = Notified()
    event.register("numba:compile", listener)
    return listener


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    if numba is None:
        return function
    folder = _cache_folder(_room(Path(function.__code__.co_filename).resolve()))
    if folder is None:
        return numba.njit(function, **options)
    with _cached_in(folder):
        return _compiled_once(numba.njit(function, cache=True, **options), folder)


def _compiled_once(function: Any, folder: Path) -> Any:
    """Of several processes that need a function one compiles; the others then read what it kept."""
    compile_it = function.compile

    def compile_in_turn(signature: Any) -> Any:
        if signature in function.overloads or _on_disk(function, signature):
            return compile_it(signature)
        with _turn(folder):
            return compile_it(signature)

    function.compile = compile_in_turn
    return function


@contextmanager
def _turn(folder: Path) -> Iterator[None]:
    """The compiler's own lock first: who has it may come here again, for what a function calls."""
    from numba.core.compiler_lock import global_compiler_lock

    with global_compiler_lock:
        if folder in _turns:
            yield
            return
        with open(folder / "compiling", "wb") as turn:
            fcntl.flock(turn, fcntl.LOCK_EX)
            _turns.add(folder)
            try:
                yield
            finally:
                _turns.discard(folder)


def _room(source: Path) -> Path:
    """The folder right below the package in which a source file lies; elsewhere, its own."""
    if not source.is_relative_to(PACKAGE):
        return source.parent
    inside = source.relative_to(PACKAGE).parts
    return PACKAGE / inside[0] if len(inside) > 1 else PACKAGE


@cache
def _cache_folder(room: Path) -> Path | None:
    """Where a room's machine code lies: numba notices changes of a function's own file only, so
    the name holds a digest of every file of the room. None where nothing can be written."""
    digest = hashlib.sha256()
    for path in sorted(room.rglob("*.py")):
        digest.update(path.read_bytes())
    name = f"{room.name}-{digest.hexdigest()[:16]}"
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for parent in (room / "__pycache__", user / "sma_bench"):
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


@contextmanager
def _cached_in(folder: Path) -> Iterator[None]:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before

"""Compile with numba where it is installed; the same code runs as plain Python where it is not."""

import fcntl
import hashlib
import os
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, TypeVar

try:
    import numba

    if numba.config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1, for a debugger
        numba = None
except ImportError:
    numba = None

PHYSICS = Path(__file__).resolve().parent / "physics"

T = TypeVar("T")

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_listeners: list[Callable[[], None]] = []
_turns: set[Path] = set()


@cache
def warn_if_plain() -> None:
    """A warning, once a process, where simulations run without numba."""
    if numba is None:
        slow = "simulations run as plain Python, a hundred times slower"
        warnings.warn(f"numba is not installed: {slow}", RuntimeWarning, stacklevel=3)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call and cache the machine code on disk. It lets go of the
    GIL while it runs, so threads simulate side by side."""
    return _cached(function, _OPTIONS)


def borrowing(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, for a function that allocates nothing: it does not count references, as its
    caller holds all arrays. Where named tuples of arrays go from function to function, the counting
    takes several times as long as the arithmetic."""
    return _cached(function, {**_OPTIONS, "_nrt": False})


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` into the `borrowing` functions that call it."""
    if numba is None:
        return function
    return numba.njit(function, **_OPTIONS, _nrt=False, forceinline=True)


def is_compiled(function: Callable[..., Any]) -> bool:
    """Whether machine code of a compiled function is on the disk; that of the physics takes 20 s,
    once after an installation. Without numba there is nothing to wait for."""
    if numba is None:
        return True
    source = getattr(function, "py_func", function)
    folder = _cache_folder(_room(source))
    module = source.__module__.rpartition(".")[2]
    files = f"{module}.{source.__name__}-*.py{sys.version_info[0]}{sys.version_info[1]}.nbi"
    return folder is not None and any(folder.rglob(files))


def load_aside(function: Callable[..., Any], use: Callable[[], None]) -> None:
    """Have machine code of a compiled function that is on the disk read in a thread, by a `use` of
    it: 0.2 s for the physics, most of them without the interpreter's lock, while files are read."""
    if is_compiled(function):
        threading.Thread(target=use).start()


def when_compiling(notify: Callable[[], None]) -> None:
    """Have `notify` called once, when this process first compiles, or waits for one that does."""
    _listeners.append(notify)


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    if numba is None:
        return function
    folder = _cache_folder(_room(function))
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder or "")
    try:
        dispatcher = numba.njit(function, cache=folder is not None, **options)
    finally:
        numba.config.CACHE_DIR = before
    compile_it = dispatcher.compile
    # Of several processes that need a function one compiles, the others then read what it kept.
    def compile_in_turn(signature: Any) -> Any:
        if signature in dispatcher.overloads or is_compiled(function):
            return compile_it(signature)
        with _turn(folder):
            return compile_it(signature)

    dispatcher.compile = compile_in_turn
    return dispatcher


@contextmanager
def _turn(folder: Path | None) -> Iterator[None]:
    """The compiler's own lock first: who has it may come here again, for what a function calls."""
    from numba.core.compiler_lock import global_compiler_lock

    with global_compiler_lock:
        while _listeners:
            _listeners.pop()()
        if folder is None or folder in _turns:
            yield
            return
        with open(folder / "compiling", "wb") as turn:
            fcntl.flock(turn, fcntl.LOCK_EX)
            _turns.add(folder)
            try:
                yield
            finally:
                _turns.discard(folder)


def _room(function: Callable[..., Any]) -> Path:
    """The folder whose files a compiled function may be made of: all of the physics, or its own."""
    source = Path(function.__code__.co_filename).resolve()
    return PHYSICS if source.is_relative_to(PHYSICS) else source.parent


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


# --- Work side by side in threads: the compiled core lets go of the interpreter's lock, and most of
# a fit is the core's. Two run at a time, whatever calls whatever: work that is divided within one
# thread gets the other as soon as that has nothing to do.

_THREADS = 2
_helpers = threading.Semaphore(_THREADS - 1)  # that are free; who only waits lends its own place
# s, for which a thread may keep the interpreter from one that comes back from the core after some
# tenths of a millisecond; Python's own is 5 ms.
_SWITCH = 2e-4


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results in the order of the arguments, the first error raised."""
    if len(arguments) < 2 or not threads_to_spare() or not _helpers.acquire(blocking=False):
        return [function(*args) for args in arguments]
    waiting = iter(range(len(arguments)))
    found: dict[int, T] = {}
    faults: dict[int, BaseException] = {}

    def work() -> None:
        for k in waiting:
            try:
                found[k] = function(*arguments[k])
            except BaseException as fault:
                faults[k] = fault
                for _ in waiting:  # nothing more is begun
                    pass
        _helpers.release()

    before = sys.getswitchinterval()
    sys.setswitchinterval(min(_SWITCH, before))
    try:
        helper = threading.Thread(target=work)
        helper.start()
        work()
        try:
            helper.join()
        finally:
            _helpers.acquire()
    finally:
        sys.setswitchinterval(before)
    if faults:
        raise faults[min(faults)]
    return [found[k] for k in range(len(arguments))]


def threads_to_spare() -> int:
    """How many run side by side; none in a pool, which has all cores."""
    alone = parent_process() is not None or os.environ.get("NUMBA_NUM_THREADS") == "1"
    return 0 if alone else _THREADS

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
    """Warn once per process that simulations run without numba."""
    if numba is None:
        slow = "simulations run as plain Python, a hundred times slower"
        warnings.warn(f"numba is not installed: {slow}", RuntimeWarning, stacklevel=3)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call and cache the machine code on disk. It releases the GIL
    while it runs, so that threads run in parallel."""
    return _cached(function, _OPTIONS)


def borrowing(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `compiled`, without reference counting, for a function that allocates nothing and whose
    caller keeps all arrays alive. With named tuples of arrays as arguments, counting would take
    several times as long as the arithmetic."""
    return _cached(function, {**_OPTIONS, "_nrt": False})


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Inline `function` into the `borrowing` functions that call it."""
    if numba is None:
        return function
    return numba.njit(function, **_OPTIONS, _nrt=False, forceinline=True)


def is_compiled(function: Callable[..., Any]) -> bool:
    """True if machine code of a compiled function is on disk, or there is no numba. Compiling the
    physics takes 20 s, once after an installation."""
    if numba is None:
        return True
    source = getattr(function, "py_func", function)
    folder = _cache_folder(_room(source))
    module = source.__module__.rpartition(".")[2]
    files = f"{module}.{source.__name__}-*.py{sys.version_info[0]}{sys.version_info[1]}.nbi"
    return folder is not None and any(folder.rglob(files))


def load_aside(function: Callable[..., Any], use: Callable[[], None]) -> None:
    """Load machine code of a compiled function from disk in a thread, by calling `use`: 0.2 s for
    the physics, mostly without the GIL, so that files can be read meanwhile."""
    if is_compiled(function):
        threading.Thread(target=use).start()


def when_compiling(notify: Callable[[], None]) -> None:
    """Call `notify` once, when this process first compiles or waits for another that does."""
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
    # If several processes need a function, one compiles it, the others wait and load its code.
    def compile_in_turn(signature: Any) -> Any:
        if signature in dispatcher.overloads or is_compiled(function):
            return compile_it(signature)
        with _turn(folder):
            return compile_it(signature)

    dispatcher.compile = compile_in_turn
    return dispatcher


@contextmanager
def _turn(folder: Path | None) -> Iterator[None]:
    """This process's turn to compile. Takes numba's lock first, because a compiling function comes
    here again for each function that it calls."""
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
    """The folder with all sources of a compiled function: the physics, or its own folder."""
    source = Path(function.__code__.co_filename).resolve()
    return PHYSICS if source.is_relative_to(PHYSICS) else source.parent


@cache
def _cache_folder(room: Path) -> Path | None:
    """Folder for the machine code of the sources in `room`. Its name contains a digest of them all:
    numba notices changes of a function's own file only. None if no folder can be written."""
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


# --- Work in parallel threads: the compiled core releases the GIL, and most of a fit runs in it.
# There are two threads in all, also if `in_threads` is called within `in_threads`: an inner call
# uses the helper thread if that is free.

_THREADS = 2
_helpers = threading.Semaphore(_THREADS - 1)  # free helpers; a waiting caller counts as free
# s, after which a thread yields the GIL. A call of the core takes some 0.1 ms; with Python's 5 ms,
# the thread that returns from it would wait far too long for the other.
_SWITCH = 2e-4


def in_threads(function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
    """Results of `function` for each of the arguments, in their order. Raises the first error."""
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
                for _ in waiting:  # start no further calls
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
    """Number of threads; 0 with NUMBA_NUM_THREADS=1, which joblib sets in the processes of a pool
    that uses all cores already."""
    return 0 if os.environ.get("NUMBA_NUM_THREADS") == "1" else _THREADS

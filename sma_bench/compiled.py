"""Compile with numba where it is installed; run the same code as plain Python where it is not."""

import hashlib
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

try:
    import numba
except ImportError:
    numba = None

COMPILES = numba is not None
PACKAGE = Path(__file__).resolve().parent

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


def is_compiled(room: str) -> bool:
    """Whether machine code of a room (`physics`) is on the disk; compiling it takes half a minute,
    once after an installation. Without numba there is nothing to wait for."""
    if numba is None:
        return True
    folder = _cache_folder(PACKAGE / room)
    return folder is not None and any(folder.rglob("*.nbi"))


def when_compiling(told: Callable[[], None]) -> Any:
    """Have `told` called whenever this process begins to compile a function; numba's listener."""
    if numba is None:
        return None
    from numba.core import event

    class Told(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            told()

        def on_end(self, _: Any) -> None:
            pass

    listener = Told()
    event.register("numba:compile", listener)
    return listener


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    if numba is None:
        return function
    folder = _cache_folder(_room(Path(function.__code__.co_filename).resolve()))
    if folder is None:
        return numba.njit(function, **options)
    with _cached_in(folder):
        return numba.njit(function, cache=True, **options)


def _room(source: Path) -> Path:
    """The folder right below the package in which a source file lies."""
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

"""Compile with numba where it is installed; run the same code as plain Python where it is not."""

import warnings
from collections.abc import Callable
from typing import Any

try:
    import numba
except ImportError:
    numba = None
    warnings.warn(
        "numba is not installed: simulations run as plain Python, a hundred times slower",
        RuntimeWarning,
        stacklevel=2,
    )


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` at its first call and cache the machine code on disk."""
    if numba is None:
        return function
    options = {"error_model": "numpy"}
    try:
        return numba.njit(function, cache=True, **options)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written
        return numba.njit(function, **options)

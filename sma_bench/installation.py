"""Which version this is, where its shared files (config/, launch/) are installed, and what its own
processes ask of the libraries."""

import os
import sys
from pathlib import Path

from sma_bench.errors import InputError

PACKAGE = "sma_bench"
VERSION = "0.1.0"
_BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_blas_thread() -> None:
    """To be called before numpy is imported. The matrices of a fit are small: BLAS threads that
    wait for each other nearly double the time of a diagnosis."""
    for variable in _BLAS_THREADS:
        os.environ.setdefault(variable, "1")


def share_directory() -> Path:
    """Folder that holds config/ and launch/.

    Looked for in this order: the source tree (a checkout, an editable or a symlinked install),
    every prefix of AMENT_PREFIX_PATH (a colcon install), and sys.prefix (pip install).

    Raises InputError: no such folder in any of them.
    """
    candidates = [Path(__file__).resolve().parents[1]]
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates += [Path(prefix) / "share" / PACKAGE for prefix in [*prefixes, sys.prefix]]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise InputError(f"share folder of {PACKAGE}: config/ not found in {looked}")

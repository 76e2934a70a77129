"""The version, the folder of the installed shared files (config/, launch/), and one setting of the
numerical libraries."""

import os
import sys
from pathlib import Path

from sma_bench.errors import InputError

PACKAGE = "sma_bench"
VERSION = "0.1.0"


def one_blas_thread() -> None:
    """Use one BLAS thread; call it before numpy is imported. The matrices of a fit are small, and
    threads that wait for each other nearly double the time of a diagnosis."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


def share_directory() -> Path:
    """Folder with config/ and launch/: the source tree (a checkout, an editable or a symlinked
    install), else the first in AMENT_PREFIX_PATH (a colcon install), else below sys.prefix (pip
    install). Raises InputError: it is in none of them."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates = [Path(__file__).resolve().parents[1]]
    candidates += [Path(prefix) / "share" / PACKAGE for prefix in [*prefixes, sys.prefix]]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    looked = ", ".join(map(str, candidates))
    raise InputError(f"share folder of {PACKAGE}: config/ not found in {looked}")

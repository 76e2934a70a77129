"""Which version this is, where its shared files (config/, launch/) are installed, and what its own
processes ask of the libraries."""

import os
import sys
from pathlib import Path

from sma_bench.errors import InputError

PACKAGE = "sma_bench"
VERSION = "0.1.0"


def one_blas_thread() -> None:
    """To be called before numpy is imported. The matrices of a fit are small: BLAS threads that
    wait for each other nearly double the time of a diagnosis."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


def share_directory() -> Path:
    """Folder that holds config/ and launch/: of the source tree (a checkout, an editable or a
    symlinked install), else of the first prefix in AMENT_PREFIX_PATH that has it (a colcon
    install), else of sys.prefix (pip install). Raises InputError: no such folder in any of them."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    candidates = [Path(__file__).resolve().parents[1]]
    candidates += [Path(prefix) / "share" / PACKAGE for prefix in [*prefixes, sys.prefix]]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    looked = ", ".join(map(str, candidates))
    raise InputError(f"share folder of {PACKAGE}: config/ not found in {looked}")

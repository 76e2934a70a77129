"""Compiles the firmware for the Uno and the emulator for this computer.

simavr is GPL-3: its shim is built where it is used, and no binary of it is shipped.
"""

import shutil
import subprocess
from pathlib import Path

from sma_bench.emulation.emulated_uno import EmulatedUno
from sma_bench.errors import InputError
from sma_bench.share import share_directory

HERE = Path(__file__).resolve().parent
_INCLUDE = Path("/usr/include")
_PROGRAMS = {
    "avr-gcc": "gcc-avr",
    "avr-size": "binutils-avr",
    "make": "make",
    "cc": "gcc",
}
_HEADERS = {
    "simavr/sim_avr.h": "libsimavr-dev",
    "libelf.h": "libelf-dev",
    "../lib/avr/include/avr/io.h": "avr-libc",
}


def missing_tools() -> str:
    """What the emulated Uno lacks on this computer, with Debian's names; "" for nothing."""
    packages = [package for name, package in _PROGRAMS.items() if shutil.which(name) is None]
    packages += [package for name, package in _HEADERS.items() if not (_INCLUDE / name).exists()]
    if not packages:
        return ""
    return f"the emulated Uno needs the Debian packages {' '.join(packages)}"


def build_uno(folder: Path) -> EmulatedUno:
    """An Uno with the real firmware, just powered up; its binaries go to `folder`.

    Raises:
        InputError: a tool is missing, or does not compile it.
    """
    if missing := missing_tools():
        raise InputError(missing)
    return EmulatedUno(build_emulator(folder), build_firmware(folder))


def build_firmware(folder: Path, config: str = "") -> Path:
    """The firmware's image (.elf) as `make` builds it, budgets included, in `folder`.

    Raises:
        InputError: it does not compile, or outgrows its budget.
    """
    source = share_directory() / "firmware"
    _run(["make", "-s", "-C", str(source), f"BUILD={folder.resolve()}", f"CONFIG={config}"])
    return folder / "firmware.elf"


def build_emulator(folder: Path) -> Path:
    """The shared library of uno.c in `folder`.

    Raises:
        InputError: it does not compile.
    """
    library = folder / "uno.so"
    _run(
        ["cc", "-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared",
         "-isystem", str(_INCLUDE / "simavr"), "-o", str(library), str(HERE / "uno.c"),
         "-lsimavr", "-lelf", "-lm"],
    )
    return library


def _run(command: list[str]) -> None:
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode:
        said = (process.stderr or process.stdout).strip().splitlines() or ["no reason given"]
        raise InputError(f"{command[0]}: {said[0]}")

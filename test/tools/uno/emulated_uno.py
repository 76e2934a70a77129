"""An emulated Uno that runs the real firmware image, in virtual time.

The processor is that of simavr, wrapped by uno.c, which also simulates the electrics at the pins.
"""

import ctypes
import math
import shutil
import subprocess
from enum import IntEnum
from pathlib import Path

from sma_bench.errors import InputError
from sma_bench.installation import share_directory

CHANNELS = 4
START_UP = 5.96e-3
"""s from the first power-up until the firmware's clock runs: it looks at all of its memory, and the
second byte of its count of starts waits for the first"""
_CHUNK = 4096
_FOUR = ctypes.c_double * CHANNELS
_TWO = ctypes.c_double * 2


class Switch(IntEnum):
    """Behaviour of a channel's transistor."""

    SOUND = 0
    STUCK_ON = 1
    INVERTED = 2


class Relay(IntEnum):
    """Behaviour of the main relay's contact."""

    FOLLOWS = 0
    WELDED = 1
    HELD_OPEN = 2


class Reset(IntEnum):
    """Cause of a reset: bits of the register MCUSR."""

    POWER_ON = 1
    PIN = 2


_LAYOUT = (
    ("supply supply_resistance supply_limit", ctypes.c_double), ("resistance", _FOUR),
    ("volts_per_ampere", _TWO), ("clipping", ctypes.c_double), ("offset", _TWO),
    ("filter_time", ctypes.c_double), ("range_voltage", _TWO),
    ("noise divider divider_time reference bandgap relay_time bootloader_time", ctypes.c_double),
    ("switch_is", ctypes.c_int32 * CHANNELS), ("relay_is lost_bytes", ctypes.c_int32),
    ("on_time wire_time square_time", _FOUR), ("time started longest_blocked", ctypes.c_double),
)  # fmt: skip


_FIELDS = tuple((name, kind) for names, kind in _LAYOUT for name in names.split())
# Four wires, a 12 V supply, a relay, ACS712-20A sensors, range sensors at 1.5 V (SI units).
NOMINAL = {
    "supply": 12.0, "supply_limit": math.inf, "resistance": (2.7,) * CHANNELS,
    "volts_per_ampere": (0.1, 0.1), "filter_time": 0.5e-3, "range_voltage": (1.5, 1.5),
    "clipping": 25.0,  # where its output reaches its supply, at 100 mV/A
    "noise": 2e-3, "divider": 4.0, "divider_time": 0.75e-6, "reference": 5.0, "bandgap": 1.1,
    "relay_time": 10e-3,
}  # fmt: skip


class Electrics(ctypes.Structure):
    """Electrics at the pins; the fields mirror `struct electrics` of uno.c."""

    _fields_ = _FIELDS


class EmulatedUno:
    """One board: bytes in, bytes out, and `electrics` at its pins (SI units)."""

    def __init__(self, library: Path, image: Path, seed: int = 1) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.uno_new.restype = ctypes.c_void_p
        self._library.uno_new.argtypes = [ctypes.c_char_p, ctypes.c_uint64]
        self._library.uno_electrics.restype = ctypes.POINTER(Electrics)
        for name, kinds in {
            "electrics": (), "run": (ctypes.c_double,), "hang": (ctypes.c_int,),
            "write": (ctypes.c_char_p, ctypes.c_uint32), "reset": (ctypes.c_uint8,),
            "read": (ctypes.c_char_p, ctypes.c_uint32), "is_storing": (),
            "poke": (ctypes.c_uint16, ctypes.c_uint8),
        }.items():  # fmt: skip
            getattr(self._library, f"uno_{name}").argtypes = [ctypes.c_void_p, *kinds]
        self._uno = self._library.uno_new(str(image).encode(), seed)
        if not self._uno:
            raise RuntimeError(f"{image}: not an image that the emulator can load")
        self._buffer = ctypes.create_string_buffer(_CHUNK)
        self.electrics = self._library.uno_electrics(self._uno).contents
        for name, value in NOMINAL.items():
            many = isinstance(value, tuple)
            setattr(self.electrics, name, dict(_FIELDS)[name](*value) if many else value)

    @property
    def time(self) -> float:
        """Virtual time in s since power-up."""
        return self.electrics.time

    def run(self, seconds: float) -> None:
        """Advance virtual time until the processor has finished its current work: up to 0.1 ms
        more, by which the next run is shorter."""
        if not self._library.uno_run(self._uno, seconds):
            raise RuntimeError("the emulated processor gave up")

    def write(self, data: bytes) -> None:
        """Send bytes to the board's serial port, at its baud rate."""
        self._library.uno_write(self._uno, data, len(data))

    def read(self) -> bytes:
        """Bytes that the board sent since the last call."""
        received = b""
        while count := self._library.uno_read(self._uno, self._buffer, _CHUNK):
            received += self._buffer.raw[:count]
        return received

    def hang(self, interrupts: bool) -> None:
        """Hang the program in an endless loop, with interrupts on or off."""
        self._library.uno_hang(self._uno, int(interrupts))

    def reset(self, why: Reset = Reset.PIN) -> None:
        """Restart: pins float, the bootloader waits `electrics.bootloader_time`, then the program
        starts. Opening the port causes this by the reset pin. At power-on, memory is lost, too, and
        a byte that was being written to the EEPROM gets a random value."""
        self._library.uno_reset(self._uno, int(why))

    @property
    def storing(self) -> bool:
        """True while a byte is being written to the EEPROM, which takes 3.4 ms."""
        return bool(self._library.uno_is_storing(self._uno))

    def poke(self, address: int, value: int) -> None:
        """Set a register, as a fault."""
        self._library.uno_poke(self._uno, address, value)


# --- Compiles the firmware for the Uno and the emulator for this computer.
#
# simavr is GPL-3: its shim is built where it is used, and no binary of it is shipped.

HERE = Path(__file__).resolve().parent
_INCLUDE = Path("/usr/include")
_PROGRAMS = {"avr-gcc": "gcc-avr", "avr-size": "binutils-avr", "make": "make", "cc": "gcc"}
_HEADERS = {"simavr/sim_avr.h": "libsimavr-dev", "libelf.h": "libelf-dev",
            "../lib/avr/include/avr/io.h": "avr-libc"}  # fmt: skip


def missing_tools() -> str:
    """Missing tools for the emulated Uno, with their Debian packages; "" for none."""
    packages = [package for name, package in _PROGRAMS.items() if shutil.which(name) is None]
    packages += [package for name, package in _HEADERS.items() if not (_INCLUDE / name).exists()]
    if not packages:
        return ""
    return f"the emulated Uno needs the Debian packages {' '.join(packages)}"


def build_uno(folder: Path) -> EmulatedUno:
    """An Uno with the real firmware, just powered up; its binaries go to `folder`. Raises
    InputError: a tool is missing, or does not compile it."""
    if missing := missing_tools():
        raise InputError(missing)
    return EmulatedUno(build_emulator(folder), build_firmware(folder))


def build_firmware(folder: Path, config: str = "") -> Path:
    """The firmware's image (.elf) as `make` builds it, budgets included, in `folder`. Raises
    InputError: it does not compile, or outgrows its budget."""
    source = share_directory() / "firmware"
    _run(["make", "-s", "-C", str(source), f"BUILD={folder.resolve()}", f"CONFIG={config}"])
    return folder / "firmware.elf"


def build_emulator(folder: Path) -> Path:
    """The shared library of uno.c in `folder`. Raises InputError: it does not compile."""
    library = folder / "uno.so"
    _run(
        ["cc", "-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared",
         "-isystem", str(_INCLUDE / "simavr"), "-o", str(library), str(HERE / "uno.c"),
         "-lsimavr", "-lelf", "-lm"],
    )  # fmt: skip
    return library


def _run(command: list[str]) -> None:
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode < 0:  # Ctrl-C reaches the compiler, too
        raise KeyboardInterrupt
    if process.returncode:
        said = (process.stderr or process.stdout).strip().splitlines() or ["no reason given"]
        raise InputError(f"{command[0]}: {said[0]}")

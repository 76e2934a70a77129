"""An emulated Uno that runs the real firmware image, in virtual time.

The processor is simavr's, wrapped by uno.c, which also holds the electrics at the pins.
"""

import ctypes
from pathlib import Path

CHANNELS = 4
START_UP = 0.875e-3
"""s from power-up until the firmware's clock runs: it paints its memory first"""
_CHUNK = 4096
_FOUR = ctypes.c_double * CHANNELS
_TWO = ctypes.c_double * 2


class Electrics(ctypes.Structure):
    """What hangs on the pins; the fields mirror `struct electrics` of uno.c."""

    _fields_ = (
        ("supply", ctypes.c_double),
        ("supply_resistance", ctypes.c_double),
        ("resistance", _FOUR),
        ("volts_per_ampere", _TWO),
        ("filter_time", ctypes.c_double),
        ("range_voltage", _TWO),
        ("noise", ctypes.c_double),
        ("divider", ctypes.c_double),
        ("on_time", _FOUR),
        ("square_time", _FOUR),
        ("time", ctypes.c_double),
        ("longest_blocked", ctypes.c_double),
    )


class EmulatedUno:
    """One board: bytes in, bytes out, and `electrics` at its pins (SI units)."""

    def __init__(self, library: Path, image: Path, seed: int = 1) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.uno_new.restype = ctypes.c_void_p
        self._library.uno_new.argtypes = [ctypes.c_char_p, ctypes.c_uint64]
        self._library.uno_electrics.restype = ctypes.POINTER(Electrics)
        self._library.uno_electrics.argtypes = [ctypes.c_void_p]
        self._library.uno_run.argtypes = [ctypes.c_void_p, ctypes.c_double]
        for function in ("uno_write", "uno_read"):
            getattr(self._library, function).argtypes = [
                ctypes.c_void_p, ctypes.c_char_p, ctypes.c_uint32,
            ]
        self._library.uno_outputs.argtypes = [ctypes.c_void_p]
        self._library.uno_hang.argtypes = [ctypes.c_void_p, ctypes.c_int]
        self._uno = self._library.uno_new(str(image).encode(), seed)
        if not self._uno:
            raise RuntimeError(f"{image}: not an image that the emulator can load")
        self._buffer = ctypes.create_string_buffer(_CHUNK)
        self.electrics = self._library.uno_electrics(self._uno).contents
        self._connect_bench()

    def _connect_bench(self) -> None:
        """Four wires, a 12 V supply, ACS712-20A sensors, range sensors at 1.5 V."""
        electrics = self.electrics
        electrics.supply = 12.0
        electrics.resistance[:] = [2.7] * CHANNELS
        electrics.volts_per_ampere[:] = [0.1, 0.1]
        electrics.filter_time = 0.5e-3
        electrics.range_voltage[:] = [1.5, 1.5]
        electrics.noise = 2e-3
        electrics.divider = 4.0

    @property
    def time(self) -> float:
        """Virtual time in s since power-up."""
        return self.electrics.time

    @property
    def outputs(self) -> tuple[bool, ...]:
        """Which output pins are high now."""
        bits = self._library.uno_outputs(self._uno)
        return tuple(bool(bits >> channel & 1) for channel in range(CHANNELS))

    def run(self, seconds: float) -> None:
        """Let virtual time pass, to the end of what the processor does then: up to 0.1 ms more,
        which the next run takes less."""
        if not self._library.uno_run(self._uno, seconds):
            raise RuntimeError("the emulated processor gave up")

    def write(self, data: bytes) -> None:
        """Bytes to the board's serial port, at its baud rate."""
        self._library.uno_write(self._uno, data, len(data))

    def read(self) -> bytes:
        """Bytes that the board sent since the last call."""
        received = b""
        while count := self._library.uno_read(self._uno, self._buffer, _CHUNK):
            received += self._buffer.raw[:count]
        return received

    def hang(self, interrupts: bool) -> None:
        """The program loses its way: an endless loop, with interrupts on or off."""
        self._library.uno_hang(self._uno, int(interrupts))

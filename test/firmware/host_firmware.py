"""The firmware's logic compiled for this computer: tests, fuzzer, and a device without a chip."""

import ctypes
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[1] / "firmware"
LOGIC = ("protocol.c", "safety.c", "answers.c", "greeting.c", "telemetry.c", "session.c")
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_BUFFER = 65536


def _compile(output, *arguments):
    subprocess.run(
        ["cc", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-Wshadow",
         f"-I{FIRMWARE}", f"-I{HERE / 'host'}", "-o", output, *arguments,
         HERE / "host" / "fake_hardware.c", *(FIRMWARE / name for name in LOGIC), "-lm"],
        check=True,
    )
    return output


def build_program(source, folder):
    """A program of host/ with the firmware's logic, under sanitizers."""
    return _compile(folder / Path(source).stem, *SANITIZED, HERE / "host" / source)


def build_host_firmware(folder):
    """The logic as a shared library."""
    return _compile(folder / "firmware.so", "-O2", "-fPIC", "-shared")


def run_program(program, *arguments):
    """A built program's outcome."""
    return subprocess.run([program, *arguments], capture_output=True, text=True, timeout=60)


class HostFirmware:
    """A device that speaks as the Uno does; its clock has a resolution of 1 ms."""

    def __init__(self, library, entropy=1):
        self._library = ctypes.CDLL(str(library))
        self._library.fake_output.restype = ctypes.c_uint16
        self._library.fake_any_output.restype = ctypes.c_bool
        self._left_ms = 0.0
        self.restart(entropy)

    def restart(self, entropy=1):
        """As after power-on."""
        self._library.fake_start(entropy)

    def run(self, seconds):
        """Let its time pass."""
        self._left_ms += 1e3 * seconds
        whole = int(self._left_ms + 1e-6)
        self._left_ms -= whole
        self._library.fake_run_ms(whole)

    def write(self, data):
        """Bytes to it."""
        self._library.fake_receive(data, len(data))

    def read(self):
        """Bytes that it sent since the last call."""
        buffer = ctypes.create_string_buffer(_BUFFER)
        length = self._library.fake_take_sent(buffer, _BUFFER)
        return buffer.raw[:length]

    def set_current(self, board, reading):
        """Raw reading of a board's current sensor; 512 is 0 A."""
        self._library.fake_set_current(board, reading)

    @property
    def duties(self):
        """Share of the time that each output is on."""
        return tuple(self._library.fake_output(channel) / 65536.0 for channel in range(4))

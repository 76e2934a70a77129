"""The firmware's logic compiled for this computer: tests, fuzzer, and a simulated device."""

import ctypes
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[1] / "firmware"
LOGIC = ("protocol.c", "safety.c", "trips.c", "answers.c", "greeting.c", "telemetry.c", "session.c")
SANITIZED = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
_BUFFER = 65536


def _compile(output, *arguments):
    subprocess.run(["cc", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-Wshadow", f"-I{FIRMWARE}",
                    f"-I{HERE / 'host'}", "-o", output, *arguments,
                    HERE / "host" / "fake_hardware.c", *(FIRMWARE / name for name in LOGIC), "-lm"],
                   check=True)
    return output


def build_program(source, folder, how=SANITIZED):
    return _compile(folder / Path(source).stem, *how, HERE / "host" / source)


def build_host_firmware(folder):
    return _compile(folder / "firmware.so", "-O2", "-fPIC", "-shared")


class HostFirmware:
    """A device with the Uno's protocol; its clock has a resolution of 1 ms."""

    def __init__(self, library):
        self._library = ctypes.CDLL(str(library))
        self._library.fake_output.restype = ctypes.c_uint16
        self._left_ms = 0.0
        self.restart()

    def restart(self):
        self._library.fake_start(1)

    def cut_power(self):
        """The power fails and returns at once."""
        self._library.fake_cut_power(0)

    def run(self, seconds):
        self._left_ms += 1e3 * seconds
        whole = int(self._left_ms + 1e-6)
        self._left_ms -= whole
        self._library.fake_run_ms(whole)

    def write(self, data):
        self._library.fake_receive(data, len(data))

    def read(self):
        buffer = ctypes.create_string_buffer(_BUFFER)
        length = self._library.fake_take_sent(buffer, _BUFFER)
        return buffer.raw[:length]

    def set_current(self, board, reading):
        self._library.fake_set_current(board, reading)

    @property
    def duties(self):
        return tuple(self._library.fake_output(channel) / 65536.0 for channel in range(4))

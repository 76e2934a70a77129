"""Who answered the handshake, and whether this host may drive it."""

from collections.abc import Mapping
from dataclasses import dataclass

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import CHANNELS, PROTOCOL_VERSION, Named, resets

HANDSHAKE_LINES = frozenset("HLM")


@dataclass(frozen=True)
class DeviceIdentity:
    """A device's name, build and limits (V, A, s), as its handshake says."""

    name: str
    build: str
    reset: str
    nonce: int
    maximum_voltage: float
    command_timeout: float
    maximum_duty: float
    maximum_mean_current: float
    maximum_peak_current: float
    maximum_on_time: float
    supply_range: tuple[float, float]

    @classmethod
    def from_lines(cls, lines: Mapping[str, Named]) -> "DeviceIdentity":
        """From the H, L and M lines.

        Raises:
            InputError: another protocol, another number of channels, or something left out.
        """
        said = {key: value for line in lines.values() for key, value in line.values.items()}
        try:
            _demand(said, "protocol", PROTOCOL_VERSION)
            _demand(said, "channels", CHANNELS)
            return cls._from_values(said)
        except KeyError as error:
            raise InputError(f"handshake: {error.args[0]} is missing") from None
        except ValueError as error:
            raise InputError(f"handshake: {error}") from None

    @classmethod
    def _from_values(cls, said: dict[str, str]) -> "DeviceIdentity":
        return cls(
            name=said["name"],
            build=said["build"],
            reset=resets(int(said["reset"])),
            nonce=int(said["nonce"]),
            maximum_voltage=1e-3 * int(said["max_mv"]),
            command_timeout=1e-3 * int(said["timeout_ms"]),
            maximum_duty=int(said["duty"]) / 65536.0,
            maximum_mean_current=1e-3 * int(said["mean_ma"]),
            maximum_peak_current=1e-3 * int(said["peak_ma"]),
            maximum_on_time=float(int(said["on_s"])),
            supply_range=(1e-3 * int(said["supply_min_mv"]), 1e-3 * int(said["supply_max_mv"])),
        )


def _demand(said: dict[str, str], key: str, expected: int) -> None:
    if int(said[key]) != expected:
        raise ValueError(f"the device has {key} {said[key]}, expected {expected}")

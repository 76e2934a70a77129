"""Who answered the handshake, and whether this host may drive it."""

from collections.abc import Mapping
from dataclasses import dataclass

from sma_bench.errors import InputError
from sma_bench.hardware.serial_messages import (
    CAUSES,
    CHANNELS,
    PROTOCOL_VERSION,
    Named,
    name_of,
    resets,
)

HANDSHAKE_LINES = frozenset("HLM")


@dataclass(frozen=True)
class DeviceIdentity:
    """A device's name, build and limits (V, A, s), as its handshake says."""

    name: str
    build: str
    reset: str
    maximum_voltage: float
    command_timeout: float
    maximum_duty: float
    maximum_mean_current: float
    maximum_peak_current: float
    maximum_on_time: float
    supply_range: tuple[float, float]
    least_resistance: float
    hot_voltage: float
    """root mean square of a wire's volts over about `hot_time`"""
    hot_time: float

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
            reset=_start(int(said["reset"]), int(said["before"])),
            maximum_voltage=1e-3 * int(said["max_mv"]),
            command_timeout=1e-3 * int(said["timeout_ms"]),
            maximum_duty=int(said["duty"]) / 65536.0,
            maximum_mean_current=1e-3 * int(said["mean_ma"]),
            maximum_peak_current=1e-3 * int(said["peak_ma"]),
            maximum_on_time=float(int(said["on_s"])),
            supply_range=(1e-3 * int(said["supply_min_mv"]), 1e-3 * int(said["supply_max_mv"])),
            least_resistance=1e-3 * int(said["least_mohm"]),
            hot_voltage=1e-3 * int(said["hot_mv"]),
            hot_time=1e-3 * int(said["hot_ms"]),
        )


def _start(flags: int, cause: int) -> str:
    stopped = f", after: {name_of(CAUSES, cause)}" if cause else ""
    return resets(flags) + stopped


def _demand(said: dict[str, str], key: str, expected: int) -> None:
    if int(said[key]) != expected:
        raise ValueError(f"the device has {key} {said[key]}, expected {expected}")

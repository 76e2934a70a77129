"""Rules that keep a heated wire safe. No ROS, no clock of its own: time comes in as seconds.

Every rule answers with a reason, one line for people, or "" when all is well. What acts on them
(a node, a bridge, a firmware emulation) puts the outputs to 0 V.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

from sma_bench.hardware.expectation import BoardWatch, WireModel, WireWatch
from sma_bench.parameters import Parameters

CELSIUS_ZERO = 273.15
_MODELLED_CURRENT = 2.0


@dataclass(frozen=True)
class Limits:
    """What a bench allows: V, A, K, s of silence, W, K/s; and what its wires should do."""

    maximum_voltage: float
    maximum_current: float
    maximum_temperature: float
    command_timeout: float
    maximum_power: float
    maximum_heating_rate: float
    model: WireModel

    @classmethod
    def from_parameters(cls, parameters: Parameters) -> "Limits":
        """The limits among the contract's parameters."""
        names = [field.name for field in fields(cls) if field.name != "model"]
        allowed = {name: parameters[f"bench.{name}"] for name in names}
        return cls(**allowed, model=WireModel.from_parameters(parameters))


def command_fault(command: Sequence[float], channels: int, limits: Limits) -> str:
    """Why a voltage command (V, one per channel) cannot be accepted, or ""."""
    if len(command) != channels:
        return f"voltage_command has {len(command)} values, expected {channels}"
    for value in command:
        if not math.isfinite(value):
            return f"voltage_command has {value}, expected finite volts"
        if not 0.0 <= value <= limits.maximum_voltage:
            return (
                f"voltage_command has {value:g} V, expected 0 to {limits.maximum_voltage:g} V"
            )
    return ""


def temperature_fault(channel: str, temperature: float, limits: Limits) -> str:
    """Over-temperature of a wire at `temperature` K, or ""; NaN is no reading and no fault."""
    if temperature > limits.maximum_temperature:
        return (
            f"over-temperature: {channel} at {temperature - CELSIUS_ZERO:.1f} degC, limit "
            f"{limits.maximum_temperature - CELSIUS_ZERO:.1f} degC"
        )
    return ""


def current_fault(channel: str, current: float, limits: Limits) -> str:
    """Over-current of a wire carrying `current` A, or ""; NaN is no reading and no fault."""
    if abs(current) > limits.maximum_current:
        return (
            f"over-current: {channel} at {current:.2f} A, limit {limits.maximum_current:g} A"
        )
    return ""


def power_fault(channel: str, volt: float, ampere: float, limits: Limits) -> str:
    """Over-voltage or too much power at a wire, or ""; NaN is no reading and no fault."""
    highest = limits.model.reading(limits.maximum_voltage)
    if volt > highest + limits.model.voltage_tolerance:
        return f"over-voltage: {channel} gets {volt:.2f} V, limit {highest:.4g} V"
    if volt * ampere > limits.maximum_power:
        return (
            f"over-power: {channel} takes {volt * ampere:.1f} W, limit {limits.maximum_power:g} W"
        )
    return ""


class Watchdog:
    """Notices silence. There is no way to switch it off."""

    def __init__(self, timeout: float) -> None:
        """Expired from the start, and again `timeout` s after every `feed`.

        Raises:
            ValueError: the timeout is not positive and finite.
        """
        if not 0.0 < timeout < math.inf:
            raise ValueError(f"watchdog timeout is {timeout} s, expected positive and finite")
        self.timeout = timeout
        self._fed: float | None = None

    def feed(self, now: float) -> None:
        """Something was heard at `now` s."""
        self._fed = now

    def expired(self, now: float) -> bool:
        """True when nothing was heard within the timeout before `now` s."""
        # A clock that went back (a restarted simulation) proves nothing about the silence.
        return self._fed is None or not 0.0 <= now - self._fed <= self.timeout

    def silence(self, now: float) -> float:
        """Seconds since something was heard; infinite when nothing ever was."""
        return math.inf if self._fed is None else now - self._fed


class CommandGate:
    """Accepted commands become outputs; bad ones are counted, silence puts outputs to 0 V.

    One commander at a time: the first, until it is silent for the command timeout. 0 V is obeyed
    from anybody, for as long as a command is.
    """

    def __init__(self, channels: int, limits: Limits) -> None:
        self._limits = limits
        self._watchdog = Watchdog(limits.command_timeout)
        self._zero = (0.0,) * channels
        self._outputs = self._zero
        self._live = False
        self._commander = ""
        self._zeroed = Watchdog(limits.command_timeout)
        self.accepted = 0
        self.rejected = 0
        self.timeouts = 0
        self.last_rejection = ""

    def command(self, values: Sequence[float], now: float, sender: str = "") -> str:
        """Take a command at `now` s; the reason when it is rejected and changes nothing."""
        reason = command_fault(values, len(self._zero), self._limits)
        if reason:
            return self.refuse(reason)
        if self._live and sender != self._commander and not self._watchdog.expired(now):
            if any(values):
                return self.refuse(f"{_named(sender)}: {_named(self._commander)} commands already")
            self._zeroed.feed(now)
            self.accepted += 1
            return ""
        self._commander = sender
        self._watchdog.feed(now)
        self._outputs = tuple(float(value) for value in values)
        self._live = True
        self.accepted += 1
        return ""

    @property
    def commander(self) -> str:
        """Who commands; "" where nobody does."""
        return _named(self._commander) if self._live else ""

    def refuse(self, reason: str) -> str:
        """Count a command that cannot be obeyed now; the reason."""
        self.rejected += 1
        self.last_rejection = reason
        return reason

    def clear(self) -> None:
        """Outputs to 0 V until the next command."""
        self._live = False
        self._outputs = self._zero

    def outputs(self, now: float) -> tuple[float, ...]:
        """Volts of every channel at `now` s."""
        if self._live and self._watchdog.expired(now):
            self._live = False
            self._outputs = self._zero
            self.timeouts += 1
        return self._outputs if self._zeroed.expired(now) else self._zero


def _named(sender: str) -> str:
    """A sender for people: what makes it unique is left out."""
    return sender.partition("#")[0] or "a node without a name"


class Freshness:
    """Age of one reading. Only a new acquisition stamp counts: a frozen driver is stale too."""

    def __init__(self, subject: str, timeout: float) -> None:
        self._subject = subject
        self._watchdog = Watchdog(timeout)
        self._stamp = math.nan

    def seen(self, stamp: float, now: float) -> None:
        """A reading acquired at `stamp` s arrived at `now` s (two clocks, not compared)."""
        if stamp != self._stamp:
            self._stamp = stamp
            self._watchdog.feed(now)

    def fault(self, now: float) -> str:
        """Why the reading cannot be trusted at `now` s, or ""."""
        if not self._watchdog.expired(now):
            return ""
        silence = self._watchdog.silence(now)
        if silence == math.inf:
            return f"no feedback: {self._subject} was never received"
        return (
            f"stale feedback: nothing new from {self._subject} for {silence:.2f} s, limit "
            f"{self._watchdog.timeout:g} s"
        )


class Interlock:
    """Latched stop: the first reason stays until someone resets it."""

    def __init__(self) -> None:
        self.reason = ""

    @property
    def tripped(self) -> bool:
        """True from the first trip to the reset."""
        return bool(self.reason)

    def trip(self, reason: str) -> None:
        """Latch `reason`; "" and later reasons change nothing."""
        self.reason = self.reason or reason

    def reset(self) -> None:
        """Forget the reason."""
        self.reason = ""


class Guard:
    """Watches every channel's commands and readings and knows why driving must not go on."""

    def __init__(
        self, channels: Iterable[str], feedback: Iterable[str], timeout: float
    ) -> None:
        """Demand `feedback` ("power", "temperature") of all channels at least every `timeout` s.

        A disagreement between model and readings is a fault when it lasts as long.
        """
        channels = tuple(channels)
        self._fresh = {
            f"{channel}/{kind}": Freshness(f"{channel}/{kind}", timeout)
            for channel in channels
            for kind in feedback
        }
        self._measured = {channel: Freshness(channel, timeout) for channel in channels}
        self._wires = {channel: WireWatch(channel, timeout) for channel in channels}
        self._boards = tuple(BoardWatch(side) for side in ("front", "back"))
        self._readings: dict[str, str] = {}
        self._recording = ""

    def recorder(self, failure: str) -> None:
        """Note why the recorder failed (a full disk), "" when it records or nobody minds."""
        self._recording = f"recording failed: {failure}" if failure else ""

    def found(self, subject: str, reason: str) -> None:
        """Note what somebody else found about a subject, "" for nothing."""
        self._readings[subject] = reason

    def commanded(self, voltage: Sequence[float]) -> None:
        """Note the volts that were sent, one a channel: readings must follow them."""
        for wire, volt in zip(self._wires.values(), voltage, strict=True):
            wire.commanded(volt)

    def temperature(
        self, channel: str, kelvin: float, stamp: float, now: float, limits: Limits
    ) -> None:
        """Note a temperature in K; NaN or infinite is not a reading and makes nothing fresh."""
        if math.isfinite(kelvin):
            self._measured[channel].seen(stamp, now)
            self._note(f"{channel}/temperature", stamp, now)
        wire = self._wires[channel]
        rate = wire.rate(kelvin, stamp, limits.maximum_heating_rate)
        disagreement = wire.temperature(kelvin, now, limits.model)
        self._readings[f"{channel}/temperature"] = (
            temperature_fault(channel, kelvin, limits) or rate or disagreement
        )

    def power(
        self, channel: str, volt: float, ampere: float, stamp: float, now: float, limits: Limits
    ) -> None:
        """Note voltage in V and current in A; both NaN or infinite is not a reading."""
        if math.isfinite(volt) or math.isfinite(ampere):
            self._note(f"{channel}/power", stamp, now)
        wire = self._wires[channel]
        # What is beyond the limits is a fault by itself; one such number must not stay in the
        # model for good.
        highest = limits.model.reading(limits.maximum_voltage)
        volts = _within(volt, highest + limits.model.voltage_tolerance)
        amperes = _within(ampere, _MODELLED_CURRENT * limits.maximum_current)
        disagreement = wire.power(volts, amperes, stamp, now, limits.model)
        # A temperature that is measured is judged itself.
        unseen = self._measured[channel].fault(now)
        self._readings[f"{channel}/power"] = (
            current_fault(channel, ampere, limits)
            or power_fault(channel, volt, ampere, limits)
            or (wire.heat(limits.model) if unseen else "")
            or disagreement
        )

    def boards(
        self, amperes: Sequence[float], volts: Sequence[float], now: float, limits: Limits
    ) -> None:
        """Note the boards' mean currents (A) and their wires' mean volts."""
        for number, (board, ampere, volt) in enumerate(
            zip(self._boards, amperes, volts, strict=True)
        ):
            self._readings[f"board {number}"] = board.current(ampere, volt, now, limits.model)

    @property
    def flowing(self) -> str:
        """What flows though every output is off, "" for nothing."""
        return "; ".join(board.flowing for board in self._boards if board.flowing)

    def fault(self, now: float) -> str:
        """First reason not to drive the wires at `now` s, or ""."""
        faults = [reason for reason in (self._recording, *self._readings.values()) if reason]
        faults += [fault for fresh in self._fresh.values() if (fault := fresh.fault(now))]
        return faults[0] if faults else ""

    def _note(self, topic: str, stamp: float, now: float) -> None:
        if topic in self._fresh:
            self._fresh[topic].seen(stamp, now)


def _within(value: float, largest: float) -> float:
    """A reading cut to plus or minus `largest`; NaN where it is no number."""
    return max(-largest, min(value, largest)) if math.isfinite(value) else math.nan

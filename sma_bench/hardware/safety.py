"""Rules that keep a heated wire safe. No ROS, no clock of its own: time comes in as seconds.

Every rule returns a reason (one line for the user) or ""; on a reason the caller sets the outputs
to 0 V. Rules on readings are three tables, evaluated by `broken`: limits act at once, deviations
from the command or the model must last for a while (a camera may briefly look elsewhere)."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from statistics import fmean
from typing import Any, NamedTuple

from sma_bench.errors import InputError
from sma_bench.parameters import Parameters

CELSIUS_ZERO = 273.15
CURRENT_FLOOR = 0.1  # A; offset and noise of a board's current sensor
MOST_CURRENT_AT_REST = 0.15  # A, highest reading of a board's sensor while nothing is driven
LEAST_VOLTAGE = 1.0  # V; below it the current is too noisy to give a resistance
_LEAST_TOLERANCE = 0.2  # share of the voltage tolerance that remains at 0 V
FLOWING, FEEDBACK = "flowing", ("power", "temperature")
Lasting = dict[str, tuple[float, int]]
_COMMANDS = 10  # a reading may belong to any of the last commands
_SENT = 1000  # commands remembered between two readings, at most
_CURRENT_VALID = 1.0  # s for which the last measured current replaces missing ones
_LEAST_READINGS = 5  # that must break a rule with a hold time
_STRAY_TIME = 0.25  # s of deviation that `Guard.strays` reports at the end of a run
_RATE_BASE = 0.05  # s, shortest base of a heating rate; a camera's stamps jitter by a few ms
_MODELLED_CURRENT = 2.0  # times the maximum: the model sees larger readings clipped to this
_REST_VOLTAGE, _REST_TIME = 0.5, 10.0  # V; time constants until a wire has room temperature
_ROOM_ERROR = 20.0  # K, largest error of the stated room temperature
_CLOCK_DRIFT, _OTHER_TIME = 1e-3, 60.0  # s/s of two clocks, one being slewed; s
_OFF_CURRENT = 0.3  # A; an uncalibrated ACS712 may be 0.4 A off, a calibrated one is not


@dataclass(frozen=True)
class Limits:
    """Limits and tolerances of a bench, and the model of each channel (Ohm's law, eq. (1))."""

    maximum_voltage: float
    maximum_current: float
    maximum_temperature: float
    command_timeout: float
    maximum_power: float
    maximum_heating_rate: float
    voltage_tolerance: float  # V, at the highest voltage
    resistance_tolerance: float  # share of the expected current
    temperature_tolerance: float  # K
    resistance: float
    heat_loss: float  # W/K
    heat_capacity: float  # J/K
    ambient: float
    leads: float  # ohm, between the point where the voltage is measured and the wire
    supply: float  # V, switched with a duty; 0: commands are direct voltages

    @classmethod
    def from_parameters(cls, p: Parameters) -> "Limits":
        count, names = p["wire.count"], [field.name for field in fields(cls)]
        return cls(**{name: p[f"bench.{name}"] for name in names[: names.index("resistance")]},
                   resistance=p["wire.resistance"] / count,
                   heat_loss=count * p["wire.heat_transfer_coefficient"] * p["wire.surface_area"],
                   heat_capacity=count * p["wire.mass"] * p["wire.specific_heat"],
                   ambient=p["environment.ambient_temperature"], leads=p["bench.lead_resistance"],
                   supply=p["bench.supply_voltage"] if p["bench.drive"] == "duty" else 0.0)

    def reading(self, commanded: float) -> float:
        """Voltage to be read at a command (V): with a duty, the direct voltage of equal heat."""
        return math.sqrt(max(commanded, 0.0) * self.supply) if self.supply else commanded

    @property
    def circuit(self) -> float:
        """V/I, ohm: the wire with its leads."""
        return self.resistance + self.leads

    @property
    def heated(self) -> float:
        """V^2/P, ohm, with P the heat in the wire without its leads."""
        return self.circuit**2 / self.resistance

    @property
    def least_resistance(self) -> float:
        """Lowest resistance (ohm) that the circuit may have, its wire cold, hot or worn."""
        return self.circuit * max(1.0 - self.resistance_tolerance, 0.05)

    @property
    def highest_reading(self) -> float:
        """Highest voltage (V) that may be read at the largest command."""
        return self.reading(self.maximum_voltage) + self.voltage_tolerance

    def warmed(self, temperature: float, volt: float, elapsed: float) -> float:
        """Temperature (K) after `elapsed` s at `volt` V, from `temperature` K."""
        steady = self.ambient + volt**2 / self.heated / self.heat_loss
        decay = math.exp(-elapsed * self.heat_loss / self.heat_capacity)
        return steady + (temperature - steady) * decay

    def heating_voltage(self, volt: float, ampere: float) -> float:
        """Voltage (V) that heats the modelled wire at least as much as measured; NaN: not measured.
        If the current is implausible the highest of three heats counts: the modelled wire's, the
        measured one, and that of a current without a voltage (a stuck switch)."""
        if volt >= LEAST_VOLTAGE and abs(ampere - volt / self.circuit) <= self.allowed_stray(volt):
            return self.measured_voltage(volt, ampere)
        powers = [volt**2 / self.heated, (volt - self.leads * ampere) * ampere]
        if not volt >= LEAST_VOLTAGE and abs(ampere) > CURRENT_FLOOR:
            powers.append(ampere**2 * self.resistance)
        highest = max((power for power in powers if not math.isnan(power)), default=0.0)
        return math.sqrt(highest * self.heated)

    def measured_voltage(self, volt: float, ampere: float) -> float:
        """Voltage (V) that heats the modelled wire with the power measured in this one."""
        return math.sqrt(max((volt - self.leads * ampere) * ampere, 0.0) * self.heated)

    def allowed_deviation(self, volt: float) -> float:
        """V by which a command and its reading may differ: less at small voltages."""
        share = _LEAST_TOLERANCE + volt / self.reading(self.maximum_voltage)
        return self.voltage_tolerance * min(share, 1.0)

    def allowed_stray(self, volt: float) -> float:
        """A by which the current at `volt` V may differ from the model's."""
        return CURRENT_FLOOR + self.resistance_tolerance * volt / self.circuit


class Watchdog:
    """Detects silence: expired from the start, and again `timeout` s after every `feed`. It cannot
    be switched off: ValueError unless the timeout is positive and finite."""

    def __init__(self, timeout: float) -> None:
        if not 0.0 < timeout < math.inf:
            raise ValueError(f"watchdog timeout is {timeout} s, expected positive and finite")
        self.timeout, self.fed = timeout, -math.inf

    def feed(self, now: float) -> None:
        self.fed = now

    def expired(self, now: float) -> bool:
        """True when nothing was heard within the timeout before `now` s."""
        # When the clock went back (a restarted simulation) it counts as expired.
        return not 0.0 <= now - self.fed <= self.timeout


class Freshness(Watchdog):
    """Age of one reading. Only a new stamp counts, and none that came later by more than the
    timeout, compared with the promptest one: what is repeated, delayed or replayed is stale, while
    the clock of the stamps may differ from ours."""

    def __init__(self, subject: str, timeout: float, aged: bool = True) -> None:
        """`aged`: judge the stamps; else (simulated time) every new one is fresh."""
        super().__init__(timeout)
        self._subject, self._aged, self._stamp = subject, aged, math.nan
        self._heard, self._least, self._offset, self._late = -math.inf, math.inf, 0.0, 0.0

    def seen(self, stamp: float, now: float) -> bool:
        """Note a reading acquired at `stamp` s, received at `now` s; True if its stamp is new."""
        least, age = self._least + _CLOCK_DRIFT * (now - self._heard), now - stamp
        is_new, self._stamp, self._heard = stamp != self._stamp, stamp, now
        if self._aged:
            self._offset = age
            self._least = least if abs(age) > _OTHER_TIME else min(least, age)
            self._late = age - self._least
        if is_new and not (self._late > self.timeout or self.doubt(_OTHER_TIME)):
            self.feed(now)
        return is_new

    def learn_clock(self) -> None:
        """Forget how prompt readings were: the clock of their stamps may have been set back."""
        self._least = math.inf

    def doubt(self, most: float) -> str:
        """Report of a timestamp that is more than `most` s off the time of its arrival, or ""."""
        off, side = abs(self._offset), "before" if self._offset > 0.0 else "after"
        return "" if not off > most else (
            f"{self._subject} has timestamps {off:.1f} s {side} their arrival: late, replayed, or "
            "of a clock that must be set")

    def fault(self, now: float) -> str:
        """Why the reading cannot be trusted at `now` s, or ""."""
        if math.isinf(self._heard):
            return f"no feedback: {self._subject} was never received"
        if not self.expired(now):
            return ""
        if reason := self.doubt(_OTHER_TIME):
            return reason
        if self._late > self.timeout and now - self._heard <= self.timeout:
            return (f"stale feedback: {self._subject} arrives {self._late:.2f} s late by its "
                    f"timestamps, limit {self.timeout:g} s (reset if its clock was set)")
        return (f"stale feedback: nothing new from {self._subject} for {now - self.fed:.2f} s, "
                f"limit {self.timeout:g} s")


class CommandGate:
    """Turns accepted commands into outputs and counts the rejected; without a command for the
    command timeout the outputs go to 0 V. One sender commands at a time: the first, until it is
    silent for that timeout. A command of 0 V is accepted from anybody."""

    def __init__(self, channels: int, limits: Limits) -> None:
        self._limits = limits
        self._watchdog, self._zeroed = (Watchdog(limits.command_timeout) for _ in range(2))
        self._zero = self._outputs = (0.0,) * channels
        self._commander: str | None = None  # while it is not silent
        self.accepted = self.rejected = self.timeouts = 0
        self.last_rejection = ""

    def command(self, values: Sequence[float], now: float, sender: str = "") -> str:
        """Take a command (V, one per channel) at `now` s; returns why it is rejected, or ""."""
        if (given := len(values)) != len(self._zero):
            return self.refuse(f"voltage_command has {given} values, expected {len(self._zero)}")
        highest = self._limits.maximum_voltage
        for value in values:
            if not math.isfinite(value):
                return self.refuse(f"voltage_command has {value}, expected finite volts")
            if not 0.0 <= value <= highest:
                return self.refuse(f"voltage_command has {value:g} V, expected 0 to {highest:g} V")
        if self._commander not in (None, sender) and not self._watchdog.expired(now):
            if any(values):
                return self.refuse(f"{_named(sender)}: {self.commander} commands already")
            self._zeroed.feed(now)
        else:
            self._commander = sender
            self._watchdog.feed(now)
            self._outputs = tuple(float(value) for value in values)
        self.accepted += 1
        return ""

    @property
    def commander(self) -> str:
        return "" if self._commander is None else _named(self._commander)

    def refuse(self, reason: str) -> str:
        """Count a rejected command; returns `reason`."""
        self.rejected += 1
        self.last_rejection = reason
        return reason

    def clear(self) -> None:
        """Outputs to 0 V until the next command."""
        self._commander, self._outputs = None, self._zero

    def outputs(self, now: float) -> tuple[float, ...]:
        """Volts of every channel at `now` s."""
        if self._commander is not None and self._watchdog.expired(now):
            self.clear()
            self.timeouts += 1
        return self._outputs if self._zeroed.expired(now) else self._zero

    def diagnostics(self, now: float) -> dict[str, Any]:
        return {"outputs": " ".join(f"{volt:g}" for volt in self.outputs(now)),
                "commander": self.commander, "accepted_commands": self.accepted,
                "rejected_commands": self.rejected, "command_timeouts": self.timeouts,
                "last_rejection": self.last_rejection}


def _named(sender: str) -> str:
    """A sender's name for messages, without the suffix that makes it unique."""
    return sender.partition("#")[0] or "an unsigned sender"


@dataclass
class Wire:
    """Readings of one wire (NaN: not measured) and its modelled temperatures. What heated it before
    the first reading is unknown: `hottest` begins at the highest allowed temperature."""

    name: str
    volt: float = math.nan
    ampere: float = math.nan
    kelvin: float = math.nan
    commands: deque[float] = field(default_factory=lambda: deque(maxlen=_COMMANDS))  # V
    sent: deque[float] = field(default_factory=lambda: deque(maxlen=_SENT))  # V, since a reading
    rise: float = 0.0  # K/s, 0 if the two readings are too close in time
    modelled: float = math.nan  # K, from the voltage
    hottest: float = math.nan  # K, upper bound from the measured power
    room: float = 0.0  # K by which it was warmer at rest than `Limits.ambient`
    since: Lasting = field(default_factory=dict)
    asked: float = 0.0  # V, highest command of this run; NaN once a reading shows a voltage
    unanswered: float = 0.0  # `asked`, once a reading that should have shown it was 0 V
    _rested: float = 0.0  # s
    _heating: float = 0.0
    _powered: float = math.nan
    _reference: tuple[float, float] | None = None
    _share: float = 1.0  # last measured current over the modelled one
    _measured: float = -math.inf  # s, time of that

    def command(self, volt: float) -> None:
        """Note the voltage that was sent; once it is not 0 the wire is no longer at rest."""
        self.commands.append(volt)
        self.sent.append(volt)
        self.asked = max(self.asked, volt)  # NaN stays
        if volt:
            self._rested = 0.0

    def power(self, volt: float, ampere: float, stamp: float, limits: Limits) -> None:
        """Note a reading acquired at `stamp` s and advance the model to that time."""
        self.volt, self.ampere = volt, ampere
        volt, ampere = self.clipped(limits)
        if math.isnan(volt) and math.isnan(ampere):
            return
        elapsed = stamp - self._powered
        if not elapsed >= 0.0:  # the first reading, or a clock that went back
            self.modelled, self.hottest, elapsed = limits.ambient, limits.maximum_temperature, 0.0
        if volt >= LEAST_VOLTAGE:  # a wire may age: the current as measured heats it
            if not math.isnan(ampere):
                self._share, self._measured = ampere * limits.circuit / volt, stamp
            elif not 0.0 <= stamp - self._measured <= _CURRENT_VALID:
                self._share = 1.0
            ampere = self._share * volt / limits.circuit
        heating = limits.heating_voltage(volt, ampere)
        expected = heating if math.isnan(volt) else volt
        if volt >= LEAST_VOLTAGE:
            expected = limits.measured_voltage(volt, ampere)
        most = max(self.sent, default=0.0)
        if most - min(self.sent, default=0.0) > limits.allowed_deviation(most):
            # These commands differ too much for one reading to stand for all: use their mean heat.
            mean = math.sqrt(fmean(limits.reading(sent) ** 2 for sent in self.sent))
            expected = limits.measured_voltage(mean, self._share * mean / limits.circuit)
        while len(self.sent) > 1:  # the last one still applies
            self.sent.popleft()
        self.modelled = limits.warmed(self.modelled, expected, elapsed)
        # The voltage may have changed at any time since the last reading: take the higher.
        self.hottest = limits.warmed(self.hottest, max(heating, self._heating), elapsed)
        # Commands count, too: there may have been pulses between two readings.
        rests = max(heating, self._heating) < _REST_VOLTAGE and not any(self.commands)
        self._rested = self._rested + elapsed if rests else 0.0
        self._heating, self._powered = heating, stamp

    def clipped(self, limits: Limits) -> list[float]:
        """Voltage and current for the model, clipped: an impossible reading must not upset it."""
        return [max(-most, min(value, most)) if math.isfinite(value) else math.nan
                for value, most in ((self.volt, limits.highest_reading),
                                    (self.ampere, _MODELLED_CURRENT * limits.maximum_current))]

    def temperature(self, kelvin: float, stamp: float, limits: Limits) -> None:
        """Note a temperature acquired at `stamp` s, and its rise since an earlier one."""
        self.kelvin, self.rise = kelvin, 0.0
        if not math.isfinite(kelvin):
            return
        if self._rested > _REST_TIME * limits.heat_capacity / limits.heat_loss:
            self.room = max(-_ROOM_ERROR, min(kelvin - limits.ambient, _ROOM_ERROR))
        before, at = self._reference or (kelvin, -math.inf)
        if not 0.0 <= stamp - at < _RATE_BASE:  # far enough back, or the clock went back
            self._reference = (kelvin, stamp)
            self.rise = (kelvin - before) / (stamp - at) if stamp > at else 0.0


class Rule(NamedTuple):
    """Broken when `value` exceeds `limit` for `hold` s. NaN neither begins nor ends a violation."""

    value: float
    limit: float
    reason: Callable[[], str]
    hold: float = 0.0


def power_rules(wire: Wire, x: Limits, timeout: float = 0.0,
                unseen: bool = False) -> dict[str, Rule]:
    """Rules on voltage and current; deviations from command and model must last for `timeout` s.
    `unseen`: no temperature is measured, so the modelled one is limited instead."""
    name, volt, ampere, (v, i) = wire.name, wire.volt, wire.ampere, wire.clipped(x)
    # Voltages that the last commands allow, and the current expected at the measured voltage.
    commands = [x.reading(command) for command in wire.commands or (0.0,)]
    low = min(commands) - x.allowed_deviation(min(commands))
    high = max(commands) + x.allowed_deviation(max(commands))
    strays = max(low - v, v - high) if wire.commands else 0.0 * v
    last, expected, allowed = commands[-1], v / x.circuit, x.allowed_stray(v)
    off = abs(i - expected) if v >= LEAST_VOLTAGE else 0.0 * v
    hottest = wire.hottest if unseen else math.nan
    return {
        "current": Rule(abs(ampere), x.maximum_current, lambda: (
            f"over-current: {name} at {ampere:.2f} A, limit {x.maximum_current:g} A")),
        "voltage": Rule(volt, x.highest_reading, lambda:
            f"over-voltage: {name} gets {volt:.2f} V, limit {x.reading(x.maximum_voltage):.4g} V"),
        "power": Rule(volt * ampere, x.maximum_power, lambda: (
            f"over-power: {name} takes {volt * ampere:.1f} W, limit {x.maximum_power:g} W")),
        "heat": Rule(hottest, x.maximum_temperature, lambda: (
            f"over-temperature by the model: {name} at {_celsius(hottest)}, limit "
            f"{_celsius(x.maximum_temperature)}, and no temperature is measured")),
        "follows": Rule(strays, 0.0, lambda: (
            f"disagreement: {name} gets {volt:.2f} V, commanded {last:.2f} V, tolerance "
            f"{x.allowed_deviation(last):.2g} V"), timeout),
        "conducts": Rule(off, allowed, lambda: (
            f"disagreement: {name} carries {ampere:.2f} A at {volt:.2f} V, the model says "
            f"{expected:.2f} A, tolerance {allowed:.2f} A"), timeout)}


def temperature_rules(wire: Wire, x: Limits, timeout: float = 0.0) -> dict[str, Rule]:
    name, kelvin, rise, modelled = wire.name, wire.kelvin, wire.rise, wire.modelled + wire.room
    return {
        "temperature": Rule(kelvin, x.maximum_temperature, lambda: (
            f"over-temperature: {name} at {_celsius(kelvin)}, limit "
            f"{_celsius(x.maximum_temperature)}")),
        "rate": Rule(rise, x.maximum_heating_rate, lambda:
            f"heating rate: {name} rises by {rise:.0f} K/s, limit {x.maximum_heating_rate:g} K/s"),
        "warms": Rule(abs(kelvin - modelled), x.temperature_tolerance, lambda: (
            f"disagreement: {name} measured at {_celsius(kelvin, 0)}, the model says "
            f"{_celsius(modelled, 0)}, tolerance {x.temperature_tolerance:g} K"), timeout)}


def board_rules(side: str, ampere: float, volts: float, x: Limits) -> dict[str, Rule]:
    """Rules on a board's mean current; `volts`: mean over time, summed over its wires."""
    off, most = volts == 0.0, CURRENT_FLOOR + volts / x.least_resistance
    return {
        "short": Rule(0.0 if off else ampere, most, lambda: (
            f"short circuit: the {side} board carries {ampere:.2f} A, its outputs explain at "
            f"most {most:.2f} A"), hold=0.06),
        # A window may include current from before the outputs went off.
        FLOWING: Rule(abs(ampere) if off else 0.0, _OFF_CURRENT, lambda: (
            f"{ampere:.2f} A through the {side} board with its outputs off"), hold=0.15)}


def broken(rules: Mapping[str, Rule], now: float = 0.0,
           since: Lasting | None = None) -> dict[str, str]:
    """Names and reasons of the rules broken at `now` s. `since` is state that the caller keeps:
    when readings began to break each rule, and how many did."""
    since, reasons = {} if since is None else since, {}
    for name, (value, limit, reason, hold) in rules.items():
        if math.isnan(value):
            continue
        if not value > limit:
            since.pop(name, None)
            continue
        begun, readings = since.get(name, (now, 0))
        since[name] = begun, readings + 1
        if not hold or (now - begun >= hold and readings + 1 >= _LEAST_READINGS):
            reasons[name] = reason()
    return reasons


def _celsius(kelvin: float, digits: int = 1) -> str:
    return f"{kelvin - CELSIUS_ZERO:.{digits}f} degC"


def checked_feedback(kinds: Sequence[str]) -> Sequence[str]:
    """The kinds of reading that a node requires. InputError: none, or an unknown one."""
    if not kinds or set(kinds) - set(FEEDBACK):
        raise InputError(f"feedback: {', '.join(kinds)!r}, expected power, temperature or both")
    return kinds


class Guard:
    """Checks the commands and readings of all channels; `fault` is the reason not to drive."""

    def __init__(self, channels: Iterable[str], feedback: Iterable[str], timeout: float,
                 aged: bool = True) -> None:
        """Require `feedback` ("power", "temperature") of all channels at least every `timeout` s. A
        disagreement between model and readings is a fault when it lasts for `timeout` s. `aged` as
        of `Freshness`; then stamps are converted to the clock of `now`."""
        self._timeout, self.aged = timeout, aged
        self._wires = {channel: Wire(channel) for channel in channels}
        self._boards: dict[str, Lasting] = {side: {} for side in ("front", "back")}
        self.wanted = [f"{channel}/{kind}" for channel in self._wires for kind in feedback]
        self.known = [f"{channel}/{kind}" for channel in self._wires for kind in FEEDBACK]
        self._fresh = {name: Freshness(name, timeout, aged) for name in (*self.wanted, *self.known)}
        self._found = {"recorder": ""}
        self.flowing = ""  # report of a current with all outputs of a board off

    def recorder(self, failure: str) -> None:
        """Note why the recorder failed (a full disk), "" when it records or need not."""
        self.found("recorder", f"recording failed: {failure}" if failure else "")

    def reset(self) -> None:
        """Somebody has seen to the last fault: forget what was latched, and the stamps' clocks."""
        self.recorder("")
        for fresh in self._fresh.values():
            fresh.learn_clock()

    def found(self, subject: str, reason: str) -> None:
        """Note the fault of a subject, "" for none."""
        self._found[subject] = reason

    def commanded(self, voltage: Sequence[float]) -> None:
        """Note the voltages that were sent, one per channel: readings must follow them."""
        for wire, volt in zip(self._wires.values(), voltage, strict=True):
            wire.command(volt)

    def begin(self) -> None:
        """Begin a run: `unanswered` is about its commands only."""
        for wire in self._wires.values():
            wire.asked = wire.unanswered = 0.0

    def unanswered(self) -> str:
        """Report of a wire that got 0 V in spite of the commands since the run began, or ""."""
        return next((f"disagreement: {wire.name} got 0 V, commanded up to {wire.unanswered:.2f} V"
                     for wire in self._wires.values() if wire.unanswered > 0.0), "")

    def strays(self, now: float) -> str:
        """Report of a wire whose voltage has deviated from its command for `_STRAY_TIME`, even if
        not for long enough to break the rule, or ""."""
        for wire in self._wires.values():
            begun, readings = wire.since.get("follows", (now, 0))
            if now - begun >= _STRAY_TIME and readings >= _LEAST_READINGS:
                return (f"disagreement: {wire.name} gets {wire.volt:.2f} V, commanded "
                        f"{wire.commands[-1]:.2f} V")
        return ""

    def temperature(self, channel: str, kelvin: float, stamp: float, now: float,
                    limits: Limits) -> None:
        """Note a temperature in K; NaN or infinite is not a reading and makes nothing fresh."""
        wire, subject = self._wires[channel], f"{channel}/temperature"
        wire.temperature(kelvin, stamp, limits)
        if math.isfinite(kelvin):
            self._fresh[subject].seen(stamp, now)
        reasons = broken(temperature_rules(wire, limits, self._timeout), now, wire.since)
        self.found(subject, next(iter(reasons.values()), ""))

    def power(self, channel: str, volt: float, ampere: float, stamp: float, now: float,
              limits: Limits) -> None:
        """Note voltage in V and current in A; both NaN or infinite is not a reading."""
        wire, subject = self._wires[channel], f"{channel}/power"
        least = min(wire.sent, default=0.0)  # a reading between two pulses may show only this
        wire.power(volt, ampere, stamp, limits)
        if math.isfinite(volt) or math.isfinite(ampere):
            self._fresh[subject].seen(stamp, now)
        unseen = bool(self._fresh[f"{channel}/temperature"].fault(now))
        rules = power_rules(wire, limits, self._timeout, unseen)
        self.found(subject, next(iter(broken(rules, now, wire.since).values()), ""))
        idle = limits.allowed_deviation(0.0)
        if volt > idle:
            wire.asked = wire.unanswered = math.nan
        elif math.isfinite(volt) and limits.reading(least) > 2.0 * idle and wire.asked > 0.0:
            wire.unanswered = wire.asked

    def boards(self, amperes: Sequence[float], volts: Sequence[float], now: float,
               limits: Limits) -> None:
        """Note the boards' mean currents (A) and voltages (V, summed over the wires)."""
        flowing = []
        for (side, since), ampere, volt in zip(self._boards.items(), amperes, volts, strict=True):
            reasons = broken(board_rules(side, ampere, volt, limits), now, since)
            flowing += [reasons[FLOWING]] if FLOWING in reasons else []
            self.found(f"{side} board", next(iter(reasons.values()), ""))
        self.flowing = "; ".join(flowing)

    def doubt(self) -> str:
        """Report of readings that may be later than they seem, if their clock is right, or ""."""
        doubts = (fresh.doubt(self._timeout) for fresh in self._fresh.values())
        return next(filter(None, doubts), "")

    def oldest(self, now: float) -> float:
        """Age (s) of the oldest required reading."""
        return max((now - self._fresh[name].fed for name in self.wanted), default=0.0)

    def fault(self, now: float) -> str:
        """First reason not to drive the wires at `now` s, or ""."""
        stale = (self._fresh[name].fault(now) for name in self.wanted)
        return next(filter(None, (*self._found.values(), *stale)), "")

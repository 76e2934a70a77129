"""Controllers on a reference, followed as a protocol is (`run.OpenLoop`). No ROS."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from sma_bench.errors import InputError
from sma_bench.hardware.safety import Freshness
from sma_bench.live.run import OpenLoop
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import TUNING
from sma_bench.protocols import TEMPERATURE, Protocol, Quantity, Segment, load_protocol

_BEYOND = 1e4  # K or m: no reading, and one of them would leave an integral full for ever


class ClosedLoop(OpenLoop):
    """Holds wires at temperatures (experiment E8), or bends a bench as wanted. A reference from a
    topic goes on until it is stopped. SI units."""

    def __init__(
        self, quantity: Quantity, settings: dict[str, Any], parameters: Parameters,
        follow: Callable[[Sequence[float]], None], freshness: Freshness | None = None,
    ) -> None:
        """`follow` hears each level that is wanted; without fresh readings, where there is a
        `freshness`, it does not drive."""
        # Controllers load the linear model, which an experiment with volts does without.
        from sma_bench.control import DeflectionController, TemperatureController

        if quantity is TEMPERATURE and "temperature" not in settings["feedback"]:
            raise InputError("feedback: temperature control cannot do without temperature")
        self._quantity, self._follow, self._freshness = quantity, follow, freshness
        self._controller: Any = DeflectionController if quantity.tip else TemperatureController
        self._period = 1.0 / settings["command_rate"]
        self._asked: Sequence[float] | None = None
        self._readings = dict.fromkeys(quantity.targets(parameters), math.nan)
        # The first design also compiles the physics, which must not wait for the start.
        self.begin(settings, parameters)

    def plan(self, settings: dict[str, Any], parameters: Parameters) -> Protocol:
        """The reference, every level of it within the bench's reach."""
        if not settings["reference"]:  # at rest, until one comes from the topic
            names, rest = self._quantity.targets(parameters), self._quantity.rest(parameters)
            level = (rest,) * len(names)
            return Protocol("topic", names, (Segment("follow", math.inf, level, level),), rest=rest)
        reference = load_protocol(settings["reference"], parameters, self._quantity)
        for segment in reference.segments:
            for level in (segment.start, segment.stop):
                if fault := self._controller.reference_fault(level, parameters):
                    raise InputError(f"{reference.name}: {segment.step}: {fault}")
        return reference

    def begin(self, settings: dict[str, Any], parameters: Parameters) -> None:
        """Design the controller anew, for the parameters of the moment."""
        self._asked = None
        tuning = {p.name: settings[p.name] for p in TUNING}
        self._law = self._controller(parameters, self._period, **tuning)

    def volts(self, protocol: Protocol, elapsed: float) -> list[float]:
        wanted, upcoming = (
            protocol.level(moment).tolist() if self._asked is None else self._asked
            for moment in (elapsed, elapsed + self._period)
        )
        self._follow(wanted)
        readings, period = list(self._readings.values()), self._period
        if self._quantity.tip:
            volts = self._law.step(wanted[0], readings[0], period, upcoming[0])
        else:
            volts = self._law.step(wanted, readings, period)
        return list(volts.tolist())

    def fault(self, now: float) -> str:
        return self._freshness.fault(now) if self._freshness else ""

    def ask(
        self, levels: Sequence[float], followed: Protocol | None, parameters: Parameters
    ) -> str:
        """Take a reference from the topic, where what is followed has no end; why not, or ""."""
        if followed is None or math.isfinite(followed.duration):
            return "the reference is not taken from the topic now"
        fault: str = self._controller.reference_fault(levels, parameters)
        if not fault:
            self._asked = levels
        return fault

    def measured(self, name: str, value: float, stamp: float, now: float) -> None:
        """A channel's temperature, or the tip's position, acquired at `stamp` s; a gap (the
        camera's shutter) is bridged by the last one until that is stale."""
        if abs(value) < _BEYOND:
            self._readings[name] = value
            if self._freshness:
                self._freshness.seen(stamp, now)

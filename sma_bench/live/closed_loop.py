"""Controllers on a reference, followed as a protocol is (`run.OpenLoop`). No ROS."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from sma_bench.control import DeflectionController, TemperatureController
from sma_bench.control.deflection import deflection_reference_fault
from sma_bench.control.temperature import temperature_reference_fault
from sma_bench.errors import InputError
from sma_bench.hardware.safety import Freshness
from sma_bench.live.run import OpenLoop
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import TUNING
from sma_bench.protocols import Protocol, Segment
from sma_bench.protocols.reading import DEFLECTION, TEMPERATURE, Quantity, load_reference


class ClosedLoop(OpenLoop, ABC):
    """A controller on a reference; one from a topic goes on until it is stopped. SI units.

    Attributes:
        quantity: of the reference; controller: of a bench's parameters, a period and the tuning.
        reference_fault: why levels cannot be followed on a bench, or "".
    """

    quantity: ClassVar[Quantity]
    controller: ClassVar[Callable[..., Any]]
    reference_fault: ClassVar["staticmethod[[Sequence[float], Parameters], str]"]

    def __init__(
        self, settings: dict[str, Any], parameters: Parameters,
        follow: Callable[[Sequence[float]], None],
    ) -> None:
        """`follow` gets each setpoint."""
        self._follow = follow
        self._period = 1.0 / settings["command_rate"]
        self._asked: Sequence[float] | None = None
        # The first design also compiles the physics, which must not wait for the start.
        self.begin(settings, parameters)

    @abstractmethod
    def answer(self, wanted: Sequence[float], upcoming: Sequence[float]) -> list[float]:
        """Volts for levels wanted now and one period later."""

    def plan(self, settings: dict[str, Any], parameters: Parameters) -> Protocol:
        """The reference, every level of it within the bench's reach."""
        if not settings["reference"]:
            names, _ = self.quantity.targets(parameters)
            rest = self.quantity.rest(parameters)
            level = (rest,) * len(names)
            follow = Segment("follow", math.inf, level, level)
            return Protocol("topic", names, (follow,), rest=rest)
        reference = load_reference(settings["reference"], parameters, self.quantity)
        for segment in reference.segments:
            for level in (segment.start, segment.stop):
                if fault := self.reference_fault(level, parameters):
                    raise InputError(f"{reference.name}: {segment.step}: {fault}")
        return reference

    def begin(self, settings: dict[str, Any], parameters: Parameters) -> None:
        """Design the controller anew, for the parameters of the moment."""
        self._asked = None
        tuning = {parameter.name: settings[parameter.name] for parameter in TUNING}
        self._law = self.controller(parameters, self._period, **tuning)

    def volts(self, protocol: Protocol, elapsed: float) -> list[float]:
        """One step of the controller."""
        wanted, upcoming = (
            protocol.level(moment).tolist() if self._asked is None else self._asked
            for moment in (elapsed, elapsed + self._period)
        )
        self._follow(wanted)
        return self.answer(wanted, upcoming)

    def ask(
        self, levels: Sequence[float], followed: Protocol | None, parameters: Parameters
    ) -> str:
        """Take a reference from the topic, where what is followed has no end; why not, or ""."""
        if followed is None or math.isfinite(followed.duration):
            return "the reference is not taken from the topic now"
        fault = self.reference_fault(levels, parameters)
        if not fault:
            self._asked = levels
        return fault


class TemperatureLoop(ClosedLoop):
    """Holds wires at temperatures (experiment E8): one PI a wire."""

    quantity = TEMPERATURE
    controller = TemperatureController
    reference_fault = staticmethod(temperature_reference_fault)

    def __init__(self, settings: dict[str, Any], parameters: Parameters, *rest: Any) -> None:
        if "temperature" not in settings["feedback"]:
            raise InputError("feedback: temperature control cannot do without temperature")
        self._kelvin = dict.fromkeys(parameters["bench.channels"], math.nan)
        super().__init__(settings, parameters, *rest)

    def answer(self, wanted: Sequence[float], _: Sequence[float]) -> list[float]:
        """Volts for the wanted temperatures."""
        return self._law.step(wanted, list(self._kelvin.values()), self._period).tolist()

    def measured(self, channel: str, kelvin: float) -> None:
        """A gap (the camera's shutter) is bridged by the last reading until that is stale."""
        if not math.isnan(kelvin):
            self._kelvin[channel] = kelvin


class DeflectionLoop(ClosedLoop):
    """Bends the composite as wanted; without fresh deflections it does not drive."""

    quantity = DEFLECTION
    controller = DeflectionController
    reference_fault = staticmethod(deflection_reference_fault)

    def __init__(
        self, settings: dict[str, Any], parameters: Parameters, *rest: Any, freshness: Freshness
    ) -> None:
        self._deflection = math.nan
        self._freshness = freshness
        super().__init__(settings, parameters, *rest)

    def fault(self, now: float) -> str:
        """Why it cannot be followed now, or ""."""
        return self._freshness.fault(now)

    def answer(self, wanted: Sequence[float], upcoming: Sequence[float]) -> list[float]:
        """Volts for the wanted deflection."""
        return self._law.step(wanted[0], self._deflection, self._period, upcoming[0]).tolist()

    def measured(self, deflection: float, stamp: float, now: float) -> None:
        """A deflection in m, acquired at `stamp` s."""
        if math.isfinite(deflection):
            self._deflection = deflection
            self._freshness.seen(stamp, now)

"""What the controllers share: a reference instead of a protocol, all else as in `experiment`.

The same states, services, markers and safety rules; `~/setpoint` says what is followed.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from std_msgs.msg import Float64, Float64MultiArray

from sma_bench.errors import InputError
from sma_bench.nodes.base import MEASURED
from sma_bench.nodes.experiment import Experiment
from sma_bench.parameters.node_tables import TUNING
from sma_bench.protocols import Protocol, Segment
from sma_bench.protocols.reading import Quantity, load_reference


class Controller(Experiment, ABC):
    """A run ends with its reference; one from the topic goes on until stopped."""

    quantity: ClassVar[Quantity]

    def __init__(self, name: str, message: type[Float64 | Float64MultiArray]) -> None:
        super().__init__(name)
        self._period = 1.0 / self.settings["command_rate"]
        self._asked: Sequence[float] | None = None
        # The first design also compiles the physics, which must not wait for the start.
        self._law = self.design()
        self._setpoint = self.create_publisher(message, "~/setpoint", MEASURED)
        self.create_subscription(message, "~/reference", self._on_reference, 10)

    @property
    def tuning(self) -> dict[str, Any]:
        """What of the node's parameters a controller is designed with, by its arguments' names."""
        return {parameter.name: self.settings[parameter.name] for parameter in TUNING}

    @abstractmethod
    def design(self) -> Any:
        """The controller for the parameters of the moment."""

    @abstractmethod
    def reference_fault(self, level: Sequence[float]) -> str:
        """Why a reference cannot be followed, or ""."""

    @abstractmethod
    def levels_of(self, message: Any) -> list[float]:
        """Levels, SI, of a message of `~/reference`."""

    @abstractmethod
    def message_of(self, levels: Sequence[float]) -> Any:
        """The message of `~/setpoint`."""

    @abstractmethod
    def answer(self, wanted: Sequence[float], upcoming: Sequence[float]) -> list[float]:
        """Volts for levels wanted now and one period later."""

    def plan(self, settings: dict[str, Any]) -> Protocol:
        """The reference, every level of it within the bench's reach."""
        if not settings["reference"]:
            return self._without_end()
        reference = load_reference(settings["reference"], self.parameters, self.quantity)
        for segment in reference.segments:
            for level in (segment.start, segment.stop):
                if fault := self.reference_fault(level):
                    raise InputError(f"{reference.name}: {segment.step}: {fault}")
        return reference

    def volts(self, elapsed: float) -> list[float]:
        """One step of the controller."""
        wanted, upcoming = self._levels(elapsed), self._levels(elapsed + self._period)
        self._setpoint.publish(self.message_of(wanted))
        return self.answer(wanted, upcoming)

    def _start(self) -> None:
        self._asked = None
        self._law = self.design()
        super()._start()

    def _levels(self, elapsed: float) -> Sequence[float]:
        return self._protocol.level(elapsed).tolist() if self._asked is None else self._asked

    def _without_end(self) -> Protocol:
        names, _ = self.quantity.targets(self.parameters)
        rest = self.quantity.rest(self.parameters)
        level = (rest,) * len(names)
        return Protocol("topic", names, (Segment("follow", math.inf, level, level),), rest=rest)

    def _on_reference(self, message: Any) -> None:
        levels = self.levels_of(message)
        fault = "" if self._follows_topic() else "the reference is not taken from the topic now"
        if fault := fault or self.reference_fault(levels):
            self.get_logger().warning(f"rejected: {fault}", throttle_duration_sec=1.0)
            return
        self._asked = levels

    def _follows_topic(self) -> bool:
        return self._state == "running" and math.isinf(self._protocol.duration)

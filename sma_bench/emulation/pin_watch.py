"""When current could flow, as an oscilloscope at the pins and the wires would see it."""

from sma_bench.emulation.emulated_uno import EmulatedUno


class PinWatch:
    """Call `look` after every slice of the Uno's time; answers are in s of its clock."""

    def __init__(self, uno: EmulatedUno) -> None:
        self._uno = uno
        self._on_time = 0.0
        self.last_on = 0.0

    def look(self) -> None:
        """Note whether any output was high, or any wire connected, since the last look."""
        on_time = sum(self._uno.electrics.on_time) + sum(self._uno.electrics.wire_time)
        if on_time > self._on_time:
            self.last_on = self._uno.time
        self._on_time = on_time

    @property
    def off_for(self) -> float:
        """Time since an output was high or a wire connected."""
        return self._uno.time - self.last_on

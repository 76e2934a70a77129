"""One wire frame after frame, and what it means when it is not seen. No ROS.

A wire as warm as its background cannot be seen, and at rest it is just that. Where `cold` wires are
to be read, an unseen one is read as its background, give or take what could just be seen: but not
when it was clear to see in the frame before (it left its region), and not when its heating should
show.
"""

import math

from sma_bench.hardware.expectation import WireModel
from sma_bench.hardware.safety import CELSIUS_ZERO
from sma_bench.hardware.thermal_image import Frame, Surface, band_radiance, slope_at
from sma_bench.hardware.thermal_wire import CLEAR, Optics, Region, WireReading, read_wire
from sma_bench.parameters import Parameters

# A wire this many times clearer than the least visible one does not fade within this time [s].
_TOO_CLEAR_TO_FADE = 4.0
_NO_TIME_TO_FADE = 0.1
# Share of the modelled temperature rise that is believed: parameters may be off by a factor.
_BELIEVED = 0.3


class ExpectedWarmth:
    """Temperature that a wire should have from its voltage, by eq. (2)."""

    def __init__(self, parameters: Parameters) -> None:
        """Starts at the ambient temperature."""
        self._model = WireModel.from_parameters(parameters)
        self._kelvin = self._model.ambient
        self._volts = 0.0
        self._time = math.nan

    def voltage(self, volts: float, time: float) -> None:
        """The wire has `volts` V from `time` s on; not a number is passed over."""
        if not math.isfinite(volts):
            return
        self._advance(time)
        self._volts = volts

    def kelvin(self, time: float) -> float:
        """Temperature in K at `time` s that can be relied upon: a share of the model's rise."""
        self._advance(time)
        ambient = self._model.ambient
        return ambient + _BELIEVED * (self._kelvin - ambient)

    def _advance(self, time: float) -> None:
        elapsed = time - self._time
        if elapsed > 0.0:
            self._kelvin = self._model.warmed(self._kelvin, self._volts, elapsed)
        self._time = time


class WireGauge:
    """Reads one wire in frame after frame."""

    def __init__(
        self, region: Region, optics: Optics, surface: Surface, cold: bool = False
    ) -> None:
        """`cold` wires, not warmer than their background, are read as well."""
        self.region = region
        self._optics = optics
        self._surface = surface
        self._cold = cold
        self.reset()

    def reset(self) -> None:
        """Forget where the wire was, and that it was lost."""
        self._seen = -math.inf
        self._clearness = 0.0
        self._lost = False

    def read(self, frame: Frame, time: float, expected: float = 0.0) -> WireReading:
        """The wire in a frame taken at `time` s, when it should have `expected` K or more."""
        reading = read_wire(frame, self.region, self._optics, self._surface, self._cold)
        if reading.seen:
            self._seen, self._clearness, self._lost = time, reading.clearness, False
        elif time - self._seen <= _NO_TIME_TO_FADE:
            self._lost |= self._clearness > _TOO_CLEAR_TO_FADE * CLEAR
        held_for_itself = bool(reading.seen and reading.reason) or math.isnan(reading.background)
        if not self._cold or held_for_itself or reading.kelvin > reading.background:
            return reading
        if expected > reading.background + reading.limit:
            celsius = expected - CELSIUS_ZERO
            return WireReading(
                reason=f"wire not seen where its voltage makes it {celsius:.1f} degC or more"
            )
        if reading.seen:
            return reading
        if self._lost:
            return WireReading(reason="wire lost while clear to see: it left its region")
        return self._at_background(reading)

    def _at_background(self, reading: WireReading) -> WireReading:
        slope = slope_at(reading.background)
        deviation = math.hypot(reading.limit / 2.0, self._optics.accuracy) * slope
        apparent = float(band_radiance(reading.background))
        kelvin, std = self._surface.temperature(apparent, deviation)
        return WireReading(
            kelvin=kelvin, std=std, background=reading.background, limit=reading.limit,
            reason="less radiance than the reflected one alone" if math.isnan(kelvin) else "",
        )

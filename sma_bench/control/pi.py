"""A PI controller with anti-windup, and the rule that tunes it.

    u = sat[u_ff + K (r - y) + I],   dI/dt = K/T_i (r - y) + (sat[u] - u)/T_t

sat limits the output and its rate. The second term (back-calculation) leads the integral back to
what the output can do. I is kept in units of the output, so that gains may change without a bump.
"""

import math
from dataclasses import dataclass
from typing import Self

from sma_bench.errors import InputError


@dataclass(frozen=True)
class Gains:
    """Gains of a PI controller; it validates itself.

    Attributes:
        proportional: K, output per unit of error.
        integral_time: T_i [s].
        tracking_time: T_t [s] of the anti-windup; T_i when not given.
    """

    proportional: float
    integral_time: float
    tracking_time: float = 0.0

    def __post_init__(self) -> None:
        if self.tracking_time == 0.0:
            object.__setattr__(self, "tracking_time", self.integral_time)
        if not math.isfinite(self.proportional):
            raise InputError(f"gains: proportional is {self.proportional}, expected finite")
        for name in ("integral_time", "tracking_time"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise InputError(f"gains: {name} is {value} s, expected positive and finite")

    @classmethod
    def simc(
        cls, gain: float, time_constant: float, delay: float, closed_loop_time: float = 0.0
    ) -> Self:
        """Tuned for gain e^(-delay s)/(time_constant s + 1) by Skogestad's rule (SIMC, 2003).

        K = tau/(k (tau_c + theta)), T_i = min(tau, 4 (tau_c + theta)). The reference step response
        then is that of a lag tau_c after the delay, without overshoot while T_i = tau.

        Args:
            gain: k, output of the plant per unit of its input.
            time_constant: tau [s]; delay: theta [s].
            closed_loop_time: tau_c [s]; 0 for half the time constant, or the delay if longer:
                slow enough for T_i = tau, fast enough to halve the time.

        Raises:
            InputError: a number that no plant has.
        """
        for name, value in (("time_constant", time_constant), ("gain", abs(gain))):
            if not 0.0 < value < math.inf:
                raise InputError(f"tuning: {name} is {value}, expected positive and finite")
        for name, value in (("delay", delay), ("closed_loop_time", closed_loop_time)):
            if not 0.0 <= value < math.inf:
                raise InputError(f"tuning: {name} is {value} s, expected 0 or more")
        wanted = (closed_loop_time or max(0.5 * time_constant, delay)) + delay
        return cls(time_constant / (gain * wanted), min(time_constant, 4.0 * wanted))


@dataclass(frozen=True)
class OutputLimits:
    """Range of the output and of its rate [1/s]; it validates itself."""

    low: float
    high: float
    rate: float = math.inf

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise InputError(f"output limits: low is {self.low} above high {self.high}")
        if not self.rate > 0.0:
            raise InputError(f"output limits: rate is {self.rate}, expected more than 0")

    def applied(self, output: float, last: float, dt: float) -> float:
        """The output nearest to the wanted one; leaving the range's outside is never delayed."""
        step = self.rate * dt
        slowed = min(max(output, last - step), last + step)
        return min(max(slowed, self.low), self.high)


class PI:
    """One loop. Time comes in as dt; there is no clock."""

    def __init__(self, gains: Gains, limits: OutputLimits) -> None:
        self.gains = gains
        self.limits = limits
        self._integral = 0.0
        self._output = 0.0

    @property
    def output(self) -> float:
        """The last output."""
        return self._output

    @property
    def integral(self) -> float:
        """I, in units of the output."""
        return self._integral

    def reset(self) -> None:
        """Forget everything; the output starts from 0 or the limit nearest to it."""
        self._integral = 0.0
        self._output = min(max(0.0, self.limits.low), self.limits.high)

    def take_over(
        self, output: float, reference: float, measured: float, feedforward: float = 0.0
    ) -> None:
        """Begin without a bump: at this reference and reading the next output is `output`."""
        self._output = min(max(output, self.limits.low), self.limits.high)
        error = reference - measured
        self._integral = self._output - feedforward - self.gains.proportional * error

    def step(
        self, reference: float, measured: float, dt: float, feedforward: float = 0.0
    ) -> float:
        """The output from now until `dt` s later.

        Raises:
            InputError: a number that is not finite, or dt not above 0.
        """
        if not 0.0 < dt < math.inf:
            raise InputError(f"PI: dt is {dt} s, expected positive and finite")
        error = reference - measured
        if not math.isfinite(error + feedforward):
            raise InputError(
                f"PI: reference {reference}, measured {measured}, feedforward {feedforward}, "
                "expected finite numbers"
            )
        gains = self.gains
        wanted = feedforward + gains.proportional * error + self._integral
        self._output = self.limits.applied(wanted, self._output, dt)
        self._integral += gains.proportional * error * dt / gains.integral_time
        self._integral += (self._output - wanted) * min(dt / gains.tracking_time, 1.0)
        return self._output

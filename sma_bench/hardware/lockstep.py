"""How far simulated time may go: not faster than asked, not ahead of an active driver."""

import math

# Of the command timeout: how far simulated time may run ahead of a driver that is slower than
# declared.
_SLOW_DRIVER_LEAD = 0.5
# Wall seconds of delay that are caught up; longer ones (waiting for a driver) are not.
_DEBT = 0.01
REAL_TIME = 1.0


class Lockstep:
    """Couples simulated time to the commands, so that results do not depend on the machine's load.

    Simulated time runs in slices, as long as the period of the commands. While commands come, one
    slice is run for each. A driver that stays away for `patience` s of wall time is either slower
    than declared, and is waited for less often from then on, or gone, and its silence runs into
    the command timeout as it would on the real bench.
    At real time it is the other way round: time waits for nobody, and every delay is caught up.

    All times in s; `simulated` counts from the start of the simulation, `wall` is a steady clock.
    """

    def __init__(
        self, slice_length: float, speed: float, command_timeout: float, patience: float
    ) -> None:
        self._slice = slice_length
        self._pace = slice_length / speed
        self._real_time = speed <= REAL_TIME
        self._timeout = command_timeout
        self._patience = patience
        self._lead = slice_length
        self._commanded = -math.inf
        self._due: float | None = None
        self._waiting_since: float | None = None
        self._given_up = False

    def commanded(self, simulated: float) -> None:
        """A command was accepted at `simulated` s."""
        if simulated - self._commanded > self._timeout:
            self._lead = self._slice
        self._commanded = simulated
        self._waiting_since = None
        self._given_up = False

    def may_advance(self, simulated: float, wall: float) -> bool:
        """True when the next slice, which starts at `simulated` s, may be run now."""
        due = wall if self._due is None else self._due
        if wall < due or self._must_wait(simulated, wall):
            return False
        self._due = (due if self._real_time else max(due, wall - _DEBT)) + self._pace
        return True

    def _must_wait(self, simulated: float, wall: float) -> bool:
        silence = simulated - self._commanded
        if self._real_time or self._given_up or silence > self._timeout:
            return False
        if silence + self._slice <= self._lead * (1.0 + 1e-6):
            return False
        if self._waiting_since is None:
            self._waiting_since = wall
        if wall - self._waiting_since <= self._patience:
            return True
        self._give_in()
        return False

    def _give_in(self) -> None:
        slow = max(self._slice, _SLOW_DRIVER_LEAD * self._timeout)
        self._given_up = self._lead >= slow
        self._lead = slow
        self._waiting_since = None

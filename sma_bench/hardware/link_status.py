"""What a serial link counts and tells."""

from dataclasses import dataclass, field

from sma_bench.hardware.device import DeviceIdentity
from sma_bench.hardware.serial_messages import CAUSES, State, Telemetry, name_of

_NUMBERS = 1 << 16
_CLOCK = 1 << 32


@dataclass(frozen=True)
class Reading:
    """Telemetry with its time of acquisition: host s, the middle of the window."""

    telemetry: Telemetry
    time: float


@dataclass
class LinkStatus:
    """A snapshot; counts are since the link was made."""

    connected: bool = False
    device: DeviceIdentity | None = None
    state: State = State.IDLE
    cause: int = 0
    telemetry: int = 0
    lost: int = 0
    damaged: int = 0
    not_understood: int = 0
    refused: int = 0
    last_refusal: str = ""
    silence: str = ""
    """why the device heard no command, as far as this host knows; "" unless it timed out"""
    unasked: str = ""
    """newest answer, since this host armed, to what it had not asked"""
    counters: dict[str, int] = field(default_factory=dict)
    """the device's own (S line), once a second"""
    connections: int = 0
    round_trip: float = float("nan")
    command_latency: float = float("nan")
    """s from sending a command to the telemetry that echoes it"""
    drift: float = 0.0
    clock_uncertainty: float = float("inf")
    problem: str = ""
    _last: Telemetry | None = field(default=None, repr=False)

    @property
    def newest(self) -> Telemetry | None:
        """The last frame of this connection."""
        return self._last

    @property
    def stopped(self) -> bool:
        """True where the device wants a reset first."""
        return self.state in (State.STOPPED, State.STILL_FLOWING)

    @property
    def cause_text(self) -> str:
        """Why the device stopped, in words; "" when it did not."""
        return name_of(CAUSES, self.cause)

    def note(self, telemetry: Telemetry) -> None:
        """Count a frame and those missing before it."""
        if self._last is not None:
            self.lost += (telemetry.sequence - self._last.sequence - 1) % _NUMBERS
        self._last = telemetry
        self.telemetry += 1
        self.state = State(telemetry.state)
        self.cause = telemetry.cause

    def start_anew(self, device: DeviceIdentity) -> None:
        """A new connection; its first frame is not late."""
        self.connected, self.device, self.problem = True, device, ""
        self.connections += 1
        self.state, self.cause = State.IDLE, 0
        self._last = None

    def restarted(self, telemetry: Telemetry, period_us: int) -> bool:
        """True when the device started anew since the last frame; windows last `period_us`.

        Its clock went back, or, where half a turn of the clock hides that, windows were missed
        that do not fill the time that seems to have passed.
        """
        if self._last is None:
            return False
        elapsed = (telemetry.time_us - self._last.time_us) % _CLOCK
        windows = (telemetry.sequence - self._last.sequence) % _NUMBERS
        left = (elapsed - windows * period_us + period_us) % (_NUMBERS * period_us)
        # The window in which the rate was set is shorter or longer.
        return elapsed > _CLOCK // 2 or (windows != 1 and left > 2 * period_us)

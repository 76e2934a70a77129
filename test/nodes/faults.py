"""Every hazard that the bridge and the firmware must survive: how it is made, seen and ended.

The test, `./bench check faults` and the table of docs/safety.md are this list.
"""

import math
import random
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from emulated_rig import BridgedRig
from uno.emulated_uno import Relay, Switch

from sma_bench.hardware.serial_messages import line

STOP = ord("!")


@dataclass(frozen=True)
class Fault:
    """One hazard on a bench that drives `volts`.

    `make` brings it about and returns the moment in s of the Uno's clock; within `limit` s of it
    the last pulse has passed. `cause` is a part of the reason that `told` (the bridge's state,
    unless it is given) reports, or several with `|` between, where both device and bridge see it
    and either may be first to be reported. `quick` ones belong to the short run of the tests;
    those of the `camera` have a synthetic one and the node `ir_camera`.
    """

    name: str
    hazard: str
    detection: str
    limit: float
    cause: str
    make: Callable[[BridgedRig], float]
    volts: float = 3.0
    quick: bool = False
    camera: bool = False
    reaction: str = "0 V until a reset"
    told: Callable[[BridgedRig], str] = lambda rig: rig.state
    settings: dict[str, object] = field(default_factory=dict)
    """parameters of the bridge; one without temperatures in its `feedback` gets none"""

    @property
    def by_host(self):
        """True where the bridge, not the device, has to notice."""
        return "bridge" in self.detection

    @property
    def row(self):
        """The line of docs/safety.md."""
        limit = f"{1e3 * self.limit:.0f} ms"
        return f"| {self.hazard} | {self.detection} | {self.reaction} | {limit} | `{self.name}` |"


def _do(job):
    """A fault that is made between two slices of the bench's time."""
    return lambda rig: rig.hardware.do(lambda: job(rig))


def _signal(number):
    return _do(lambda rig: rig.node.process.send_signal(number))


def _electrics(**values):
    """Numbers at the pins; of wires by their channel."""

    def change(rig):
        for name, value in values.items():
            if isinstance(value, dict):
                for channel, number in value.items():
                    getattr(rig.hardware.uno.electrics, name)[channel] = number
            else:
                setattr(rig.hardware.uno.electrics, name, value)

    return _do(change)


_now = _do(lambda rig: None)


def _after_restart(rig):
    """What a new bridge knows, whose opening of the port has reset the device."""
    rig.diagnostics.clear()
    rig.node = rig.bench.start("serial_bridge", port=rig.hardware.path)
    rig.until(lambda: rig.value("last_reset"))
    return f"{rig.state}, last reset: {rig.value('last_reset')}"


def _after_waking(rig):
    rig.node.process.send_signal(signal.SIGCONT)
    rig.until(lambda: rig.state.startswith("stopped"))
    return rig.state


def _hang(interrupts):
    def make(rig):
        rig.for_a_while(1.0)  # until the drop is known, most periods have no pulse to be cut off
        return rig.hardware.do(lambda: rig.hardware.uno.hang(interrupts=interrupts))

    return make


def _noise(rig):
    """Garbage that leaves no pause for a command, for half a second of the Uno's time."""
    draw = random.Random(1)
    noise = bytes(b for _ in range(12000) if (b := draw.randrange(256)) not in (STOP, 10, 13))
    rig.hardware.uno.write(noise)


def _replay(rig):
    """All that the host said so far, again, after a stop and a reset."""
    said = bytes(b for b in rig.said if b != STOP)
    assert b"V " in said
    rig.ask("stop")
    rig.ask("reset")
    return rig.hardware.do(lambda: rig.hardware.uno.write(said))


def _rig(**values):
    """What the test commands (`voltage`, V) and its camera sees (`kelvin`, `fever`) from now on."""

    def make(rig):
        vars(rig).update(values)
        return _now(rig)

    return make


def _camera_fault(kind):
    def make(rig):
        moment = _now(rig)
        assert rig.bench.set_parameter("synthetic_camera", "fault", kind).successful
        return moment

    return make


def _with_camera(rig):
    """What the bridge says, and what the camera's node does."""
    rig.until(lambda: rig.camera_says() not in ("", "running"))
    return f"{rig.state} (ir_camera: {rig.camera_says()})"


def _full_disk(rig):
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        rig.record(bag)
        moment = rig.hardware.do(lambda: rig.fill_disk(bag))
        rig.until(lambda: rig.recorder.process.poll() is not None)
        return moment


def _second_host(rig):
    """The handshake of a host that the port's lock did not keep out, and its attempt to arm."""
    says = b"".join(line(body) for body in ("T 100", "?", "A 1", "V 1 1 9000 0 0 0"))
    rig.hardware.uno.write(b"\n" + says)


def _break(rig, kind):
    """A switch, while the relay is open and nothing is enabled."""
    rig.ask("stop")
    assert rig.ask("reset").success
    rig.for_a_while(0.2)
    return _electrics(switch_is={0: kind})(rig)


def _enable_with(kind):
    def make(rig):
        _break(rig, kind)
        rig.voltage = (0.0,)
        moment = _now(rig)
        answer = rig.ask("enable")
        assert not answer.success
        rig.refusal = answer.message
        return moment

    return make


def _stuck_behind_a_welded_relay(rig):
    """Nothing can end it but the plug, which is pulled when the bridge says so."""
    electrics = rig.hardware.uno.electrics
    rig.find("enable")
    electrics.relay_is = Relay.WELDED
    moment = _break(rig, Switch.STUCK_ON)
    rig.until(lambda: rig.state.startswith("still flowing"))
    rig.refusal = rig.state
    for service in ("enable", "reset"):
        answer = rig.ask(service)
        assert not answer.success and answer.message.startswith("still flowing"), answer.message
    electrics.relay_is = Relay.HELD_OPEN
    return moment


# The timers' interrupts may be off, and nobody did it.
_TIMSK0, _TIMSK1 = 0x6E, 0x6F


def _too_much_heat(rig):
    rig.kelvin = float(rig.hardware.plant.bench.temperature[0])  # from now on
    rig.voltage = (8.5,)
    return _now(rig)


def _nonsense(rig):
    """Only commands that must be rejected."""
    moment = _rig(voltage=None)(rig)
    for bad in ((math.nan,), (math.inf,), (), (1.0, 2.0), (10.5,), (-1.0,)):
        rig.send(*bad)
    return moment


def _request(service):
    def ask(rig):
        rig.find(service)
        moment = _now(rig)
        rig.ask(service)
        return moment

    return ask


def _value(key):
    def told(rig):
        seen, end = len(rig.diagnostics), time.monotonic() + 5.0
        rig.until(lambda: len(rig.diagnostics) > seen + 1 or time.monotonic() > end)
        return f"{key}: {rig.value(key)}"

    return told


FAULTS = (
    Fault("host_killed", "host process killed (-9)", "device: command timeout 0.2 s", 0.25,
          "after: command timeout", _signal(signal.SIGKILL), told=_after_restart, quick=True),
    Fault("host_hung", "bridge hangs (SIGSTOP)", "device: command timeout 0.2 s", 0.25,
          "command timeout", _signal(signal.SIGSTOP), told=_after_waking, quick=True),
    Fault("host_ended", "bridge ended (SIGTERM)", "bridge: stop byte at its end", 0.25,
          "after: stop byte", _signal(signal.SIGTERM), told=_after_restart),
    Fault("cable_pulled", "serial cable pulled", "device: command timeout 0.2 s", 0.25,
          "not connected", _do(lambda rig: rig.hardware.port.unplug())),
    Fault("commander_silent", "commanding node dies", "bridge: bench.command_timeout 0.5 s", 0.7,
          "command_timeouts: 1", _rig(voltage=None), told=_value("command_timeouts"),
          reaction="0 V until the next command"),
    Fault("nonsense_commanded", "NaN, infinite, too many or too large volts",
          "bridge: rejected, counted, then its command timeout", 0.7,
          "voltage_command has -1 V", _nonsense, told=_value("last_rejection"),
          reaction="outputs unchanged, then 0 V until the next command"),
    Fault("stop_requested", "somebody calls ~/stop", "bridge: stop byte", 0.25,
          "stopped on request", _request("stop")),
    Fault("line_noise", "garbage on the line", "device: checksums, then its command timeout",
          0.25, "command timeout", _do(_noise), quick=True),
    Fault("commands_replayed", "recorded commands sent again", "device: session and sequence",
          0.01, "idle", _replay, reaction="refused, nothing is driven"),
    Fault("two_hosts", "second host gets through to the device",
          "device: a greeting disarms; bridge: answers that it did not ask for", 0.25,
          "another host speaks to the device", _do(_second_host), quick=True),
    Fault("firmware_hung", "firmware's main loop hangs", "device: 30 ms without its loop", 0.04,
          "the device restarted", _hang(interrupts=True), quick=True),
    Fault("firmware_dead", "firmware hangs, interrupts off", "device: watchdog 64 ms", 0.08,
          "the device restarted", _hang(interrupts=False)),
    Fault("short_circuit", "wire short-circuited at 6 V",
          "device: each current, and its mean against the duties through the least resistance",
          0.02, "found by the device|over-current: wire", _electrics(resistance={0: 0.3}),
          volts=6.0, quick=True),
    Fault("clipped_short", "wire short-circuited at 1 V, where a sensor that clips hides it",
          "device: mean current against the duties through the least resistance", 0.1,
          "more current than the outputs explain", _electrics(resistance={0: 0.05}), volts=1.0),
    Fault("switch_shorted", "another wire's switch shorts",
          "device: mean current against the duties through the least resistance", 0.05,
          "more current than the outputs explain", _electrics(
              resistance={1: 2.7}, switch_is={1: Switch.STUCK_ON}), quick=True),
    Fault("switch_stuck", "switch stuck on before enabling",
          "bridge: self-test; device: current with all outputs off", 0.6, "relay: FAILED",
          _enable_with(Switch.STUCK_ON),
          told=lambda rig: rig.refusal, reaction="refused, relay open"),
    Fault("switch_inverted", "driver inverted, on while its pin is low",
          "bridge: self-test; device: current with all outputs off", 0.6, "relay: FAILED",
          _enable_with(Switch.INVERTED),
          told=lambda rig: rig.refusal, reaction="refused, relay open"),
    Fault("relay_welded", "switch stuck on behind a welded relay",
          "bridge and device: current with all outputs off", 2.0,
          "still flowing: pull the plug", _stuck_behind_a_welded_relay,
          told=lambda rig: rig.refusal,
          reaction="says so in state, log and diagnostics until somebody pulls the plug"),
    Fault("outputs_frozen", "interrupt of the outputs lost", "device: 5 ms without it", 0.02,
          "output interrupt lost", _do(lambda rig: rig.hardware.uno.poke(_TIMSK0, 0)), quick=True),
    Fault("clock_frozen", "interrupt of the millisecond lost", "device: watchdog 64 ms", 0.08,
          "the device restarted", _do(lambda rig: rig.hardware.uno.poke(_TIMSK1, 0))),
    Fault("heat_limit", "more heat than the rig may have, and a camera that does not see it",
          "device: mean square of a wire's volts, over its cooling time", 1.2,
          "more heat than allowed", _too_much_heat, volts=6.0,
          settings={"bench__maximum_current": 4.0}),
    Fault("over_current", "wire draws more than bench.maximum_current",
          "bridge: current of each reading", 0.25, "over-current: wire", _electrics(
              resistance={0: 2.0}), volts=6.5),
    Fault("wire_broken", "wire breaks", "bridge: current against the model for 1 s", 1.4,
          "disagreement: wire carries", _electrics(resistance={0: math.inf})),
    Fault("over_temperature", "wire hotter than bench.maximum_temperature",
          "bridge: each temperature", 0.3, "over-temperature: wire", _rig(fever=200.0), quick=True),
    Fault("heat_unseen", "wire hotter than bench.maximum_temperature, no camera",
          "bridge: eq. (1) with each reading of power", 0.9, "over-temperature by the model: wire",
          _rig(voltage=(8.0,)),
          settings={"feedback": ["power"], "bench__maximum_current": 4.0}),
    Fault("temperature_lost", "temperatures stop coming", "bridge: feedback_timeout 1 s", 1.4,
          "stale feedback: nothing new from wire/temperature", _rig(fever=None)),
    Fault("camera_lost", "camera stops sending pictures", "bridge: feedback_timeout 1 s", 1.6,
          "limit 1 s (ir_camera: no frame for", _camera_fault("silent"), camera=True,
          told=_with_camera),
    Fault("camera_frozen", "camera sends the same picture again and again",
          "ir_camera: equal pictures; bridge: feedback_timeout 1 s", 1.6,
          "limit 1 s (ir_camera: frozen", _camera_fault("frozen"), camera=True, told=_with_camera),
    Fault("camera_astray", "camera does not look at the wire",
          "bridge: temperature against the model for 1 s", 1.7,
          "disagreement: wire measured at", _rig(kelvin=296.0), volts=6.0),
    Fault("disk_full", "recorder's disk is full", "recorder, within a second; bridge: its state",
          2.0, "recording failed:", _full_disk),
    Fault("supply_lost", "supply below 6 V", "device: supply in each conversion", 0.1,
          "supply out of range|duty above its limit", _electrics(supply=3.0)),
)

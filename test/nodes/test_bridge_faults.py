"""Every hazard that bridge and firmware must survive ends with the outputs at 0 V, in time, and
with its cause reported; `./bench check faults` tries all of them.

docs/safety.md lists hazard, detection, reaction and limit; here is how each is caused and reported.
"""

import math
import random
import re
import signal
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from emulated_rig import bridged_rig
from uno.emulated_uno import Relay, Switch

from sma_bench.hardware.serial_messages import line

STOP = ord("!")
# Interrupt masks of the timers, which a hardware fault may clear.
TIMSK0, TIMSK1 = 0x6E, 0x6F
# s more than the limit if the host has to notice: it shares the machine with the emulator and other
# programs.
LOADED = 0.5


def rows(title):
    """Cells of the table in a section of the page, without its header."""
    page = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
    section = page.read_text().partition(f"## {title}")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


# --- Causing the faults --------------------------------------------------------------------------


def do(job):
    """A fault caused between two slices of the bench's time; returns its moment."""
    return lambda rig: rig.hardware.do(lambda: job(rig))


now = do(lambda rig: None)


def send(number):
    return do(lambda rig: rig.node.process.send_signal(number))


def poke(register):
    return do(lambda rig: rig.hardware.uno.poke(register, 0))


def electrics(channel=0, supply=None, **values):
    """Change the supply, and the wire of one channel."""

    def change(rig):
        pins = rig.hardware.uno.electrics
        pins.supply = supply or pins.supply
        for name, value in values.items():
            getattr(pins, name)[channel] = value

    return do(change)


def seen(**values):
    """Change the test's command (`voltage`, V) and its camera's readings (`kelvin`, `fever`)."""
    return do(lambda rig: vars(rig).update(values))


def hang(interrupts):
    def make(rig):
        rig.for_a_while(1.0)  # until the drop is known, most periods have no pulse to be cut off
        return rig.hardware.do(lambda: rig.hardware.uno.hang(interrupts=interrupts))

    return make


def noise(rig):
    """Garbage without a pause for a command, for half a second of the Uno's time."""
    garbage = random.Random(1).randbytes(12000)
    rig.hardware.uno.write(garbage.translate(None, bytes((STOP, 10, 13))))


def replay(rig):
    """Replay all bytes of the host after a stop and a reset."""
    said = rig.said.translate(None, bytes((STOP,)))
    assert b"V " in said
    rig.ask("stop")
    rig.ask("reset")
    return rig.hardware.do(lambda: rig.hardware.uno.write(said))


def camera(kind):
    def make(rig):
        moment = now(rig)
        assert rig.bench.set_parameter("synthetic_camera", "fault", kind).successful
        return moment

    return make


def full_disk(rig):
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        rig.record(bag)
        moment = rig.hardware.do(lambda: rig.fill_disk(bag))
        rig.until(lambda: rig.recorder.process.poll() is not None)
        return moment


def second_host(rig):
    """The handshake of a second host, in spite of the port's lock, and its attempt to arm."""
    says = b"".join(line(body) for body in ("T 100", "?", "A 1", "V 1 1 9000 0 0 0"))
    rig.hardware.uno.write(b"\n" + says)


def break_switch(rig, kind):
    """Break a switch while the relay is open and nothing is enabled."""
    rig.ask("stop")
    assert rig.ask("reset").success
    rig.for_a_while(0.2)
    return electrics(switch_is=kind)(rig)


def enable_with(kind):
    def make(rig):
        break_switch(rig, kind)
        rig.voltage = (0.0,)
        moment, answer = now(rig), rig.ask("enable")
        assert not answer.success
        rig.refusal = answer.message
        return moment

    return make


def stuck_behind_a_welded_relay(rig):
    """Only the plug can end this current; it is pulled when the bridge reports it."""
    pins = rig.hardware.uno.electrics
    rig.find("enable")
    pins.relay_is = Relay.WELDED
    moment = break_switch(rig, Switch.STUCK_ON)
    rig.until(lambda: rig.state.startswith("still flowing"))
    rig.refusal = rig.state
    for service in ("enable", "reset"):
        answer = rig.ask(service)
        assert not answer.success and answer.message.startswith("still flowing"), answer.message
    pins.relay_is = Relay.HELD_OPEN
    return moment


def too_much_heat(rig):
    return seen(kelvin=float(rig.hardware.plant.bench.temperature[0]), voltage=(8.5,))(rig)


def nonsense(rig):
    """Send only commands that must be rejected."""
    moment = seen(voltage=None)(rig)
    for bad in ((math.nan,), (math.inf,), (), (1.0, 2.0), (10.5,), (-1.0,)):
        rig.send(*bad)
    return moment


def stop(rig):
    rig.find("stop")
    moment = now(rig)
    rig.ask("stop")
    return moment


# --- Where the causes are reported ---------------------------------------------------------------


def state(rig):
    return rig.state


def refusal(rig):
    return rig.refusal


def after_restart(rig):
    """The report of a new bridge, which has reset the device by opening the port."""
    rig.bench.diagnostics.clear()
    rig.node = rig.bench.start("serial_bridge", port=rig.hardware.path)
    rig.until(lambda: rig.bench.value("last_reset"))
    return f"{rig.state}, last reset: {rig.bench.value('last_reset')}"


def after_waking(rig):
    rig.node.process.send_signal(signal.SIGCONT)
    rig.until(lambda: rig.state.startswith("stopped"))
    return rig.state


def seen_by(rig):
    """The reports of the bridge and of the camera's node."""
    part = "ir_camera: camera"
    rig.until(lambda: rig.bench.status(part) and rig.bench.status(part).message != "running")
    return f"{rig.state} (ir_camera: {rig.bench.status(part).message})"


def value(key):
    def told(rig):
        known, end = len(rig.bench.diagnostics), time.monotonic() + 5.0
        rig.until(lambda: len(rig.bench.diagnostics) > known + 1 or time.monotonic() > end)
        return f"{key}: {rig.bench.value(key)}"

    return told


def fault(cause, make, told=state, volts=3.0, quick=False, camera=False, **settings):
    """One hazard on a bench that drives `volts`, whose bridge has these `settings`.

    `make` causes it and returns its moment in s of the Uno's clock. `cause` is a part of the reason
    that `told` returns, or several separated by `|` if device and bridge both detect it and either
    may report first. `quick` ones belong to the short run of the tests; those with `camera` have a
    synthetic one and the node `ir_camera`.
    """
    return SimpleNamespace(**locals())


STRONG = {"bench__maximum_current": 4.0}
FAULTS = {
    "host_killed": fault("after: command timeout", send(signal.SIGKILL), after_restart, quick=True),
    "host_hung": fault("command timeout", send(signal.SIGSTOP), after_waking, quick=True),
    "host_ended": fault("after: stop byte", send(signal.SIGTERM), after_restart),
    "cable_pulled": fault("not connected", do(lambda rig: rig.hardware.port.unplug())),
    "commander_silent": fault("command_timeouts: 1", seen(voltage=None), value("command_timeouts")),
    "nonsense_commanded": fault("voltage_command has -1 V", nonsense, value("last_rejection")),
    "stop_requested": fault("stopped on request", stop),
    "line_noise": fault("command timeout", do(noise), quick=True),
    "commands_replayed": fault("idle", replay),
    "two_hosts": fault("another host speaks to the device", do(second_host), quick=True),
    "firmware_hung": fault("the device restarted", hang(interrupts=True), quick=True),
    "firmware_dead": fault("the device restarted", hang(interrupts=False)),
    "short_circuit": fault(
        "found by the device|over-current: wire", electrics(resistance=0.3), volts=6.0, quick=True
    ),
    "clipped_short": fault(
        "more current than the outputs explain", electrics(resistance=0.05), volts=1.0
    ),
    "switch_shorted": fault(
        "more current than the outputs explain",
        electrics(1, resistance=2.7, switch_is=Switch.STUCK_ON), quick=True,
    ),
    "switch_stuck": fault("relay: FAILED", enable_with(Switch.STUCK_ON), refusal),
    "switch_inverted": fault("relay: FAILED", enable_with(Switch.INVERTED), refusal),
    "relay_welded": fault("still flowing: pull the plug", stuck_behind_a_welded_relay, refusal),
    "outputs_frozen": fault("output interrupt lost", poke(TIMSK0), quick=True),
    "clock_frozen": fault("the device restarted", poke(TIMSK1)),
    "heat_limit": fault("more heat than allowed", too_much_heat, volts=6.0, **STRONG),
    "over_current": fault("over-current: wire", electrics(resistance=2.0), volts=6.5),
    "wire_broken": fault("disagreement: wire carries", electrics(resistance=math.inf)),
    "over_temperature": fault("over-temperature: wire", seen(fever=200.0), quick=True),
    "heat_unseen": fault(
        "over-temperature by the model: wire", seen(voltage=(8.0,)), feedback=["power"], **STRONG
    ),
    "temperature_lost": fault(
        "stale feedback: nothing new from wire/temperature", seen(fever=None)
    ),
    "camera_lost": fault(
        "limit 1 s (ir_camera: no frame for", camera("silent"), seen_by, camera=True
    ),
    "camera_frozen": fault(
        "limit 1 s (ir_camera: frozen", camera("frozen"), seen_by, camera=True
    ),
    "camera_astray": fault("disagreement: wire measured at", seen(kelvin=296.0), volts=6.0),
    "disk_full": fault("recording failed:", full_disk),
    "supply_lost": fault("supply out of range|duty above its limit", electrics(supply=3.0)),
}  # fmt: skip


@pytest.mark.parametrize(
    ("hazard", "detection", "limit", "name"),
    [
        pytest.param(hazard, detection, float(off_within.removesuffix(" ms")) / 1e3, name, id=name,
                     marks=[] if FAULTS[name].quick else pytest.mark.acceptance)  # fmt: skip
        for hazard, detection, _, off_within, cell in rows("Each fault") for name in [cell[1:-1]]
    ],
)  # fmt: skip
def test_outputs_go_to_zero_in_time_and_the_cause_is_shown(
    request, bench, uno, hazard, detection, limit, name
):
    made = FAULTS[name]
    causes = made.cause.split("|")
    with bridged_rig(bench, uno, camera=made.camera, **made.settings) as rig:
        if "feedback" in made.settings:  # without temperatures
            rig.fever = None
        rig.enable()
        rig.drive(made.volts)
        moment = made.make(rig)
        if made.told is state:  # outputs may pause before, where a machine is busy
            rig.until(lambda: any(cause in rig.state for cause in causes))
        measured = rig.off_after(moment)
        told = made.told(rig)
    found = {"hazard": hazard, "limit": limit, "measured": measured, "told": told}
    request.node.user_properties += found.items()  # record_property warns beside --junit-xml
    assert measured < limit + (LOADED if "bridge" in detection else 0.0)
    assert any(cause in told for cause in causes), told


def test_every_single_failure_says_what_cuts_it_and_where_that_is_shown():
    assert {row[-1] for row in rows("Each fault")} == {f"`{name}`" for name in FAULTS}
    tests = "".join(path.read_text() for path in Path(__file__).parents[1].rglob("test_*.py"))
    shown = {*FAULTS, *re.findall(r"def (test_\w+)", tests)}
    failures = rows("Single failures")
    assert len(failures) > 20
    for failure, _, _, _, _, cut_by, shown_by in failures:
        assert cut_by.startswith(("software", "hardware only", "nothing")), failure
        names = re.findall(r"`(\w+)`", shown_by)
        assert set(names) <= shown, failure
        assert names or not cut_by.startswith("software"), failure
    placed = {name for row in failures for name in re.findall(r"`(\w+)`", row[-1])}
    assert FAULTS.keys() - placed <= {"host_ended", "stop_requested"}

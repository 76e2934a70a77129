"""The real image on an emulated ATmega328P, in virtual time: its messages, pins and timing."""

import math
import random
import re
import statistics
from itertools import pairwise
from pathlib import Path

import pytest
from uno.emulated_uno import Relay, Reset, Switch

from sma_bench.hardware import serial_messages
from sma_bench.hardware.bench_sensors import BenchSensors, SharedWatch
from sma_bench.hardware.safety import Limits
from sma_bench.hardware.serial_messages import CAUSES, REASONS, DeviceState, Named, command, line
from sma_bench.parameters import Parameters
from sma_bench.parameters.node_tables import SERIAL_BRIDGE

SIDES = ("front", "front", "back", "back")
SENSORS = BenchSensors(SIDES, {p.name: p.default for p in SERIAL_BRIDGE})
PAGE = Path(__file__).resolve().parents[2] / "docs" / "hardware.md"
BYTE = 22e-6
LIMITS = (10000, 6500, 12000, 1890, 8000, 200)
UNEXPLAINED = "more current than the outputs explain"
TIMSK0, TIMSK1 = 0x6E, 0x6F


def applied(host, seconds, *millivolts):
    """V (rms over a hold) at the first wire; and the readings during it: V and A of the wire, V of
    the supply, (n,) each."""
    electrics, first = host.uno.electrics, len(host.telemetry)
    before, start = electrics.square_time[0], host.uno.time
    host.hold(seconds, *millivolts)
    frames = host.telemetry[first:]
    powers = [SENSORS.reading(frame).powers[0] for frame in frames]
    volts = ((electrics.square_time[0] - before) / (host.uno.time - start)) ** 0.5
    read = [p.voltage for p in powers], [p.current for p in powers]
    return volts, *read, [frame.supply for frame in frames]


def last_cause(host):
    host.run(0.03)
    frame = host.telemetry[-1]
    assert frame.state == DeviceState.STOPPED
    return CAUSES[frame.cause]


def state(host):
    return host.telemetry[-1].state


# --- messages


def test_power_up_greets_and_text_telemetry_comes_at_exactly_100_hz(host):
    lines = {m.letter: m for m in host.messages if isinstance(m, Named)}
    device = serial_messages.DeviceIdentity.from_lines(lines)
    assert (device.name, len(device.build), device.reset) == ("sma-uno", 8, "power-on")
    assert device.maximum_voltage == pytest.approx(10.0)
    assert device.command_timeout == pytest.approx(0.2)
    host.uno.electrics.range_voltage[:] = [0.8, 2.4]
    host.run(0.5)
    times = [frame.time_us for frame in host.telemetry]
    assert times == [10000 * (i + 1) for i in range(69)]
    assert [frame.sequence for frame in host.telemetry] == list(range(1, 70))
    assert host.splitter.damaged == 0
    assert host.telemetry[-1].range_voltage == pytest.approx((0.8, 2.4), abs=0.005)


def test_binary_telemetry_at_500_hz_loses_nothing_while_driving(host):
    """Interrupts are never off for as long as two bytes take."""
    host.arm()
    host.drive(1000, 1000, 1000, 1000)
    host.say("B", 500)
    host.splitter.expect(binary=True)
    # Frames from before the host expected binary look like damaged lines.
    start, damaged = len(host.telemetry), host.splitter.damaged
    host.hold(0.8, 2000, 3000, 4000, 5000)
    host.hold(0.2, 9000, 9000, 9000, 9000)
    frames = host.telemetry[start:]
    steps = {(b.sequence - a.sequence, b.time_us - a.time_us) for a, b in pairwise(frames)}
    assert len(frames) >= 499 and steps == {(1, 2000)}
    assert host.splitter.damaged == damaged
    counters = host.named("S", "S")
    assert counters["dropped"] == counters["lost"] == counters["overruns"] == "0"
    # A quarter of the memory stays unused under the highest load.
    assert int(counters["stack"]) > 512
    assert host.uno.electrics.longest_blocked < 2 * BYTE


def test_a_burst_of_a_delayed_host_is_received_to_the_last_byte(host):
    """The bytes of 0.24 s arrive at once, because the host or its cable was delayed."""
    host.arm()
    host.say("B", 500)
    host.splitter.expect(binary=True)
    for _ in range(12):
        host.drive(3000, 0, 0, 0)
    host.run(0.05)
    counters = host.named("S", "S")
    assert counters["overruns"] == counters["rejected"] == "0"
    assert int(counters["lost"]) <= 1
    assert host.telemetry[-1].echo == 12


# --- outputs and readings


def test_wires_get_the_commanded_voltage_as_heat(host):
    commanded = (250, 1000, 5000, 10000)
    host.arm()
    host.hold(1.0, *commanded)  # until the drop is known, pulses are rare and long
    before, start = list(host.uno.electrics.square_time), host.uno.time
    host.hold(0.5, *commanded)
    elapsed = host.uno.time - start
    for was, now, millivolts in zip(before, host.uno.electrics.square_time, commanded, strict=True):
        assert ((now - was) / elapsed) ** 0.5 == pytest.approx(1e-3 * millivolts, rel=0.015)


def test_the_supplys_drop_is_known_before_any_pulse_is_long(host):
    host.uno.electrics.supply_resistance = 0.1
    host.arm()
    host.hold(2.0, 700, 0, 0, 0)
    volts, told, *_ = applied(host, 1.0, 700, 0, 0, 0)
    assert statistics.fmean(told) == pytest.approx(volts, rel=3e-3)
    assert volts == pytest.approx(0.7, rel=5e-3)


@pytest.mark.parametrize(("resistance", "word"), [(2.7, ""), (math.inf, "open: front_2")])
def test_an_open_wire_beside_a_driven_one_shows_in_the_readings(host, resistance, word):
    host.uno.electrics.resistance[:2] = [2.7, resistance]
    host.arm()
    watch, found = SharedWatch(("front_1", "front_2")), ""
    circuit = Limits.from_parameters(Parameters.defaults()).circuit
    for k in range(8):
        first = len(host.telemetry)
        host.hold(0.5, 6000, 2000 * (k % 2), 0, 0)
        for frame in host.telemetry[first:]:
            powers = SENSORS.reading(frame).powers[:2]
            volts, amperes = [p.voltage for p in powers], [p.current for p in powers]
            found = watch.power(volts, amperes, 1e-6 * frame.time_us, circuit) or found
    assert found.startswith(word) and bool(found) == bool(word)


@pytest.mark.parametrize("volt", [2, 6])
def test_readings_scatter_as_the_page_says(host, volt):
    row = re.search(rf"^\| {volt} V \| ([\d.]+) % \| (-?[\d.]+) % \|$", PAGE.read_text(), re.M)
    host.uno.electrics.resistance[0] = 2.7
    host.arm()
    host.hold(1.0, 1000 * volt, 0, 0, 0)  # until the drop is known, pulses are rare and long
    current = applied(host, 4.0, 1000 * volt, 0, 0, 0)[2]
    mean = statistics.fmean(current)
    assert statistics.stdev(current) / mean == pytest.approx(float(row[1]) / 100.0, rel=0.15)
    assert mean / (volt / 2.7) - 1.0 == pytest.approx(float(row[2]) / 100.0, abs=2.5e-3)


def test_the_usb_voltage_and_the_source_change_no_resistance(host):
    electrics = host.uno.electrics
    electrics.reference, electrics.supply_resistance = 4.75, 0.1
    electrics.resistance[0] = 2.9
    host.uno.reset(Reset.POWER_ON)
    host.run(1.0)
    host.arm()
    host.hold(1.0, 5000, 0, 0, 0)
    volts, voltage, current, supply = applied(host, 2.0, 5000, 0, 0, 0)
    # Sampling in step with the pulses would be off by 1 %, rounding means down by 0.06 %.
    told = statistics.fmean(voltage)
    assert told / statistics.fmean(current) == pytest.approx(2.9, rel=0.002)
    assert told == pytest.approx(volts, rel=4e-4)
    assert volts == pytest.approx(5.0, rel=2e-3)
    assert statistics.fmean(supply) == pytest.approx(12.0, rel=3e-4)
    assert int(host.named("S", "S")["reference_mv"]) == pytest.approx(4750, abs=2)


def test_arming_again_clears_the_overload_of_a_weak_supply(host):
    host.uno.electrics.supply_limit = 2.0  # 3 V left in a pulse: no duty makes 5 V of it
    host.uno.electrics.resistance[0] = 1.5
    host.arm()
    host.hold(1.0, 1000, 0, 0, 0)
    host.consent("D")
    host.uno.electrics.resistance[0] = 10.0
    host.arm()
    _, told, *_ = applied(host, 0.5, 5000, 0, 0, 0)
    assert state(host) == DeviceState.ARMED and told[-1] == pytest.approx(5.0, rel=0.01)


# --- stops


def test_nothing_is_driven_before_the_first_command_nor_by_garbage(host):
    host.arm()
    host.run(0.1)
    assert sum(host.uno.electrics.on_time) == 0.0
    noise = random.Random(1)
    host.uno.write(bytes(b for _ in range(3000) if (b := noise.randrange(256)) != ord("!")))
    host.run(0.1)
    host.uno.write(b"\n")
    host.say("?")
    assert sum(host.uno.electrics.on_time) == 0.0
    assert host.named("?", "H")["name"] == "sma-uno"


@pytest.mark.parametrize("flood", [0, 128], ids=["alone", "inside a flood of garbage"])
def test_stop_byte_switches_off_within_a_tenth_of_a_millisecond(driving, flood):
    driving.uno.write(bytes(range(128, 128 + flood)) + b"!" + bytes(range(128, 128 + flood)))
    # simavr takes 45 us for each byte of garbage that arrives without a pause.
    driving.run(1e-4 + flood * 2.2 * BYTE)
    assert driving.outputs_stay_off(0.01)
    assert last_cause(driving) == "stop byte"


def test_silence_a_lost_supply_and_too_much_heat_stop(driving):
    """The cause survives a reset, but not a second one."""
    electrics = driving.uno.electrics
    driving.drive(6000, 0, 0, 3000)
    assert 0.199 < driving.time_until_off(limit=0.3) < 0.205
    assert last_cause(driving) == "command timeout"
    for cause in ("command timeout", ""):
        driving.uno.reset(Reset.PIN)
        driving.run(0.2)
        assert CAUSES[int(driving.named("?", "H")["before"])] == cause
    driving.arm((10000, 6500, 12000, 1890, 7000, 200))
    # The wire's voltage stays when the supply sags.
    electrics.supply = 10.0
    driving.hold(0.2, 6000, 0, 0, 0)
    assert applied(driving, 0.3, 6000, 0, 0, 0)[0] == pytest.approx(6.0, rel=0.01)
    electrics.supply = 0.0
    driving.hold(0.1, 6000, 0, 0, 3000)
    assert last_cause(driving) == "supply out of range"
    electrics.supply = 12.0
    driving.run(1.0)
    driving.consent("R")
    driving.arm((10000, 6500, 12000, 1890, 5000, 200))
    driving.hold(0.6, 4500, 0, 0, 0)
    assert state(driving) == DeviceState.ARMED
    driving.hold(0.6, 6000, 0, 0, 0)
    assert last_cause(driving) == "more heat than allowed"


@pytest.mark.parametrize(
    ("millivolts", "resistance"), [(1000, 0.05), (1000, 0.3), (3000, 0.05), (7500, 0.3)]
)
def test_short_circuit_is_off_at_any_voltage_though_the_sensor_clips(host, millivolts, resistance):
    electrics = host.uno.electrics
    electrics.supply_resistance, electrics.offset[0] = 0.05, 0.03
    host.arm(LIMITS)
    host.hold(0.3, millivolts, 0, 0, 0)
    electrics.resistance[0] = resistance
    before = electrics.on_time[0]
    for _ in range(4):
        host.drive(millivolts, 0, 0, 0)
        host.run(0.02)
    assert last_cause(host) in ("over-current of the front board", UNEXPLAINED)
    assert electrics.on_time[0] - before < 1e-3


@pytest.mark.parametrize(
    ("millivolts", "resistance", "clipping", "found"),
    [
        (2000, 1.2, 25.0, True), (2500, 1.4, 25.0, True), (3500, 1.6, 25.0, True),
        (2000, 0.05, 11.0, True), (2500, 0.05, 7.0, True),
        # Shorts that it cannot distinguish from a wire (docs/safety.md).
        (9000, 1.9, 25.0, False), (3000, 0.05, 6.0, False),
    ],
)  # fmt: skip
def test_the_device_alone_finds_half_shorts_and_shorts_behind_a_sensor_that_clips(
    host, millivolts, resistance, clipping, found
):
    """No host has set the limits of its wires (command C)."""
    electrics = host.uno.electrics
    electrics.supply_resistance, electrics.offset[0], electrics.clipping = 0.05, 0.03, clipping
    host.arm()
    host.hold(0.3, millivolts, 0, 0, 0)
    assert state(host) == DeviceState.ARMED
    electrics.resistance[0] = resistance
    host.hold(0.5, millivolts, 0, 0, 0)
    assert state(host) == (DeviceState.STOPPED if found else DeviceState.ARMED)
    assert not found or last_cause(host) == UNEXPLAINED


def test_its_own_limits_stay_what_it_tells_whatever_a_host_has_set_for_its_rig(host):
    limits = host.named("?", "L"), host.named("?", "M")
    host.arm((5000, 2000, 9000, 1890, 6000, 200))
    assert (host.named("?", "L"), host.named("?", "M")) == limits
    host.arm((10000, 6500, 12000, 1000, 8000, 2000))


@pytest.mark.parametrize("kind", [Switch.STUCK_ON, Switch.INVERTED])
def test_a_broken_switch_is_found_when_the_relay_closes_and_while_it_drives(host, kind):
    host.arm()
    host.hold(0.1, 6000, 0, 0, 3000)
    host.uno.electrics.switch_is[1] = kind
    host.hold(0.05, 6000, 0, 0, 3000)
    assert last_cause(host) == UNEXPLAINED
    before = host.uno.electrics.wire_time[1]
    host.run(0.1)
    assert host.uno.electrics.wire_time[1] == before  # the relay takes its current away
    host.consent("R")
    host.run(0.3)
    assert state(host) == DeviceState.IDLE
    host.arm()
    assert last_cause(host) == "current with all outputs off"


def test_behind_a_welded_relay_the_device_reports_current_that_still_flows(host):
    host.uno.electrics.relay_is = Relay.WELDED
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    host.run(0.2)
    assert state(host) == DeviceState.STILL_FLOWING
    assert REASONS[host.refusal("R")] == "current flows though every output is off"
    host.uno.electrics.supply = 0.0  # the plug
    host.run(0.2)
    assert state(host) == DeviceState.STOPPED
    host.consent("R")


BREAKS = {
    "outputs": (lambda uno: uno.poke(TIMSK0, 0), 0.075, "output interrupt lost"),
    "clock": (lambda uno: uno.poke(TIMSK1, 0), 0.075, ""),
    # By its own count of the loop if interrupts still work, otherwise by the watchdog.
    "hung": (lambda uno: uno.hang(interrupts=True), 0.033, ""),
    "dead": (lambda uno: uno.hang(interrupts=False), 0.075, ""),
}


@pytest.mark.parametrize("broken", BREAKS)
def test_a_lost_interrupt_or_a_hung_program_is_off_and_restarted(driving, broken):
    fault, limit, cause = BREAKS[broken]
    driving.drive(6000, 0, 0, 3000)
    driving.run(0.01)
    fault(driving.uno)
    assert driving.time_until_off(limit=0.3) < limit
    driving.run(0.2)
    assert state(driving) == DeviceState.IDLE
    greeting = next(m for m in driving.messages[::-1] if isinstance(m, Named) and m.letter == "H")
    assert int(greeting.values["reset"]) == 8
    assert not cause or CAUSES[int(greeting.values["before"])] == cause


def kept(host):
    said = host.named("?", "H")
    return CAUSES[int(said["trip"])], 0.1 * int(said["trip_ds"]), said["trip_open"] == "1"


def cut_power(host):
    host.uno.reset(Reset.POWER_ON)
    host.run(0.2)


def test_the_last_reason_outlasts_the_power_and_so_does_its_acknowledgement(driving):
    driving.run(0.3)
    cut_power(driving)
    cause, time, is_open = kept(driving)
    assert (cause, is_open) == ("command timeout", True) and 0.3 <= time <= 0.6
    assert state(driving) == DeviceState.IDLE
    driving.run(1.0)
    cut_power(driving)
    assert kept(driving) == ("command timeout", time, True)
    driving.consent("R")
    assert kept(driving) == ("command timeout", time, False)
    driving.run(0.04)
    cut_power(driving)
    assert kept(driving) == ("command timeout", time, False)


def test_storing_a_reason_delays_nothing_that_is_done_meanwhile(driving):
    """The slowest EEPROM bytes at 500 Hz, while it is armed again and driven."""
    driving.say("B", 500)
    driving.splitter.expect(binary=True)
    driving.uno.write(b"!")
    driving.run(0.001)
    driving.uno.write(line("R") + line("?"))
    stored = 0
    for _ in range(20):
        driving.run(0.001)
        stored += driving.uno.storing
    assert stored > 15
    greeting = [m for m in driving.messages if isinstance(m, Named) and m.letter == "H"]
    start = len(driving.telemetry)
    driving.uno.write(b"!")
    driving.run(0.001)
    driving.consent("R")
    driving.arm()
    driving.hold(0.3, 2000, 3000, 4000, 5000)
    frames = driving.telemetry[start:]
    assert {b.sequence - a.sequence for a, b in pairwise(frames)} == {1}
    assert driving.uno.electrics.longest_blocked < 2 * BYTE and greeting
    assert state(driving) == DeviceState.ARMED


def test_no_two_starts_have_the_same_nonce_and_none_is_told_unasked(host):
    seen = set()
    for start in range(6):
        host.uno.reset(Reset.POWER_ON if start % 3 == 0 else Reset.PIN)
        host.messages.clear()
        host.run(0.2)
        assert not any("nonce" in m.values for m in host.messages if isinstance(m, Named))
        assert host.refusal("A", 13841) is not None
        seen.add(host.named("?", "H")["nonce"])
    assert len(seen) == 6


def test_a_recorded_session_arms_nothing_after_a_reset_nor_its_command_in_the_next(driving):
    host = driving

    def stays_off_after(said):
        host.uno.write(said)
        return host.outputs_stay_off(0.2)

    replayed = host.command_line(9000, 9000, 9000, 9000)
    session = line("?") + line("C " + " ".join(map(str, LIMITS)))
    host.uno.write(b"!")
    host.run(0.01)
    host.consent("R")
    host.arm()
    assert stays_off_after(replayed)
    session += line(command("A", host.session)) + host.command_line(9000, 0, 0, 0)
    host.uno.reset()
    host.run(0.2)
    assert stays_off_after(session) and state(host) == DeviceState.IDLE

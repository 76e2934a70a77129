"""What the emulator can break at the pins, and the physics of the wires behind them."""

import math
import os
import statistics
import time

import numpy as np
import pytest
from uno.emulated_bench import Plant, on_a_port
from uno.emulated_uno import Relay, Reset, Switch

from sma_bench.hardware.serial_messages import Named
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench

PATIENCE = 20.0


def mean(host, seconds=0.3):
    """Mean current of the front board, as telemetry has it from now on."""
    host.run(0.02)
    start = len(host.telemetry)
    host.run(seconds)
    return statistics.fmean(frame.current[0] for frame in host.telemetry[start:])


def test_no_wire_is_connected_behind_an_open_relay_and_the_sensor_clips(host):
    host.uno.electrics.relay_is = Relay.HELD_OPEN
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    host.run(0.05)
    assert sum(host.uno.electrics.wire_time) == 0.0
    host.uno.electrics.relay_is = Relay.WELDED
    host.uno.electrics.clipping = 3.0
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    assert mean(host) == pytest.approx(3.0, abs=0.02)
    host.uno.electrics.switch_is[0] = Switch.SOUND
    host.uno.electrics.offset[0] = 0.03
    assert mean(host) == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("length", [0.0, 200e-6])
def test_interrupts_off_for_longer_than_two_bytes_lose_the_third(host, length):
    host.uno.write(b"S" * 30 + b"\n")
    host.uno.run(2e-4)
    host.uno.stall(length)
    host.run(0.01)
    lost = host.uno.electrics.lost_bytes
    assert (lost > 0) == (length > 0.0)
    assert (int(host.named("S", "S")["overruns"]) > 0) == (lost > 0)


def test_a_reset_keeps_the_memory_and_waits_for_the_bootloader(host):
    def resets():
        named = [m for m in host.messages if isinstance(m, Named) and m.letter == "H"]
        return [int(m.values["reset"]) for m in named]

    for why in (Reset.POWER_ON, Reset.PIN):
        host.uno.reset(why)
        host.run(0.1)
    assert resets() == [Reset.POWER_ON, Reset.POWER_ON, Reset.PIN]
    host.uno.electrics.bootloader_time = 0.5
    host.uno.reset()
    host.messages.clear()
    host.run(0.3)
    host.uno.write(b"?")
    host.run(0.4)
    assert not host.messages
    host.run(0.15)
    assert resets() == [Reset.PIN]


def test_opening_the_port_resets_it_each_time(uno):
    opened = []

    def on_open():
        opened.append(uno.time)
        uno.reset()

    with on_a_port(uno, on_open=on_open) as bench:
        for times in (1, 2):
            end = os.open(bench.path, os.O_RDWR | os.O_NOCTTY)
            until = time.monotonic() + PATIENCE
            greeting = b""
            while b"reset=2" not in greeting and time.monotonic() < until:
                greeting += os.read(end, 4096)
            os.close(end)
            assert b"reset=2" in greeting
            assert len(opened) == times
            until = time.monotonic() + PATIENCE
            while bench._is_open and time.monotonic() < until:
                time.sleep(0.001)
        assert math.isclose(uno.electrics.started, opened[-1], abs_tol=1e-3)


PERIOD = 0.05


def test_pulses_heat_a_wire_as_the_commanded_direct_voltage_would(host):
    plant = Plant(host.uno, Parameters.defaults())
    reference = Bench(Parameters.defaults())
    host.arm()
    plant.advance()
    for _ in range(30):
        host.drive(3000, 0, 0, 0)
        plant.run(PERIOD)
        host.run(0.0)
        reference.advance(np.array([3.0]), PERIOD)
    risen = reference.temperature[0] - 296.15
    assert risen > 10.0
    assert plant.bench.temperature[0] - 296.15 == pytest.approx(risen, rel=0.01)

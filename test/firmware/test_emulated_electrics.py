"""What the emulator can break: switches, sensors, supply, USB voltage, receiver, resets."""

import math
import os
import time

import pytest
from uno.emulated_bench import on_a_port
from uno.emulated_uno import EmulatedUno, Relay, Reset, Switch
from virtual_host import VirtualHost

from sma_bench.hardware.serial_messages import Named

PATIENCE = 20.0


def mean(host: VirtualHost, seconds: float = 0.3) -> tuple[float, float]:
    """Mean current of the front board and mean supply, as telemetry has them from now on."""
    host.run(0.02)
    start = len(host.telemetry)
    host.run(seconds)
    frames = host.telemetry[start:]
    return (
        sum(frame.current[0] for frame in frames) / len(frames),
        sum(frame.supply for frame in frames) / len(frames),
    )


def resets(host: VirtualHost) -> list[int]:
    return [
        int(m.values["reset"]) for m in host.messages if isinstance(m, Named) and m.letter == "H"
    ]


@pytest.mark.parametrize("kind", [Switch.STUCK_ON, Switch.INVERTED])
def test_a_broken_switch_heats_its_wire_while_its_pin_is_low(
    host: VirtualHost, kind: Switch
) -> None:
    host.uno.electrics.relay_is = Relay.WELDED
    host.uno.electrics.switch_is[0] = kind
    current, _ = mean(host)
    assert sum(host.uno.electrics.on_time) == 0.0
    assert current == pytest.approx(12.0 / 2.7, rel=0.02)


def test_no_wire_is_connected_behind_an_open_relay(host: VirtualHost) -> None:
    host.uno.electrics.relay_is = Relay.HELD_OPEN
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    host.run(0.05)
    assert sum(host.uno.electrics.wire_time) == 0.0


def test_the_current_sensor_clips_and_has_an_offset(host: VirtualHost) -> None:
    host.uno.electrics.relay_is = Relay.WELDED
    host.uno.electrics.clipping = 3.0
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    assert mean(host)[0] == pytest.approx(3.0, abs=0.02)
    host.uno.electrics.switch_is[0] = Switch.SOUND
    host.uno.electrics.offset[0] = 0.03
    assert mean(host)[0] == pytest.approx(0.3, abs=0.02)


def test_a_loaded_supply_sags_and_a_limited_one_collapses(host: VirtualHost) -> None:
    host.uno.electrics.relay_is = Relay.WELDED
    host.uno.electrics.switch_is[0] = Switch.STUCK_ON
    host.uno.electrics.supply_resistance = 0.3
    assert mean(host)[1] == pytest.approx(12.0 * 2.7 / 3.0, rel=0.01)
    host.uno.electrics.supply_limit = 2.0
    assert mean(host)[0] == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("length", [0.0, 200e-6])
def test_interrupts_off_for_longer_than_two_bytes_lose_the_third(
    host: VirtualHost, length: float
) -> None:
    host.uno.write(b"S" * 30 + b"\n")
    host.uno.run(2e-4)
    host.uno.stall(length)
    host.run(0.01)
    lost = host.uno.electrics.lost_bytes
    assert (lost > 0) == (length > 0.0)
    assert (int(host.named("S", "S")["overruns"]) > 0) == (lost > 0)


def test_a_reset_waits_for_the_bootloader_which_bytes_hold_up(host: VirtualHost) -> None:
    host.uno.electrics.bootloader_time = 0.5
    host.uno.reset()
    host.messages.clear()
    host.run(0.3)
    host.uno.write(b"?")
    host.run(0.4)
    assert not host.messages
    host.run(0.15)
    assert resets(host) == [Reset.PIN]


def test_memory_survives_a_reset_but_not_a_power_cycle(host: VirtualHost) -> None:
    host.uno.reset(Reset.POWER_ON)
    host.run(0.1)
    host.uno.reset()
    host.run(0.1)
    assert resets(host) == [Reset.POWER_ON, Reset.POWER_ON, Reset.PIN]


def test_opening_the_port_resets_it_each_time(uno: EmulatedUno) -> None:
    opened: list[float] = []

    def on_open() -> None:
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

"""The emulator: its resets, and the physics of the wires behind its pins."""

import numpy as np
import pytest
from uno.emulated_bench import Plant
from uno.emulated_uno import Reset

from sma_bench.hardware.serial_messages import Named
from sma_bench.parameters import Parameters
from sma_bench.physics import Bench


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

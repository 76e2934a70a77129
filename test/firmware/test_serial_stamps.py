"""The real link on the real image, in virtual time: stamps and losses."""

import time

import pytest
from virtual_port import VirtualPort

from sma_bench.emulation.emulated_uno import START_UP, EmulatedUno
from sma_bench.hardware.link_status import Reading
from sma_bench.hardware.serial_link import LinkOptions, SerialLink


@pytest.mark.parametrize(
    ("rate", "drift"), [(100, 2e-3), pytest.param(500, -2e-3, marks=pytest.mark.slow)]
)
def test_stamps_are_acquisition_times_within_a_millisecond(
    uno: EmulatedUno, rate: int, drift: float
) -> None:
    port = VirtualPort(uno, drift)
    readings: list[Reading] = []
    link = SerialLink(
        lambda: port, LinkOptions(rate=rate), readings.append, clock=port.clock
    )
    link.start()
    while not readings or readings[-1].time < 6.0:
        assert link.status.problem == ""
        time.sleep(0.01)
    link.close()
    settled = [reading for reading in readings if reading.time > 5.0]
    assert len(settled) > 0.9 * rate
    for reading in settled:
        middle = START_UP + 1e-6 * reading.telemetry.time_us - 0.5 / rate
        assert reading.time == pytest.approx(middle * (1.0 + drift), abs=1e-3)
    assert link.status.drift == pytest.approx(drift, abs=2e-4)
    assert link.status.lost == link.status.damaged == 0


@pytest.mark.acceptance
def test_a_minute_at_500_hz_loses_nothing(uno: EmulatedUno) -> None:
    port = VirtualPort(uno)
    count = [0]

    def note(_: Reading) -> None:
        count[0] += 1

    link = SerialLink(lambda: port, LinkOptions(rate=500), note, clock=port.clock)
    link.start()
    while count[0] < 60 * 500:
        assert link.status.problem == ""
        time.sleep(0.05)
    link.close()
    status = link.status
    assert status.lost == status.damaged == status.not_understood == 0
    assert status.clock_uncertainty < 2e-3

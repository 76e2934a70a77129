"""The bridge as a process on the real firmware in an emulated Uno: topics, services, rates."""

import math
import re
import time

import pytest
from emulated_rig import bridged_rig
from sensor_msgs.msg import Range
from std_msgs.msg import Float64MultiArray
from uno.emulated_bench import emulated_bench
from uno.emulated_uno import Reset

from sma_bench.hardware.serial_link import open_port
from sma_bench.installation import share_directory
from sma_bench.parameters import read_parameters

RIG = share_directory() / "config" / "composite_rig.yaml"


def test_the_bridge_speaks_the_contract_drives_only_when_enabled_and_says_what_it_applied(
    bench, uno
):
    with bridged_rig(bench, uno) as rig:
        rig.until(lambda: rig.state == "idle" and len(rig.power) > 200)
        assert rig.power[0].location == "wire" and math.isnan(rig.power[0].percentage)
        assert rig.power[-1].voltage == 0.0
        assert abs(rig.power[-1].current) < 0.05
        stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in rig.power]
        assert stamps == sorted(set(stamps))
        assert abs(stamps[-1] / 1e9 - time.time()) < 5.0
        rig.voltage = (3.0,)
        rig.until(lambda: bench.value("last_rejection") == "not enabled (idle)")
        rig.voltage = (0.0,)
        assert_self_test(rig)
        assert sum(rig.hardware.uno.electrics.on_time) == 0.0
        rig.enable()
        assert bench.value("scheduling").startswith(("real time", "niceness", "as any program"))
        refused = rig.ask("reset")
        assert not refused.success and refused.message == "enabled: stop first"
        assert_no_reading_is_stamped_before_its_cause(rig)
        assert not rig.ask("self_test").success
        rig.ask("stop")
        refused = rig.ask("enable")
        assert not refused.success and "stopped on request; reset first" in refused.message
        assert rig.ask("reset").message == "idle"
        rig.enable()
        rig.drive(2.0)
        assert_second_host_is_kept_out(rig)
        rig.until(lambda: abs(float(bench.value("applied")) - 2.0) < 0.1)
        rig.until(lambda: abs(float(bench.value("wire_degC")) - 32.0) < 3.0)  # told once a second
        assert bench.value("crc_errors") == bench.value("not_understood") == "0"
        assert 0.0 < float(bench.value("power_rate")) < 250.0
        assert 0.0 < float(bench.value("round_trip_ms")) < 1000.0
        assert bench.status("serial_bridge: bench").hardware_id.startswith("sma-uno ")
        rig.drive(3.0)
        driven = len(rig.power)
        rig.until(lambda: len(rig.power) > driven + 60)
        newest = rig.power[-50:]
        assert sum(m.voltage for m in newest) / 50 == pytest.approx(3.0, rel=0.02)
        assert sum(m.current for m in newest) / 50 == pytest.approx(3.0 / 2.6987, rel=0.03)
        # A temperature beyond the limit counts, even if the next one comes at once.
        rig.show(200.0)
        rig.show(40.0)
        rig.until(lambda: rig.state.startswith("stopped: over-temperature: wire at 200.0 degC"))
        rig.ask("reset")
        rig.until(lambda: rig.state == "idle")
        rig.enable()
        rig.drive(3.0)
        answer = rig.ask("stop")
        assert answer.success and answer.message == "stopped: stopped on request"
        rig.until(lambda: rig.power[-1].voltage == 0.0)


def test_the_bridge_is_not_enabled_beside_a_simulator_that_publishes_the_same_readings(bench, uno):
    """A forgotten simulator's temperatures would hide a dead camera of the hardware."""
    with bridged_rig(bench, uno) as rig:
        simulator = bench.start("simulator")
        bench.until(lambda: "ready" in simulator.output)
        refused = rig.ask("enable")
        assert not refused.success and "/bench/wire/power is there already" in refused.message
        simulator.end()
        rig.enable()
        rig.ask("stop")
        assert not rig.ask("enable").success
        simulator = bench.start("simulator")  # the refused one claims nothing
        bench.until(lambda: "ready" in simulator.output)


def assert_no_reading_is_stamped_before_its_cause(rig):
    """Apart from the time that the emulated Uno's clock loses on a busy machine."""
    for level in (1.0, 2.0, 3.0):
        rig.voltage, begin = (level,), len(rig.lags)
        late = rig.bench.stamped_after(
            rig.power, lambda m: m.voltage > level - 0.1, int, rig.until  # noqa: B023
        )  # fmt: skip
        lost = max(rig.lags[begin:]) - min(rig.lags)
        assert -lost <= 1e-9 * late < 1.0


def assert_self_test(rig):
    """The answer names each check."""
    answer = rig.ask("self_test")
    for check in ("connection", "link", "supply", "currents", "stop"):
        assert f"{check}: ok" in answer.message
    electrics = rig.hardware.uno.electrics
    electrics.supply, supply = 3.0, electrics.supply
    rig.until(lambda: float(rig.bench.value("supply_volts") or supply) < 4.0)
    answer = rig.ask("self_test")
    assert not answer.success and re.search(r"supply: FAILED, (2\.9|3\.0)", answer.message)
    electrics.supply = supply
    rig.until(lambda: float(rig.bench.value("supply_volts")) > supply - 1.0)


def assert_second_host_is_kept_out(rig):
    """The second bridge cannot open the port, and the first one continues."""
    with pytest.raises(OSError, match="exclusively lock"):
        open_port(rig.hardware.path)
    # In another namespace; a second bridge of the same bench would not even start.
    arguments = ["--ros-args", "-r", "__ns:=/other", "-p", f"port:={rig.hardware.path}"]
    other = rig.bench.start_with("serial_bridge", arguments)
    rig.until(lambda: "not connected" in other.output and "exclusively lock" in other.output)
    driven = len(rig.power)
    rig.until(lambda: len(rig.power) > driven + 50)
    assert rig.power[-1].voltage == pytest.approx(2.0, abs=0.1)
    other.process.kill()


def test_a_new_bridge_knows_why_the_bench_stopped_before_its_power_failed(bench, uno):
    """It arms only after an acknowledgement, which later bridges need not repeat."""

    def lose_power_and_bridge():
        rig.node.process.kill()
        rig.node.process.wait()
        rig.for_a_while(0.5)
        rig.hardware.do(lambda: uno.reset(Reset.POWER_ON))
        rig.states.clear()
        bench.diagnostics.clear()
        rig.node = bench.start("serial_bridge", port=rig.hardware.path)
        rig.until(lambda: rig.state and bench.value("last_trip"))
        return bench.value("last_trip")

    with bridged_rig(bench, uno) as rig:
        rig.enable()
        rig.drive(3.0)
        rig.voltage = (0.0,)
        told = lose_power_and_bridge()
        assert re.fullmatch(r"command timeout, \d+\.\d s after a start, not acknowledged", told)
        rig.until(lambda: rig.state == f"stopped: earlier: {told}")
        for service in ("enable", "self_test"):
            answer = rig.ask(service)
            assert not answer.success and answer.message.endswith(f"{told}; reset first")
        assert rig.ask("reset").message == "idle"
        rig.until(lambda: bench.value("last_trip") == told.replace("not ack", "ack"))
        assert lose_power_and_bridge() == told.replace("not ack", "ack")
        rig.enable()


def test_composite_rig_bends_and_its_ranges_give_the_deflection(bench, uno):
    with emulated_bench(read_parameters(RIG), uno) as hardware:
        front, back, joints = bench.hear("front/range", "back/range", "joint_states")
        bench.start("serial_bridge", RIG, port=hardware.path, feedback=["power"])
        command = bench.talk("voltage_command", Float64MultiArray)
        bench.until(lambda: joints and front and back)
        bench.until(lambda: bench.trigger("serial_bridge/enable").success)

        def bent_as_seen():
            command.publish(Float64MultiArray(data=[6.0, 6.0, 0.0, 0.0]))
            truth = float(hardware.plant.bench.deflection)
            return truth > 0.005 and abs(joints[-1].position[0] - truth) < 1e-3

        bench.until(bent_as_seen)
        assert joints[-1].name == ["tip"]
        assert front[-1].range < front[0].range and front[0].radiation_type == Range.INFRARED
        assert back[-1].range > back[0].range

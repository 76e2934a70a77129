"""The controllers as processes: they track on the simulator, and leave the wires cold."""

import signal

import numpy as np
import pytest
import yaml
from fake_bench import FakeBench
from std_msgs.msg import Float64, Float64MultiArray

from sma_bench.installation import share_directory

COMPOSITE_RIG = share_directory() / "config" / "composite_rig.yaml"
# Few readings: the test has to keep up with them. However long a loaded machine keeps the
# controller waiting, simulated time waits for its commands, and the test for both.
FAST = {
    "speed": 100.0, "rate__power": 20.0, "rate__temperature": 40.0, "rate__mechanics": 40.0,
    "lockstep_patience": 60.0,
}
LONG = 300.0


# Its temperatures are what the test says, whatever is commanded.
UNHEATED = {"bench__temperature_tolerance": 500.0}
FROM_A_TOPIC = {**UNHEATED, "reference": "''", "autostart": True, "feedback_timeout": 1.5}


def stamps(messages):
    return np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m in messages])


def run_to_the_end(bench, controller, path, file=None, **reference):
    """On the simulator, as soon as its readings are heard: a run takes less than a second."""
    path.write_text(yaml.safe_dump({"name": "short", **reference}))
    states, tip = bench.hear(f"{controller}/state", "joint_states")
    files = [file] if file else []
    node = bench.start(controller, *files, use_sim_time=True, reference=path)
    bench.until(lambda: tip and states and states[-1].data == "idle", LONG)
    bench.until(lambda: bench.trigger(f"{controller}/start").success, LONG)
    bench.until(lambda: states[-1].data.startswith(("done", "aborted")), LONG)
    assert states[-1].data == "done: short"
    return node


def test_staircase_of_e8_runs_closed_loop_on_the_simulator(bench, tmp_path):
    """Up and down, as the shipped temperature_staircase (read in test/protocols) in short."""
    levels, dwell = np.array([308.15, 318.15, 328.15, 318.15, 308.15]), 4.0
    stairs = {"kind": "staircase", "increment": 10.0, "dwell": dwell}
    celsius, markers, setpoints = bench.hear(
        "wire/temperature", "experiment/marker", "temperature_controller/setpoint"
    )
    bench.start("simulator", **FAST)
    path = tmp_path / "short.yaml"
    node = run_to_the_end(bench, "temperature_controller", path, unit="K", steps=[
        {**stairs, "name": "up", "start": 308.15, "stop": 328.15},
        {**stairs, "name": "down", "start": 318.15, "stop": 308.15},
    ])  # fmt: skip
    bench.until(lambda: markers[-1].data == "short/done")
    assert [m.data for m in markers[:2]] == [f"short/up {level:g} K" for level in levels[:2]]
    # The marker may overtake readings that still wait in the test's own queues.
    warm = bench.until(lambda: next((m for m in celsius if m.temperature > 27.0), None))
    begin = stamps([warm])[0]
    end = begin + dwell * len(levels)
    bench.until(lambda: stamps(celsius[-1:])[0] > end, LONG)
    assert node.end() == 0
    time, kelvin = stamps(celsius), np.array([m.temperature + 273.15 for m in celsius])
    for k, level in enumerate(levels):
        held = (time > begin + dwell * (k + 0.3)) & (time < begin + dwell * (k + 0.95))
        assert kelvin[held].mean() == pytest.approx(level, abs=0.1)
    assert kelvin.max() < 330.0  # A_s lies at 331.81 K
    assert max(m.data[0] for m in setpoints) == pytest.approx(55.0)


def test_triangle_of_deflections_is_tracked_on_the_simulator(bench, tmp_path):
    tip, volts = bench.hear("joint_states", "voltage_command")
    # The controller knows the wires less well than it thinks.
    off = {"wire__heat_transfer_coefficient": 411.0, "wire__austenite_start_temperature": 332.9}
    bench.start("simulator", COMPOSITE_RIG, **FAST, **off)
    path, triangle = tmp_path / "short.yaml", {"kind": "triangle", "rise": 3.0, "fall": 3.0}
    run_to_the_end(bench, "deflection_controller", path, COMPOSITE_RIG, unit="m", steps=[
        {**triangle, "name": "front", "peak": 0.03}, {"kind": "rest", "duration": 2.0},
        {**triangle, "name": "back", "peak": -0.03},
    ])  # fmt: skip
    peak = stamps([max(tip, key=lambda m: m.position[0])])[0]
    bench.until(lambda: stamps(tip[-1:])[0] > peak + 11.0, LONG)
    time, metres = stamps(tip), np.array([m.position[0] for m in tip])
    wanted = np.interp(
        time - peak + 3.0, [0.0, 3.0, 6.0, 8.0, 11.0, 14.0], [0.0, 0.03, 0.0, 0.0, -0.03, 0.0]
    )
    part = (time > peak - 3.0) & (time < peak + 10.5)
    assert np.sqrt(np.mean((metres - wanted)[part] ** 2)) < 1e-3
    assert metres.max() == pytest.approx(0.03, abs=1e-3)
    assert metres.min() == pytest.approx(-0.03, abs=1e-3)
    sent = np.array([m.data for m in volts])
    assert not np.any((sent[:, 0] > 0.0) & (sent[:, 2] > 0.0))
    np.testing.assert_array_equal(sent[:, 0], sent[:, 1])


def test_temperatures_come_from_a_topic_in_celsius_and_the_rules_of_the_experiment_hold(bench):
    fake, name = FakeBench(bench, "temperature_controller"), "temperature_controller"
    node = bench.start(name, **FROM_A_TOPIC)
    bench.until(lambda: fake.state == "running: topic")
    topic = bench.talk(f"{name}/reference", Float64MultiArray)
    bench.until(lambda: fake.volts == [0.0])
    topic.publish(Float64MultiArray(data=[40.0]))
    bench.until(lambda: fake.volts[0] > 3.0)
    for bad in ([200.0], [40.0, 40.0], [float("nan")]):
        topic.publish(Float64MultiArray(data=bad))
    bench.until(lambda: "rejected: reference has 473.15 K" in node.output)
    fake.celsius = 45.0
    bench.until(lambda: fake.volts == [0.0])
    fake.celsius = 38.0
    bench.until(lambda: fake.volts[0] > 0.5)
    fake.celsius = 160.0
    bench.until(lambda: fake.state.startswith("aborted: over-temperature: wire at 160.0 degC"))
    fake.until_zero()
    refused = bench.trigger(f"{name}/start")
    assert not refused.success and "reset first" in refused.message
    fake.celsius = 25.0
    assert bench.trigger(f"{name}/reset").success
    hot = bench.set_parameter(name, "reference", "deflection_triangle")
    assert not hot.successful and "unit is 'm', expected K" in hot.reason
    assert bench.trigger(f"{name}/start").success
    # The reference of the run that was aborted is forgotten.
    bench.until(lambda: fake.state == "running: topic")
    fake.until_zero()
    fake.silent.add("temperature")
    bench.until(lambda: fake.state.startswith("aborted: stale feedback: nothing new from wire/"))
    assert bench.trigger(f"{name}/stop").success
    assert node.end(signal.SIGTERM) == 0 and "Traceback" not in node.output
    bench.until(lambda: fake.volts == [0.0])


def test_deflection_controller_stops_when_the_deflection_stops_coming(bench):
    clamped = bench.start("deflection_controller", remap={"__node": "clamped"})
    fake = FakeBench(bench, "deflection_controller", ("front_1", "front_2", "back_1", "back_2"))
    bench.start("deflection_controller", COMPOSITE_RIG, **FROM_A_TOPIC)
    bench.until(lambda: fake.state == "running: topic")
    topic = bench.talk("deflection_controller/reference", Float64)
    topic.publish(Float64(data=-0.02))
    bench.until(lambda: fake.volts[2] > 3.0)
    assert fake.volts[:2] == [0.0, 0.0]
    fake.silent.add("joints")
    bench.until(lambda: fake.state.startswith("aborted: stale feedback: nothing new from joint"))
    fake.until_zero()
    assert clamped.process.wait(30.0) == 2 and "clamped" in clamped.output

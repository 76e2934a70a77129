"""The controllers as processes: they track a reference on the simulator and end at 0 V."""

import json
import signal

import numpy as np
import pytest
import yaml
from fake_bench import FakeBench
from std_msgs.msg import Float64MultiArray

from sma_bench.installation import share_directory
from sma_bench.ros.node import seconds_of

COMPOSITE_RIG = share_directory() / "config" / "composite_rig.yaml"
# Few readings, as the test has to keep up with them. On a loaded machine simulated time waits for
# the controller's commands, and the test for both. At a hundred times real time (but not at ten)
# the readings of a busy machine would reach the controller in bursts.
FAST = {"speed": 10.0, "rate__power": 20.0, "rate__temperature": 40.0, "rate__mechanics": 40.0,
        "lockstep_patience": 60.0}  # fmt: skip
LONG = 300.0
FROM_A_TOPIC = {
    # The test sets the temperatures, whatever is commanded.
    "bench__temperature_tolerance": 500.0,
    "reference": "''", "autostart": True, "feedback_timeout": 1.0,
}  # fmt: skip


def test_triangle_of_deflections_is_tracked_on_the_simulator(bench, tmp_path):
    tip, volts, states = bench.hear(
        "joint_states", "voltage_command", "deflection_controller/state"
    )
    # The controller's parameters of the wires are wrong.
    off = {"wire__heat_transfer_coefficient": 411.0, "wire__austenite_start_temperature": 332.9}
    bench.start("simulator", COMPOSITE_RIG, **FAST | {"speed": 4.0}, **off)
    triangle = {"kind": "triangle", "rise": 3.0, "fall": 3.0}
    rest = {"kind": "rest", "duration": 2.0}
    steps = [triangle | {"peak": 0.03}, rest, triangle | {"peak": -0.03}]
    reference = tmp_path / "short.yaml"
    reference.write_text(yaml.safe_dump({"name": "short", "unit": "m", "steps": steps}))
    bench.start("deflection_controller", COMPOSITE_RIG, use_sim_time=True, reference=reference)
    # Readings must arrive before the run, which takes less than a second.
    bench.until(lambda: tip and states and states[-1].data == "idle", LONG)
    bench.until(lambda: bench.trigger("deflection_controller/start").success, LONG)
    bench.until(lambda: states[-1].data.startswith(("done", "aborted")), LONG)
    assert states[-1].data == "done: short"
    # The state may overtake readings that still wait in the test's own queues.
    bench.until(lambda: min(m.position[0] for m in tip) < -0.025)
    peak = seconds_of(max(tip, key=lambda m: m.position[0]))
    bench.until(lambda: seconds_of(tip[-1]) > peak + 11.0, LONG)
    time, metres = np.array([(seconds_of(m), m.position[0]) for m in tip]).T
    corners = [-3.0, 0.0, 3.0, 5.0, 8.0, 11.0]
    wanted = np.interp(time - peak, corners, [0.0, 0.03, 0.0, 0.0, -0.03, 0.0])
    part = (time > peak - 3.0) & (time < peak + 10.5)
    assert np.sqrt(np.mean((metres - wanted)[part] ** 2)) < 1e-3
    assert (metres.min(), metres.max()) == pytest.approx((-0.03, 0.03), abs=1e-3)
    sent = np.array([m.data for m in volts])
    assert not np.any((sent[:, 0] > 0.0) & (sent[:, 2] > 0.0))
    np.testing.assert_array_equal(sent[:, 0], sent[:, 1])


def test_temperatures_come_from_a_topic_in_celsius_and_the_rules_of_the_experiment_hold(bench):
    name = "temperature_controller"
    fake, setpoints = FakeBench(bench, name), bench.hear(f"{name}/setpoint")
    node = bench.start(name, **FROM_A_TOPIC)
    bench.until(lambda: fake.state == "running: topic")
    topic = bench.talk(f"{name}/reference", Float64MultiArray)
    bench.until(lambda: fake.volts == [0.0])
    topic.publish(Float64MultiArray(data=[40.0]))
    bench.until(lambda: fake.volts[0] > 3.0 and setpoints[-1].data[0] == pytest.approx(40.0))
    for bad in ([200.0], [40.0, 40.0], [float("nan")]):
        topic.publish(Float64MultiArray(data=bad))
    bench.until(lambda: "rejected: reference has 473.15 K" in node.output and fake.progress)
    assert json.loads(fake.progress[-1].data)["duration"] is None  # it goes on until stopped
    fake.celsius = 45.0
    bench.until(lambda: fake.volts == [0.0])
    fake.celsius = 38.0
    bench.until(lambda: fake.volts[0] > 0.5)
    hot = bench.set_parameter(name, "reference", "deflection_triangle")
    assert not hot.successful and "unit is 'm', expected K" in hot.reason
    fake.silent.add("temperature")
    bench.until(lambda: fake.state.startswith("aborted: stale feedback: nothing new from wire/"))
    fake.until_zero()
    fake.silent.clear()
    assert bench.trigger(f"{name}/reset").success
    bench.until(lambda: bench.trigger(f"{name}/start").success)
    # The reference of the run that was aborted is forgotten.
    bench.until(lambda: fake.state == "running: topic")
    fake.until_zero()
    assert node.end(signal.SIGTERM) == 0 and "Traceback" not in node.output
    bench.until(lambda: fake.volts == [0.0])

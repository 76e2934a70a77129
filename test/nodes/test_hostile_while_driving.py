"""Hostile messages while nodes drive: each answers in one line and continues; its run continues,
too, or ends at 0 V with a line. For simulator, experiment and recorder see `./bench check
reliability`; the experiment's readings are tested here by a controller, which extends it. Hostile
parameters: test_every_node.py."""

import math

import pytest
from fake_bench import FakeBench
from hostile_texts import hostile
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64, String

from sma_bench.installation import share_directory
from sma_bench.ros.node import LATCHED

COMPOSITE = share_directory() / "config" / "composite_rig.yaml"
WIRES = "front_1", "front_2", "back_1", "back_2"
# The test sets the readings, whatever is commanded.
GIVEN = {"command_rate": 100.0, "autostart": True, "feedback_timeout": 1.0, "reference": "''",
         "bench__temperature_tolerance": 500.0, "bench__voltage_tolerance": 10.0}  # fmt: skip
CONTROLLER = "deflection_controller"
NUMBERS = math.nan, math.inf, -math.inf, 1e306, -1e306
STAMPS = (-(2**31), 0), (2**31 - 1, 2**32 - 1)
SINGLE = 3e38  # beyond it there are no 32-bit numbers


class Driven:
    """A node and, for a controller, the fake bench of four wires that it drives."""

    def __init__(self, bench, name):
        self.bench, self.name, self.drives = bench, name, name == CONTROLLER
        self.fake = FakeBench(bench, name if self.drives else "experiment", WIRES)
        self.node = bench.start(name, COMPOSITE, **(GIVEN if self.drives else {}))
        bench.until(lambda: "ready" in self.node.output)
        if self.drives:
            self.reference = bench.talk(f"{name}/reference", Float64)
            self.until_driven()

    def until_driven(self, seen=0):
        """Wait until a run (by the states since `seen`) commands a voltage, or was aborted."""
        bench, fake = self.bench, self.fake
        bench.until(lambda: any(s.data.startswith("running") for s in fake.states[seen:]))
        self.reference.publish(Float64(data=-0.02))
        bench.until(lambda: max(fake.volts) > 1.0 or not fake.state.startswith("running"))

    def goes_on(self):
        """It answers; its run is on, or was aborted at 0 V with one line and is started again."""
        bench, fake, name = self.bench, self.fake, self.name
        assert not bench.set_parameter(name, "use_sim_time", True).successful
        if not self.drives:
            return
        for _ in range(5):  # a reading that was on its way may end the next run too
            fake.until_heard()
            if fake.state.startswith("running"):
                return
            assert fake.state.startswith("aborted: ") and "\n" not in fake.state
            fake.until_zero()
            seen = len(fake.states)
            assert bench.trigger(f"{name}/reset").success
            bench.until(lambda: bench.trigger(f"{name}/start").success)
            self.until_driven(seen)
        raise AssertionError(fake.state)


def readings():
    """Topic, type and fields of impossible readings and impossible stamps."""
    for number in NUMBERS:
        single = min(max(number, -SINGLE), SINGLE) if math.isfinite(number) else number
        for fields in ({"voltage": single}, {"current": single}):
            yield "front_1/power", BatteryState, fields
        for fields in ({"temperature": number}, {"temperature": 25.0, "variance": number}):
            yield "front_1/temperature", Temperature, fields
        for field in ("position", "effort"):
            yield "joint_states", JointState, {"name": ["tip"], field: [number]}
    yield "joint_states", JointState, {"name": ["tip"]}
    yield "joint_states", JointState, {"name": ["tip"] * 10_000, "position": [1e306] * 20_000}


@pytest.mark.slow
@pytest.mark.parametrize("name", [CONTROLLER, "twin"])
def test_a_driving_node_answers_hostile_messages_and_its_run_continues_or_ends_at_0_v(
    bench, name
):
    driven = Driven(bench, name)
    node, fake = driven.node, driven.fake
    talkers = {}
    for topic, kind, fields in readings():
        talker = talkers.get(topic) or talkers.setdefault(topic, bench.talk(topic, kind))
        message = kind(**fields)
        for stamp in (None, *STAMPS):
            message.header.stamp = bench.node.get_clock().now().to_msg()
            if stamp:
                message.header.stamp.sec, message.header.stamp.nanosec = stamp
            talker.publish(message)
        driven.goes_on()

    if driven.drives:
        for number in NUMBERS:
            driven.reference.publish(Float64(data=number))
            driven.goes_on()
        for said_by, sound in (("recorder", ""), ("serial_bridge", "enabled")):
            talker = bench.node.create_publisher(String, f"{said_by}/state", LATCHED)
            bench.until(talker.get_subscription_count)
            for text in hostile("topics"):
                talker.publish(String(data=text))
                fake.until_heard()
                if said_by == "recorder":  # whatever the other says ends the run
                    driven.goes_on()
            talker.publish(String(data=sound))
            driven.goes_on()

        assert fake.volts[:2] == [0.0, 0.0] and min(fake.volts[2:]) > 1.0
        fake.silent.add("joints")
        bench.until(lambda: fake.state.startswith("aborted: stale feedback: nothing new"))
        fake.until_zero()
    assert node.end() == 0 and "Traceback" not in node.output
    if driven.drives:
        bench.until(lambda: max(fake.volts) == 0.0)

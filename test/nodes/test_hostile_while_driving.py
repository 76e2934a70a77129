"""Whatever comes while nodes drive: each answers in a line and goes on; what it drives goes on too,
or ends at 0 V with a line."""

import math

import pytest
import yaml
from fake_bench import FakeBench
from hostile_texts import hostile, hostile_values
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64, Float64MultiArray, String

from sma_bench.installation import share_directory
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.records import read_record
from sma_bench.ros.node import LATCHED

COMPOSITE = share_directory() / "config" / "composite_rig.yaml"
WIRES = "front_1", "front_2", "back_1", "back_2"
HOLD = {"name": "hold", "steps": [{"kind": "hold", "level": 3.0, "duration": 1000.0}]}
DRIVEN = {
    "command_rate": 100.0, "autostart": True, "feedback_timeout": 1.0,
    # Readings are what the test says, whatever is commanded.
    "bench__temperature_tolerance": 500.0, "bench__voltage_tolerance": 10.0,
}  # fmt: skip
FROM_A_TOPIC = DRIVEN | {"reference": "''"}
REFERENCES = {"temperature_controller": (Float64MultiArray, [40.0] * 4),
              "deflection_controller": (Float64, -0.02)}  # fmt: skip
CONTRACT = "bench.channels", "bench.maximum_voltage", "wire.resistance", "load.kind"
NUMBERS = math.nan, math.inf, -math.inf, 1e306, -1e306
STAMPS = (-(2**31), 0), (2**31 - 1, 2**32 - 1)
SINGLE = 3e38  # beyond it there are no 32-bit numbers


class Driven:
    """A node and what it drives, if anything: a fake bench of four wires."""

    def __init__(self, bench, name, folder):
        self.bench, self.name = bench, name
        self.drives = name not in ("twin", "recorder")
        self.fake = FakeBench(bench, name if self.drives else "experiment", WIRES)
        hold = folder / "hold.yaml"
        hold.write_text(yaml.safe_dump(HOLD))
        self.given = given = {
            "experiment": DRIVEN | {"protocol": str(hold)}, "twin": {},
            "recorder": {"output": str(folder / "bag")},
        }.get(name, FROM_A_TOPIC)  # fmt: skip
        self.node = bench.start(name, *([] if name == "recorder" else [COMPOSITE]), **given)
        self._reference = None
        if self.drives:
            self.until_driven()
        else:
            bench.until(lambda: "ready" in self.node.output)

    def until_driven(self, seen=0):
        """A run is on, of states since `seen`, and commands volts, unless it was ended; references
        of a topic are asked for again."""
        bench, fake = self.bench, self.fake
        bench.until(lambda: any(s.data.startswith("running") for s in fake.states[seen:]))
        if self.name in REFERENCES:
            kind, wanted = REFERENCES[self.name]
            topic = f"{self.name}/reference"
            self._reference = self._reference or bench.talk(topic, kind)
            self._reference.publish(kind(data=wanted))
        bench.until(lambda: max(fake.volts) > 1.0 or not fake.state.startswith("running"))

    def goes_on(self):
        """It answers; its run is on, or was ended at 0 V in one line and is begun again."""
        bench, fake, name = self.bench, self.fake, self.name
        assert not bench.set_parameter(name, "use_sim_time", True).successful
        if not self.drives:
            return
        seen = len(fake.commands)
        bench.until(lambda: len(fake.commands) > seen + 5)
        if fake.state.startswith("running"):
            return
        for _ in range(4):  # a reading that was on its way may end the next run too
            assert fake.state.startswith("aborted: ") and "\n" not in fake.state
            fake.until_zero()
            seen = len(fake.states)
            assert bench.trigger(f"{name}/reset").success
            bench.until(lambda: bench.trigger(f"{name}/start").success)
            self.until_driven(seen)
            if fake.state.startswith("running"):
                return
        raise AssertionError(fake.state)


def readings():
    """Topic, type and fields of readings that no wire has, and of moments that never were."""
    for number in NUMBERS:
        single = min(max(number, -SINGLE), SINGLE) if math.isfinite(number) else number
        for fields in ({"voltage": single}, {"current": single}):
            yield "front_1/power", BatteryState, fields
        yield "front_1/temperature", Temperature, {"temperature": number}
        yield "front_1/temperature", Temperature, {"temperature": 25.0, "variance": number}
        for field in ("position", "effort"):
            yield "joint_states", JointState, {"name": ["tip"], field: [number]}
    yield "joint_states", JointState, {"name": ["tip"]}
    yield "joint_states", JointState, {"name": ["tip"] * 10_000, "position": [1e306] * 20_000}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["experiment", "temperature_controller", "deflection_controller", "twin", "recorder"]
)
def test_whatever_is_set_and_said_a_node_that_drives_answers_and_its_run_goes_on_or_ends_cold(
    bench, name, tmp_path
):
    driven = Driven(bench, name, tmp_path)
    node, fake = driven.node, driven.fake

    # Parameters.
    for p in (*NODE_TABLES[name], *map(BY_NAME.get, CONTRACT)):
        usual = {**driven.given, "reference": ""}.get(p.name, p.default)
        for answer in bench.set_in_turn(name, p.name, [*hostile_values(usual), usual]):
            assert answer.successful or "\n" not in answer.reason and len(answer.reason) < 1000
        assert not driven.drives or fake.state.startswith("running")
    driven.goes_on()

    # Readings.
    talkers = {}
    for topic, kind, fields in readings():
        talker = talkers.get(topic) or talkers.setdefault(topic, bench.talk(topic, kind))
        message = kind(**fields)
        for stamp in (None, *STAMPS):
            if stamp is None:
                message.header.stamp = bench.node.get_clock().now().to_msg()
            else:
                message.header.stamp.sec, message.header.stamp.nanosec = stamp
            talker.publish(message)
        driven.goes_on()

    # References, and what is said of recorder and bridge.
    if name in REFERENCES:
        topic, (kind, _) = f"{name}/reference", REFERENCES[name]
        talker = bench.talk(topic, kind)
        for number in NUMBERS:
            lists = [number], [number] * 4, [], [0.0] * 10_000
            for data in lists if kind is Float64MultiArray else [number]:
                talker.publish(kind(data=data))
            driven.goes_on()
    if driven.drives:
        bridge, recorder = (
            bench.node.create_publisher(String, f"{node}/state", LATCHED)
            for node in ("serial_bridge", "recorder")
        )
        for text in hostile("topics"):
            for talker, sound in ((recorder, ""), (bridge, "enabled")):
                talker.publish(String(data=text))
                bench.until(lambda: talker.get_subscription_count())  # noqa: B023
                seen = len(fake.commands)
                bench.until(lambda: len(fake.commands) > seen + 5)  # noqa: B023
                talker.publish(String(data=sound))
                driven.goes_on()

    assert node.end() == 0 and "Traceback" not in node.output
    if name == "recorder":
        assert len(read_record(tmp_path / "bag").signals) > 10
    if driven.drives:
        bench.until(lambda: max(fake.volts) == 0.0)

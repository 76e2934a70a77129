"""A bench without physics: readings are set by the test, commands are stored."""

from functools import partial

from rclpy.duration import Duration
from sensor_msgs.msg import BatteryState, JointState, Temperature

RESISTANCE = 2.6987
MOST = 2.9  # A; the supply gives no more than the bench allows


class FakeBench:
    """Publishes every 20 ms while the test spins: the wires have the voltages that `driver`
    commands, the temperature `celsius`, and the current `ampere` (None: from the voltage); the tip
    is at rest. Kinds in `silent` (power, temperature, joints) are not published."""

    def __init__(self, bench, driver="experiment", channels=("wire",)):
        self.celsius, self.ampere, self.silent, self.late = 25.0, None, set(), 0.0
        self.bench, self._channels = bench, len(channels)
        self.commands, self.states, self.progress = bench.hear(
            "voltage_command", f"{driver}/state", f"{driver}/progress"
        )
        self._publishers = []
        for k, channel in enumerate(channels):
            self._tell("power", BatteryState, f"{channel}/power", partial(self._power, k))
            self._tell("temperature", Temperature, f"{channel}/temperature", self._temperature)
        if len(channels) > 1:
            tip = JointState(name=["tip"], position=[0.0])
            self._tell("joints", JointState, "joint_states", lambda: tip)
        bench.node.create_timer(0.02, self.publish)

    def _tell(self, kind, message, topic, make):
        publisher = self.bench.node.create_publisher(message, topic, 10)
        self._publishers.append((kind, publisher, make))

    @property
    def state(self):
        return self.states[-1].data if self.states else ""

    @property
    def volts(self):
        return list(self.commands[-1].data) if self.commands else [0.0] * self._channels

    def until_heard(self, count=5):
        """Wait for that many commands."""
        seen = len(self.commands)
        self.bench.until(lambda: len(self.commands) > seen + count)

    def until_sent(self, *volts, count=5):
        """Wait for that many commands, of which the last three have these volts."""
        self.until_heard(count)
        assert [list(m.data) for m in self.commands[-3:]] == [list(volts)] * 3

    def until_zero(self):
        self.until_sent(*[0.0] * self._channels)

    def _power(self, channel):
        volt = self.volts[channel]
        ampere = min(volt / RESISTANCE, MOST) if self.ampere is None else self.ampere
        return BatteryState(voltage=volt, current=ampere)

    def _temperature(self):
        return Temperature(temperature=float(self.celsius))

    def publish(self):
        """Publish all once, stamped `late` s ago."""
        stamp = self.bench.node.get_clock().now() - Duration(seconds=self.late)
        for kind, publisher, make in self._publishers:
            if kind not in self.silent:
                message = make()
                message.header.stamp = stamp.to_msg()
                publisher.publish(message)

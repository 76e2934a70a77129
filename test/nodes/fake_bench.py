"""A bench without physics: readings are what the test wants, commands are kept."""

from functools import partial

from sensor_msgs.msg import BatteryState, JointState, Temperature

RESISTANCE = 2.6987
MOST = 2.9  # A; the supply gives no more than the bench allows


class FakeBench:
    """Every 20 ms while the test spins: wires get what `driver` commands, be they as warm as the
    test says, and of several the tip is at `position`; `ampere` is their current instead of the
    volts'; of kinds in `silent` (power, temperature, joints) nothing comes, and `frozen` readings
    keep their stamps."""

    def __init__(self, bench, driver="experiment", channels=("wire",)):
        self.celsius, self.position, self.ampere = 25.0, 0.0, None
        self.silent, self.frozen = set(), False
        self.bench = bench
        self.commands, self.states = bench.hear("voltage_command", f"{driver}/state")
        self._channels = len(channels)
        self._stamp = bench.node.get_clock().now().to_msg()
        talk = bench.node.create_publisher
        self._publishers = [
            *(("power", talk(BatteryState, f"{c}/power", 10), partial(self._power, k))
              for k, c in enumerate(channels)),
            *(("temperature", talk(Temperature, f"{c}/temperature", 10),
               lambda: Temperature(temperature=float(self.celsius))) for c in channels),
        ]  # fmt: skip
        if len(channels) > 1:
            self._publishers.append((
                "joints", talk(JointState, "joint_states", 10),
                lambda: JointState(name=["tip"], position=[float(self.position)]),
            ))  # fmt: skip
        bench.node.create_timer(0.02, self._publish)

    @property
    def state(self):
        return self.states[-1].data if self.states else ""

    @property
    def volts(self):
        return list(self.commands[-1].data) if self.commands else [0.0] * self._channels

    def last(self, n):
        return [list(m.data) for m in self.commands[-n:]]

    def until_sent(self, *volts, count=5):
        """Wait for that many commands, of which the last three have these volts."""
        seen = len(self.commands)
        self.bench.until(lambda: len(self.commands) > seen + count)
        assert self.last(3) == [list(volts)] * 3

    def until_zero(self):
        self.until_sent(*[0.0] * self._channels)

    def _power(self, channel):
        volt = self.volts[channel]
        ampere = min(volt / RESISTANCE, MOST) if self.ampere is None else self.ampere
        return BatteryState(voltage=volt, current=ampere)

    def _publish(self):
        if not self.frozen:
            self._stamp = self.bench.node.get_clock().now().to_msg()
        for kind, publisher, make in self._publishers:
            if kind not in self.silent:
                message = make()
                message.header.stamp = self._stamp
                publisher.publish(message)

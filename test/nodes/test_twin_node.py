"""The twin as a process beside the simulator: what it says of a bench that hides an effect."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from planted import true_bench
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from sma_bench.parameters import write_parameters

EFFECT = "effect.side_heat_coupling.conductance"
HIDDEN = {EFFECT: 0.002}
PULSE = 7.0  # s
SPEED = 10.0
# Messages take most of the processor's time.
RATES = {"rate__power": 25.0, "rate__temperature": 25.0, "rate__mechanics": 25.0}

pytestmark = pytest.mark.slow


def seconds(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


class Watched:
    """Simulator and twin of their own parameter files, driven at both sides by turns."""

    def __init__(self, bench, truth, belief, folder):
        files = {"truth": folder / "truth.yaml", "belief": folder / "belief.yaml"}
        write_parameters(files["truth"], truth)
        write_parameters(files["belief"], belief)
        self.bench, self.statuses = bench, {}
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.begun = self.now = None
        bench.node.create_subscription(JointState, "joint_states", self._on_joint, 1)
        self.twin = bench.start("twin", files["belief"], use_sim_time=True)
        # The first start may compile the model.
        bench.until(lambda: "gap" in self.statuses, patience=120.0)
        bench.start("simulator", files["truth"], speed=SPEED, **RATES)
        bench.until(lambda: bench.node.count_subscribers("voltage_command"), patience=120.0)
        self.command = bench.talk("voltage_command", Float64MultiArray)
        # At rest: what is there at the first verdict counts as known, not as grown.
        bench.until(self.judged_at_rest, patience=120.0)

    def _on_diagnostics(self, message):
        for status in message.status:
            node, _, name = status.name.partition(": ")
            # A loaded machine may keep the simulator from speaking for a while.
            stale = status.level == DiagnosticStatus.STALE and name in self.statuses
            if node == "/bench/twin" and not stale:
                self.statuses[name] = status

    def _on_joint(self, message):
        self.now = seconds(message)
        self.begun = self.now if self.begun is None else self.begun

    def judged_at_rest(self):
        self.command.publish(Float64MultiArray(data=[0.0, 0.0]))
        self.begun = self.now
        return {"thermal", "mechanical"} <= self.statuses.keys() and "nan" not in {
            self.value(stage, "energy") for stage in ("thermal", "mechanical")
        }

    def run(self, duration):
        """Drive for s of simulated time, both sides by turns."""
        end = self.now + duration

        def driven():
            front = (self.now - self.begun) // PULSE % 2 == 0
            self.command.publish(Float64MultiArray(data=[2.0, 0.0] if front else [0.0, 2.0]))
            return self.now >= end

        self.bench.until(driven, patience=300.0)
        # The twin, and this test, have heard of all of it.
        target = self.now - 1.0
        self.bench.until(lambda: float(self.value("gap", "model_time")) > target, patience=60.0)

    def value(self, status, key):
        return next(item.value for item in self.statuses[status].values if item.key == key)


def test_a_hidden_effect_is_a_gap_that_grew_in_its_stage_until_the_twin_knows_of_it(
    bench, tmp_path
):
    """The twin's verdicts are those of test/twin; here, what its topics and parameters say."""
    energies, measured = bench.hear("twin/energy/thermal", "front_1/temperature")
    predicted = bench.hear("twin/front_1/temperature")
    residuals, currents = bench.hear("twin/residual/front_1/temperature", "twin/back_1/power")
    tips = bench.hear("twin/joint_states")
    watched = Watched(bench, true_bench(HIDDEN), true_bench({}), tmp_path)
    watched.run(22.0)
    gap = watched.statuses["gap"]
    assert gap.level == DiagnosticStatus.WARN
    assert gap.message.startswith("gap grew: thermal stage")
    assert watched.value("gap", "stages") == "thermal"
    assert watched.statuses["thermal"].level == DiagnosticStatus.WARN
    assert watched.statuses["mechanical"].level == DiagnosticStatus.OK
    assert energies[-1].data > 3.0
    # A residual is what the prediction lacks of the reading, with its stamp.
    assert tips[-1].name == ["tip"] and currents[-1].location == "back_1"
    by_stamp, readings = (
        {seconds(m): m.temperature for m in messages} for messages in (predicted, measured)
    )
    common = [m for m in residuals if seconds(m) in by_stamp.keys() & readings.keys()]
    assert len(common) > 10
    for m in common:
        own = readings[seconds(m)] - by_stamp[seconds(m)]
        assert m.temperature == pytest.approx(own, abs=1e-6)

    before = float(watched.value("thermal", "gap_over_noise"))
    assert bench.set_parameter("twin", EFFECT, HIDDEN[EFFECT]).successful
    watched.run(14.0)
    gap = watched.statuses["gap"]
    assert (gap.level, gap.message) == (DiagnosticStatus.OK, "no gap beyond the noise")
    assert float(watched.value("thermal", "gap_over_noise")) < 0.2 * before
    refused = bench.set_parameter("twin", "bench.channels", ["one", "two"])
    assert not refused.successful
    assert watched.twin.end() == 0
    assert "Traceback" not in watched.twin.output

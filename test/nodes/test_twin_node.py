"""The twin as a process beside the simulator: what it says of a bench that hides an effect."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from planted import believed, true_bench
from sensor_msgs.msg import BatteryState, JointState, Temperature
from std_msgs.msg import Float64, Float64MultiArray

from sma_bench.parameters import write_parameters
from sma_bench.tasks.work import write_improved

EFFECT = "effect.side_heat_coupling.conductance"
HIDDEN = {EFFECT: 0.002}
PULSE = 7.0  # s
SPEED = 10.0
# Messages take most of the processor's time.
RATES = {"rate__power": 25.0, "rate__temperature": 25.0, "rate__mechanics": 25.0}

pytestmark = pytest.mark.slow


class Watched:
    """Simulator and twin of their own parameter files, driven at both sides by turns."""

    def __init__(self, bench, truth, belief, folder, **settings):
        files = {"truth": truth, "belief": belief}
        for name, parameters in files.items():
            if not isinstance(parameters, str):
                files[name] = str(folder / f"{name}.yaml")
                write_parameters(files[name], parameters)
        self.bench = bench
        self.statuses = {}
        self.history = []
        bench.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.begun = self.now = None
        bench.node.create_subscription(JointState, "joint_states", self._on_joint, 1)
        self.twin = bench.start("twin", files["belief"], use_sim_time=True, **settings)
        # The first start may compile the model.
        bench.until(lambda: "gap" in self.statuses, patience=120.0)
        self.simulator = bench.start("simulator", files["truth"], speed=SPEED, **RATES)
        bench.until(lambda: bench.node.count_subscribers("voltage_command"), patience=120.0)
        self.command = bench.talk("voltage_command", Float64MultiArray)
        # At rest: what is there at the first verdict counts as known, not as grown.
        bench.until(self.judged_at_rest, patience=120.0)

    def _on_diagnostics(self, message):
        for status in message.status:
            node, _, name = status.name.partition(": ")
            if node == "/bench/twin":
                if name == "gap":
                    self.history.append(status.message)
                # A loaded machine may keep the simulator from speaking for a while.
                if status.level != DiagnosticStatus.STALE or name not in self.statuses:
                    self.statuses[name] = status

    def _on_joint(self, message):
        self.now = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.begun = self.now if self.begun is None else self.begun

    def seconds(self):
        """Simulated seconds so far, by the readings of the tip."""
        return 0.0 if self.now is None else self.now - self.begun

    def judged_at_rest(self):
        self.command.publish(Float64MultiArray(data=[0.0, 0.0]))
        self.begun = self.now
        return {"thermal", "mechanical"} <= self.statuses.keys() and "nan" not in {
            self.value(stage, "energy") for stage in ("thermal", "mechanical")
        }

    def run(self, seconds):
        """Drive for some simulated time, both sides by turns."""
        end = self.seconds() + seconds

        def driven():
            front = self.seconds() // PULSE % 2 == 0
            self.command.publish(Float64MultiArray(data=[2.0, 0.0] if front else [0.0, 2.0]))
            return self.seconds() >= end

        self.bench.until(driven, patience=300.0)
        # The twin, and this test, have heard of all of it.
        target = self.now - 1.0
        self.bench.until(lambda: float(self.value("gap", "model_time")) > target, patience=60.0)

    def gap(self):
        return self.statuses["gap"]

    def value(self, status, key):
        return next(item.value for item in self.statuses[status].values if item.key == key)


def test_a_hidden_effect_is_a_gap_that_grew_in_its_stage_until_the_twin_knows_of_it(
    bench, tmp_path
):
    energies = bench.listen("twin/energy/thermal", Float64)
    watched = Watched(bench, true_bench(HIDDEN), true_bench({}), tmp_path)
    watched.run(22.0)
    gap = watched.gap()
    assert gap.level == DiagnosticStatus.WARN
    assert gap.message.startswith("gap grew: thermal stage")
    assert watched.value("gap", "stages") == "thermal"
    assert watched.statuses["thermal"].level == DiagnosticStatus.WARN
    assert watched.statuses["mechanical"].level == DiagnosticStatus.OK
    assert energies[-1].data > 3.0

    before = float(watched.value("thermal", "gap_over_noise"))
    assert bench.set_parameter("twin", EFFECT, HIDDEN[EFFECT]).successful
    watched.run(14.0)
    assert watched.gap().level == DiagnosticStatus.OK
    assert watched.gap().message == "no gap beyond the noise"
    assert float(watched.value("thermal", "gap_over_noise")) < 0.2 * before
    refused = bench.set_parameter("twin", "bench.channels", ["one", "two"])
    assert not refused.successful
    assert watched.twin.end() == 0
    assert "Traceback" not in watched.twin.output


def stamp_of(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def test_a_residual_is_what_the_prediction_lacks_of_the_reading_with_its_stamp(bench, tmp_path):
    file = tmp_path / "belief.yaml"
    write_parameters(file, true_bench({}))
    measured = bench.listen("front_1/temperature", Temperature)
    predicted = bench.listen("twin/front_1/temperature", Temperature)
    residuals = bench.listen("twin/residual/front_1/temperature", Temperature)
    currents = bench.listen("twin/back_1/power", BatteryState)
    tips = bench.listen("twin/joint_states", JointState)
    bench.start("twin", str(file))
    bench.start("simulator", str(file))
    bench.until(lambda: len(residuals) > 100 and currents and tips, patience=120.0)
    assert tips[-1].name == ["tip"] and currents[-1].location == "back_1"
    by_stamp = {stamp_of(m): m.temperature for m in predicted}
    of_readings = {stamp_of(m): m.temperature for m in measured}
    common = [m for m in residuals if stamp_of(m) in by_stamp and stamp_of(m) in of_readings]
    assert len(common) > 10
    for m in common:
        own = of_readings[stamp_of(m)] - by_stamp[stamp_of(m)]
        assert m.temperature == pytest.approx(own, abs=1e-6)


def test_the_improved_file_of_a_diagnosis_shows_the_smaller_gap_live(
    bench, planted_diagnosis, tmp_path
):
    improved = tmp_path / "improved.yaml"
    write_improved(str(improved), planted_diagnosis, "a test")
    gaps = {}
    for name, belief in (("believed", believed()), ("improved", str(improved))):
        folder = tmp_path / name
        folder.mkdir()
        watched = Watched(bench, true_bench(HIDDEN), belief, folder)
        watched.run(30.0)
        gaps[name] = {
            stage: float(watched.value(stage, "gap_over_noise"))
            for stage in ("electrical", "thermal", "mechanical")
        }
        gaps[name]["level"] = watched.gap().level
        assert watched.twin.end() == 0 and watched.simulator.end() == 0
    assert gaps["believed"]["level"] == DiagnosticStatus.WARN
    assert gaps["improved"]["level"] == DiagnosticStatus.OK
    assert gaps["improved"]["thermal"] < 0.3 * gaps["believed"]["thermal"]

"""The twin as a process beside the simulator: what it says of a bench that hides an effect."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from planted import true_bench
from std_msgs.msg import Float64MultiArray

from sma_bench.parameters import write_parameters
from sma_bench.ros.node import seconds_of

EFFECT = "effect.side_heat_coupling.conductance"
HIDDEN = {EFFECT: 0.002}
PULSE = 7.0  # s
PATIENCE = 300.0
# Messages take most of the processor's time.
RATES = {"rate__power": 20.0, "rate__temperature": 20.0, "rate__mechanics": 20.0}

pytestmark = pytest.mark.slow


def test_a_hidden_effect_is_a_gap_that_grew_in_its_stage_until_the_twin_knows_of_it(
    bench, tmp_path
):
    """The twin's verdicts are those of test/twin; here, what its topics and parameters say."""
    energies, measured, predicted, residuals, currents, tips, joints, low, high = bench.hear(
        "twin/energy/thermal", "front_1/temperature", "twin/front_1/temperature",
        "twin/residual/front_1/temperature", "twin/back_1/power", "twin/joint_states",
        "joint_states", "twin/low/front_1/temperature", "twin/high/front_1/temperature",
    )  # fmt: skip

    def status(part):
        """The newest; a loaded machine may keep the simulator from speaking for a while."""
        name, stale = f"/bench/twin: {part}", DiagnosticStatus.STALE
        found = (s for a in reversed(bench.diagnostics) for s in a.status if s.name == name)
        return next((s for s in found if s.level != stale), None)

    def value(part, key):
        values = status(part).values if status(part) else ()
        return next((float(item.value) for item in values if item.key == key), float("nan"))

    def start(node, truth, **parameters):
        file = tmp_path / f"{node}.yaml"
        write_parameters(file, true_bench(truth))
        return bench.start(node, file, **parameters)

    twin = start("twin", {}, use_sim_time=True)
    bench.until(lambda: bench.diagnostics, PATIENCE)  # the first start may compile the model
    start("simulator", HIDDEN, speed=15.0, **RATES)
    command = bench.talk("voltage_command", Float64MultiArray)

    def judged_at_rest():
        command.publish(Float64MultiArray(data=[0.0, 0.0]))
        return joints and all(value(s, "energy") >= 0.0 for s in ("thermal", "mechanical"))

    # What is there at the first verdict counts as known, not as grown.
    bench.until(judged_at_rest, PATIENCE)
    begun = seconds_of(joints[-1])

    def drive(duration):
        """For s of simulated time, both sides by turns."""
        end = seconds_of(joints[-1]) + duration

        def driven():
            now = seconds_of(joints[-1])
            front = (now - begun) // PULSE % 2 == 0
            command.publish(Float64MultiArray(data=[2.0, 0.0] if front else [0.0, 2.0]))
            return now >= end

        bench.until(driven, PATIENCE)
        # The twin, and this test, have heard of all of it.
        bench.until(lambda: value("gap", "model_time") > end - 1.0, PATIENCE)

    drive(22.0)
    gap = status("gap")
    assert gap.level == status("thermal").level == DiagnosticStatus.WARN
    assert gap.message.startswith("gap grew: thermal stage")
    assert {v.key: v.value for v in gap.values}["stages"] == "thermal"
    assert status("mechanical").level == DiagnosticStatus.OK
    assert energies[-1].data > 3.0
    # A residual is what the prediction lacks of the reading, with its stamp.
    assert tips[-1].name == ["tip"] and currents[-1].location == "back_1"
    by_stamp, readings = (
        {seconds_of(m): m.temperature for m in messages} for messages in (predicted, measured)
    )
    common = [m for m in residuals if seconds_of(m) in by_stamp.keys() & readings.keys()]
    lacking = [readings[seconds_of(m)] - by_stamp[seconds_of(m)] for m in common]
    assert len(common) > 10
    assert [m.temperature for m in common] == pytest.approx(lacking, abs=1e-6)

    before = value("thermal", "gap_over_noise")
    assert bench.set_parameter("twin", EFFECT, HIDDEN[EFFECT]).successful
    assert not low and bench.set_parameter("twin", "band", 0.9).successful
    drive(14.0)
    limits = [{seconds_of(m): m.temperature for m in some} for some in (low, predicted, high)]
    shared = set(limits[0]).intersection(*limits[1:])
    assert len(shared) > 10 and all(a[t] < b[t] < c[t] for t in shared for a, b, c in [limits])
    gap = status("gap")
    assert (gap.level, gap.message) == (DiagnosticStatus.OK, "no gap beyond the noise")
    assert value("thermal", "gap_over_noise") < 0.2 * before
    assert not bench.set_parameter("twin", "bench.channels", ["one", "two"]).successful
    assert twin.end() == 0 and "Traceback" not in twin.output

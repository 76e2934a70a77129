"""The twin as a process beside the simulator: its reports on a bench with a hidden effect."""

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
# Few messages, as these take most of the CPU time.
RATES = {"rate__power": 20.0, "rate__temperature": 20.0, "rate__mechanics": 20.0}

pytestmark = pytest.mark.slow


def test_a_hidden_effect_is_a_gap_that_grew_in_its_stage_until_the_twin_knows_of_it(
    bench, tmp_path
):
    """The twin's verdicts are tested in test/twin; here, its topics and parameters."""
    energies, measured, predicted, residuals, currents, tips, joints, low, high = bench.hear(
        "twin/energy/thermal", "front_1/temperature", "twin/front_1/temperature",
        "twin/residual/front_1/temperature", "twin/back_1/power", "twin/joint_states",
        "joint_states", "twin/low/front_1/temperature", "twin/high/front_1/temperature",
    )  # fmt: skip

    def status(part):
        """The newest; on a loaded machine the simulator may pause for a while."""
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

    # A gap at the first verdict counts as known, not as grown.
    bench.until(judged_at_rest, PATIENCE)
    begun = seconds_of(joints[-1])

    def drive(duration):
        """Drive both sides in turn for so many s of simulated time."""
        end = seconds_of(joints[-1]) + duration

        def driven():
            now = seconds_of(joints[-1])
            front = (now - begun) // PULSE % 2 == 0
            command.publish(Float64MultiArray(data=[2.0, 0.0] if front else [0.0, 2.0]))
            return now >= end

        bench.until(driven, PATIENCE)
        # Until the twin and this test have received all of it.
        bench.until(lambda: value("gap", "model_time") > end - 1.0, PATIENCE)

    drive(22.0)
    gap = status("gap")
    assert gap.level == status("thermal").level == DiagnosticStatus.WARN
    assert gap.message.startswith("gap grew: thermal stage")
    assert {v.key: v.value for v in gap.values}["stages"] == "thermal"
    assert status("mechanical").level == DiagnosticStatus.OK
    assert energies[-1].data > 3.0
    # A residual is the reading minus the prediction, with the reading's stamp.
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

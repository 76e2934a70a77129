"""What a diagnosis improves, the simulator shows: the file loads, and the gap is smaller live."""

import numpy as np
import pytest
from planted import believed, true_bench
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from sma_bench.live.virtual_bench import NANOSECONDS, VirtualBench
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.physics.effects import active_effects
from sma_bench.tasks.work import write_improved

SETTINGS = {p.name: p.default for p in NODE_TABLES["simulator"]}
PERFECT = SETTINGS | {
    name: 0.0 for name in SETTINGS if name.endswith(("_noise", "_resolution"))
}
EFFECT = {"effect.side_heat_coupling.conductance": 0.002}
DRIVE = (2.0, 1.0)  # V, half of the stroke
SLICE = 0.05  # s
SETTLED = 15.0  # s, eight time constants of the wire


def virtual_course(parameters):
    """Deflection (n,) m of a bench whose sensors are perfect, driven at both sides by turns."""
    bench, found = VirtualBench(parameters, PERFECT), []
    for k in range(round(2.0 * SETTLED / SLICE)):
        voltage = DRIVE if k * SLICE < SETTLED else DRIVE[::-1]
        for reading in bench.advance(voltage, round((k + 1) * SLICE * NANOSECONDS)):
            if reading.kind == "mechanics":
                front, back = reading.values
                found.append(0.5 * (back - front))
    return np.array(found)


@pytest.fixture
def improved(planted_diagnosis, tmp_path):
    """Path of the file that the diagnosis of the planted bench writes."""
    path = tmp_path / "improved.yaml"
    write_improved(str(path), planted_diagnosis, "a test")
    return path


def test_the_virtual_bench_comes_nearer_to_the_truth_with_improved_parameters(improved):
    parameters = read_parameters(improved)
    assert active_effects(parameters)[0] == "side_heat_coupling"
    truth = virtual_course(true_bench(EFFECT))
    gaps = [
        float(np.sqrt(np.mean((virtual_course(p) - truth) ** 2)))
        for p in (believed(), parameters)
    ]
    assert gaps[0] > 5e-4
    assert gaps[1] < 0.1 * gaps[0]


def settled_deflections(bench, files):
    """Deflection [m] that a simulator node of each parameter file holds after SETTLED s."""
    found = {}
    joints = bench.listen("joint_states", JointState)
    # The same for all: of two publishers that do not sign, neither is obeyed.
    command = bench.node.create_publisher(Float64MultiArray, "voltage_command", 100)

    def driven():
        command.publish(Float64MultiArray(data=list(DRIVE)))
        return len(joints) > SETTLED * SETTINGS["rate.mechanics"]

    for name, file in files.items():
        joints.clear()
        node = bench.start("simulator", file, speed=40.0)
        bench.until(driven)
        assert node.end() == 0
        assert "Traceback" not in node.output
        found[name] = float(np.mean([message.position[0] for message in joints[-100:]]))
    return found


def test_the_simulator_node_loads_the_file_and_shows_the_smaller_gap(bench, improved, tmp_path):
    files = {"improved": improved}
    for name, parameters in (("truth", true_bench(EFFECT)), ("belief", believed())):
        files[name] = tmp_path / f"{name}.yaml"
        write_parameters(files[name], parameters)
    found = settled_deflections(bench, files)
    before, after = (abs(found[name] - found["truth"]) for name in ("belief", "improved"))
    assert before > 2e-3
    assert after < 0.1 * before + 5e-5  # what the sensors' noise and steps leave of a mean

"""What a diagnosis improves, the simulated bench shows: the file loads, and the gap is smaller
(with the nodes: test_twin_node)."""

import numpy as np
import pytest
from planted import believed, true_bench

from sma_bench.live.virtual_bench import NANOSECONDS, VirtualBench
from sma_bench.parameters import read_parameters
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

"""python -m sma_bench.physics: compiles what every command needs, once after an installation."""

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import sensitivities, simulate

if __name__ == "__main__":
    bench = Parameters.defaults()
    moved = bench.replace({"wire.resistance": 1.0001 * bench["wire.resistance"]})
    run = simulate(bench, np.arange(3) * 0.05, np.ones((3, len(bench["bench.channels"]))))
    sensitivities.Sensitivities.of(run, [moved], np.array([1e-4]))

"""python -m sma_bench.physics: compiles what every command needs, once after an installation."""

import numpy as np

from sma_bench.parameters import Parameters
from sma_bench.physics import simulate

if __name__ == "__main__":
    bench = Parameters.defaults()
    time, volts = np.array([0.0, 0.05, 0.1]), np.ones((3, len(bench["bench.channels"])))
    simulate(bench, time, volts)

"""How accurately each test of the paper measures its parameters."""

from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sma_bench.border import read_yaml
from sma_bench.parameters.parameters import Parameters


class Test(NamedTuple):
    """Minutes of a test, and the standard deviations that it leaves, of temperatures in K, of all
    others as a share. `readings_hold`: an effect that is contained in the measured parameter."""

    minutes: float
    title: str
    leaves: Mapping[str, float]
    readings_hold: str = ""

    def stds(self, parameters: Parameters) -> dict[str, float]:
        """What it leaves, in the parameters' units."""
        return {name: std if name.endswith("_temperature") else std * abs(parameters[name])
                for name, std in self.leaves.items()}


TESTS = {name: Test(**row) for name, row in read_yaml(Path(__file__).with_suffix(".yaml")).items()}
_ROUNDING = 1.1  # for deviations that are rounded in a file, or values that changed since


def least_stds(parameters: Parameters) -> dict[str, float]:
    """The smallest deviation that any test of the paper leaves, of each parameter."""
    left = [test.stds(parameters) for test in TESTS.values()]
    return {name: min(stds.get(name, np.inf) for stds in left) for name in chain(*left)}


def measured(parameters: Parameters) -> frozenset[str]:
    """Parameters stated as well as the best test of the paper leaves them: they were measured."""
    stated, least = parameters.given_uncertainty, least_stds(parameters)
    return frozenset(n for n in least if stated.get(n, np.inf) <= _ROUNDING * least[n])

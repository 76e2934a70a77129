"""Every number of a bench: name, unit, range, default and source."""

from sma_bench.parameters.parameter import TABLE, Parameter
from sma_bench.parameters.parameters import Parameters
from sma_bench.parameters.yaml_file import read_parameters, write_parameters

__all__ = ["TABLE", "Parameter", "Parameters", "read_parameters", "write_parameters"]

"""Test bench software for shape-memory-alloy actuators (Keshtkar et al.).

For notebooks: `sma_bench.load`, `simulate`, `measure`, `identify`, `diagnose`, `compare`,
`to_frame` and the other names of `sma_bench.api`, which is imported when one is first used."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from sma_bench.drawn import Drawn
from sma_bench.installation import VERSION

if TYPE_CHECKING:
    from sma_bench.api import *  # for type checkers; the same names as below

__version__ = VERSION
__all__ = ["Diagnosis", "Identification", "InputError", "Overlay", "Parameters", "Record", "Signal",
           "Simulation", "compare", "diagnose", "identify", "load", "load_parameters", "measure",
           "simulate", "to_frame", "write_parameters", "write_record"]


class _Package(ModuleType):
    """`sma_bench.identify` and `sma_bench.diagnose` are functions, but also subpackages: importing
    such a subpackage would overwrite the function, if it were not a property."""


def _on_first_use(name: str) -> property:
    def get(package: ModuleType) -> Any:
        return getattr(import_module("sma_bench.api"), name)

    def put(package: ModuleType, value: object) -> None:
        if not isinstance(value, ModuleType):
            raise AttributeError(f"sma_bench.{name} cannot be set")

    return property(get, put)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return ["__version__", *__all__]


Drawn.import_report = lambda module: import_module(f"sma_bench.report.{module}")
for _name in __all__:
    setattr(_Package, _name, _on_first_use(_name))
sys.modules[__name__].__class__ = _Package

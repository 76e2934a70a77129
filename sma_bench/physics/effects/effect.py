"""What an effect is: a name of the contract, the stage it acts in, its numbers, how it shows."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from sma_bench.errors import InputError
from sma_bench.parameters.effect_table import EFFECT_PREFIX
from sma_bench.parameters.parameter import Parameter
from sma_bench.parameters.table import TABLE

Stage = Literal["electrical", "thermal", "transformation", "mechanical", "sensor"]


@dataclass(frozen=True)
class Effect:
    """One departure from the paper's model.

    Attributes:
        name: of the contract.
        stage: where in the chain it acts.
        columns: number of `parameters/effect_table.py` (without prefix) to the core's column.
        shows: what an engineer sees at the bench.
        acts_on: signals that it can change, in the order of the chain.
    """

    name: str
    stage: Stage
    columns: Mapping[str, int]
    shows: str
    acts_on: tuple[str, ...] = ("temperature", "deflection")

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its numbers in the table, its size first."""
        prefix = f"{EFFECT_PREFIX}{self.name}."
        return tuple(p for p in TABLE if p.name.startswith(prefix))

    @property
    def size(self) -> Parameter:
        """The number that switches it on."""
        return self.parameters[0]

    @cached_property
    def switches(self) -> tuple[Parameter, ...]:
        """Numbers of which any one switches it on: those whose default is 0."""
        return tuple(p for p in self.parameters if p.default == 0.0)

    def is_on(self, parameters: Mapping[str, object]) -> bool:
        """Whether these parameters switch it on."""
        return any(parameters[p.name] != 0.0 for p in self.switches)

    def named(self, number: str) -> Parameter:
        """The table's entry of one of its numbers.

        Raises:
            InputError: the effect has no such number.
        """
        for parameter in self.parameters:
            if parameter.name == f"{EFFECT_PREFIX}{self.name}.{number}":
                return parameter
        known = ", ".join(p.name.rsplit(".", 1)[1] for p in self.parameters)
        raise InputError(f"effect {self.name}: no number {number!r}, expected {known}")

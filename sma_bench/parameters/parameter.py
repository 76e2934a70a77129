"""Declarations of the bench's parameters (name, unit, default, range, source), and of effects,
physics that the paper's model leaves out.

An effect is one file, `physics/effects/<name>.py`, with title, equation and source as docstring and
the compiled equation below, and one entry of effects.yaml with everything else. Docstrings are read
from the text of the files without importing them, so that reading a parameter file does not load
the compiler."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import yaml

from sma_bench.errors import InputError

Kind = Literal["double", "int", "bool", "string", "string_array"]
Value = float | int | bool | str | tuple[str, ...]
_EXPECTED: dict[str, tuple[type | tuple[type, ...], str]] = {
    "double": ((int, float), "a number"),
    "int": (int, "a whole number"),
    "bool": (bool, "true or false"),
    "string": (str, "a string"),
    "string_array": ((list, tuple), "a list of strings"),
}
_CELSIUS_RANGE = (-100.0, 200.0)
_UNIT_SLIPS = (1e-3, 1e3, 1e-6, 1e6, 1e-9, 1e9)


@dataclass(frozen=True)
class Parameter:
    """Declaration of one parameter, under a dotted name that files, nodes and commands share."""

    name: str
    unit: str  # SI, "" for none
    default: Value
    description: str
    provenance: str  # paper table or equation, or "assumed: why"
    low: Any = None  # inclusive range of a number, in its unit; None of a text
    high: Any = None
    # standard deviation, in its unit, of a value stated without one, as in a careful lab; it is
    # at least and at most these shares of that value, unless the value is 0
    uncertainty: float | None = None
    least_share: float = 0.0
    most_share: float = math.inf
    # standard deviation of a value that is not stated: how much wires and benches differ in it, by
    # spread_source; None: as uncertainty (a sensor's data sheet, an effect's number)
    spread: float | None = None
    spread_source: str = ""
    kind: Kind = "double"
    read_only: bool = False  # a running node cannot change it

    @property
    def default_std(self) -> float | None:
        """Standard deviation of the default, where nobody stated the number."""
        return self.uncertainty if self.spread is None else self.spread

    def stated_std(self, value: Any) -> float | None:
        """Standard deviation of a value that was stated without one."""
        if (std := self.uncertainty) and isinstance(value, (int, float)) and (size := abs(value)):
            std = min(max(std, self.least_share * size), self.most_share * size)
        return std

    def validated(self, value: Any, where: str = "") -> Value:
        """The value in its own type. InputError, after `where`: wrong type, infinite, outside."""
        prefix = f"{where}: " if where else ""
        types, expected = _EXPECTED[self.kind]
        fits = isinstance(value, types) and isinstance(value, bool) == (self.kind == "bool")
        several, unit = self.kind == "string_array", ""
        if self.unit not in ("", "1"):
            unit = f" {self.unit}"
        if not fits or (several and not all(isinstance(i, str) for i in value)):
            expected += f" in{unit}" if unit else ""
            raise InputError(f"{prefix}{self.name} is {value!r}, expected {expected}")
        if self.low is None:  # a text or a bool
            return tuple(value) if several else value  # type: ignore[no-any-return]
        number: float | int = float(value) if self.kind == "double" else value
        if not math.isfinite(number):
            raise InputError(f"{prefix}{self.name} is {number}, expected a finite number")
        if self.low <= number <= self.high:
            return number
        hints = {}
        if self.unit == "K" and _CELSIUS_RANGE[0] <= number <= _CELSIUS_RANGE[1]:
            hints = {number + 273.15: "is it in degrees Celsius?"}
        elif self.unit == "1" and self.high <= 1.0:
            hints = {0.01 * number: "is it in percent?"}
        elif unit and (self.low != 0.0 or number > 0.0):
            hints = {number * factor: f"times {factor:g} it would fit: wrong unit prefix?"
                     for factor in _UNIT_SLIPS}
        hint = next((f" ({hints[x]})" for x in hints if self.low <= x <= self.high), "")
        raise InputError(f"{prefix}{self.name} is {number:g}{unit}, expected {self.low:g} to "
                         f"{self.high:g}{unit}{hint}")


def declared(tree: Mapping[str, Any], prefix: str = "") -> tuple[Parameter, ...]:
    """The parameters of a tree in the layout of generate_parameter_library, with unit, source,
    uncertainty, spread and spread_source. Raises KeyError, TypeError: a leaf that lacks its type,
    default, description or source, or with a field that no parameter has."""
    found: list[Parameter] = []
    for name, node in tree.items():
        if "type" not in node:
            found += declared(node, f"{prefix}{name}.")
            continue
        own = {"unit": "", **node}
        kind, default = own.pop("type"), own.pop("default_value")
        low, high = own.pop("validation", {}).get("bounds<>", (None, None))
        unit, text, source = (own.pop(key) for key in ("unit", "description", "source"))
        found.append(Parameter(prefix + name, unit, default, text, source, low, high, kind=kind,
                               **own))
    return tuple(found)


class _Loader(yaml.CSafeLoader):
    """Reads lists as tuples."""


_Loader.add_constructor("tag:yaml.org,2002:seq",
                        lambda self, node: tuple(self.construct_sequence(node, deep=True)))


def read_declarations(name: str) -> dict[str, Any]:
    """The tree in a YAML file of this folder, its lists as tuples."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return yaml.load(text, Loader=_Loader)  # type: ignore[no-any-return]  # noqa: S506 (is safe)


# --- effects

EFFECT_PREFIX = "effect."
EFFECT_FILES = Path(__file__).resolve().parents[1] / "physics" / "effects"
Stage = Literal["electrical", "thermal", "transformation", "mechanical", "sensor"]
LOAD_KINDS = ("clamped", "displacement", "force", "spring", "antagonist", "beam")
LAWS = ("cosine", "exponential", "logistic", "normal", "brinson", "extended")
# Drives that hold a current or power at any resistance, and their number in the core.
SOURCES = {"current": 1.0, "power": 2.0}
CHOICES = {  # of text parameters; "" is chosen by `parameters.load_kind`
    "load.kind": ("", *LOAD_KINDS), "bench.drive": ("voltage", "duty", "current", "power"),
    "wire.law": LAWS, "wire.convection": ("constant", "free"),
}


@dataclass(frozen=True)
class Effect:
    """One departure from the paper's model, called as its file; off with every default."""

    stage: Stage
    # its numbers, the size first: `effect.<name>.<number>`, in its entry without the prefix
    parameters: tuple[Parameter, ...]
    shows: str  # what an engineer sees at the bench
    acts_on: tuple[str, ...] = ("temperature", "deflection")  # signals, in the order of the chain
    loads: tuple[str, ...] = LOAD_KINDS  # under which a bench can have it
    laws: tuple[str, ...] = LAWS  # of the phase, with which it can be on
    # columns of the core that are 1 where it is on, so that a step computes more
    marks: tuple[str, ...] = ()
    row: Literal["wire", "side"] = "wire"  # for which its columns are
    # its possible equations, each with the numbers in it; the first is the usual one
    forms: Mapping[str, tuple[str, ...]] | None = None
    # column of the core by number, if the core reads the number unchanged
    columns: Mapping[str, str] = field(default_factory=dict)
    # Further columns of that row: constant; handed from step to step, 0 at the start; used within
    # a step. A name that is repeated n times is the first of n columns.
    constants: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    scratch: tuple[str, ...] = ()
    # parameters whose values depend on the reference of the effect: what a change of them would do
    # as well is not counted as an action of the effect
    beside: tuple[str, ...] = ()
    # by number, the parameter that multiplies it in the model: no record separates the two, so the
    # parameter's uncertainty is part of the number's error
    times: Mapping[str, str] | None = None
    name: str = ""  # that of its file
    text: str = ""  # title, equation and source: the docstring of its file

    @property
    def size(self) -> Parameter:
        """The number that switches it on."""
        return self.parameters[0]

    @cached_property
    def switches(self) -> tuple[Parameter, ...]:
        """Numbers of which any one switches it on: those whose default is 0."""
        return tuple(p for p in self.parameters if p.default == 0.0)

    def numbers(self, form: str = "") -> tuple[Parameter, ...]:
        """Those of one of its forms, by default the usual one. KeyError: it has no such form."""
        if not self.forms:
            return self.parameters
        return tuple(map(self.named, self.forms[form or next(iter(self.forms))]))

    def is_on(self, parameters: Mapping[str, object]) -> bool:
        """True if these parameters switch it on."""
        return any(parameters[p.name] != 0.0 for p in self.switches)

    def named(self, number: str) -> Parameter:
        """The table's entry of one of its numbers. Raises InputError: it has no such number."""
        own = {p.name.rpartition(".")[2]: p for p in self.parameters}
        if number not in own:
            expected = ", ".join(own)
            raise InputError(f"effect {self.name}: no number {number!r}, expected {expected}")
        return own[number]


def declared_effects(tree: Mapping[str, Any], folder: Path = EFFECT_FILES) -> dict[str, Effect]:
    """Effects of a tree by name, in the order of the chain's stages, with the docstrings of their
    files in a folder; their numbers are doubles and 0 unless stated. Raises ValueError: an effect
    without entry, file or docstring; a field that is missing or that nothing has."""
    texts = {p.stem: p.read_text(encoding="utf-8").split('"""') for p in folder.glob("[!_]*.py")}
    found: dict[str, list[Effect]] = {stage: [] for stage in get_args(Stage)}
    off = {"type": "double", "default_value": 0.0}
    for name in sorted({*tree, *texts}):
        if name not in tree or len(texts.get(name, ())) < 3:
            where = f"an entry in effects.yaml and a docstring in {folder / name}.py"
            raise ValueError(f"effect {name}: expected {where}")
        try:
            fields, text = dict(tree[name]), inspect.cleandoc(texts[name][1])
            numbers = {number: {**off, **own} for number, own in fields.pop("parameters").items()}
            parameters = declared(numbers, f"{EFFECT_PREFIX}{name}.")
            effect = Effect(parameters=parameters, name=name, text=text, **fields)
            found[effect.stage].append(effect)
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"effects.yaml: {name}: missing or unknown: {error}") from None
    return {effect.name: effect for effects in found.values() for effect in effects}


EFFECTS = declared_effects(read_declarations("effects.yaml"))
EFFECT_TABLE: tuple[Parameter, ...] = tuple(p for e in EFFECTS.values() for p in e.parameters)

# --- every parameter of the bench contract: what parameters.yaml declares, and the effects' numbers

TABLE: tuple[Parameter, ...] = (*declared(read_declarations("parameters.yaml")), *EFFECT_TABLE)
BY_NAME: dict[str, Parameter] = {parameter.name: parameter for parameter in TABLE}
# Uncertainties of sensors with exactly known scales, such as those of a simulated bench.
EXACT_SENSORS = {p.name: 0.0 for p in TABLE if p.name.startswith("sensor.")
                 and not p.name.endswith(".lag")}
TRANSITIONS = {
    "A_s": "wire.austenite_start_temperature",
    "A_f": "wire.austenite_finish_temperature",
    "M_s": "wire.martensite_start_temperature",
    "M_f": "wire.martensite_finish_temperature",
}

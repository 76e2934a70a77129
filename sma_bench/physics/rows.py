"""Parameters converted to the rows of columns.py."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sma_bench.parameters import Parameters
from sma_bench.parameters.effect_table import EFFECT_PREFIX
from sma_bench.physics import columns as at
from sma_bench.physics.boundary import Boundary, per_side, side_names, side_of_channels
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.heat import time_constant

Array = NDArray[np.float64]

_WIRE_NUMBERS = (
    "resistance", "heat_transfer_coefficient", "surface_area", "specific_heat", "mass",
    "austenite_start_temperature", "austenite_finish_temperature",
    "martensite_start_temperature", "martensite_finish_temperature",
    "stress_influence_austenite", "stress_influence_martensite",
    "austenite_modulus", "martensite_modulus", "maximum_recoverable_strain",
    "thermal_expansion_factor", "transition_spread", "transition_tail",
)
HEATING_EFFECTS = (
    "phase_dependent_resistance", "supply_drop", "temperature_dependent_convection",
    "matrix_thermal_mass", "side_heat_coupling", "ambient_drift",
)
_READING = ("temperature_underfill", "temperature_lag")
_EVOLVING = (
    "matrix_thermal_mass", "transition_drift", "residual_strain", *_READING,
)
_BENDING = ("viscoelastic_matrix", "opposing_wires", "slack")


def wire_rows(parameters: Parameters) -> Array:
    """(w, WIRE_COLUMNS) constants of every wire; states are 0."""
    wires = np.zeros((len(parameters["bench.channels"]), at.WIRE_COLUMNS))
    for column, number in {**_effects(parameters), **_wire(parameters)}.items():
        wires[:, column] = number
    side = side_of_channels(parameters)
    wires[:, at.SIDE] = side
    # Between unequal numbers of wires: what one side gives, the other gets.
    own = np.bincount(side)[side]
    wires[:, at.ACROSS] *= (side.size - own) / np.maximum(own, side.size - own)
    return wires


def side_rows(parameters: Parameters, boundary: Boundary) -> Array:
    """(s, SIDE_COLUMNS) constants of every side; states are 0."""
    count = len(side_names(parameters))
    sides = np.zeros((count, at.SIDE_COLUMNS))
    sides[:, at.PRESCRIBED] = boundary.contraction is not None
    for column in (at.STIFFNESS, at.OWN_STIFFNESS):
        sides[:, column] = per_side("stiffness", boundary.stiffness, count)
    for column in (at.LOAD, at.OWN_LOAD):
        sides[:, column] = per_side("load", boundary.load, count)
    # A side that is held, or pulls against nothing elastic, has nothing to relax or hang.
    bends = (sides[:, at.OWN_STIFFNESS] > 0.0) & (boundary.contraction is None)
    for name in _BENDING:
        for number, column in EFFECTS[name].columns.items():
            sides[bends, column] = parameters[f"{EFFECT_PREFIX}{name}.{number}"]
    sides[:, at.PULLS_OTHERWISE] = (bends & _any_on(_BENDING, parameters)) | _any_on(
        ("residual_strain",), parameters
    )
    return sides


def _any_on(names: tuple[str, ...], parameters: Parameters) -> bool:
    return any(EFFECTS[name].is_on(parameters) for name in names)


def _effects(parameters: Parameters) -> Mapping[int, float]:
    """Columns that hold an effect's number as it is; `_wire` overrides those that do not."""
    columns = {
        column: float(parameters[f"{EFFECT_PREFIX}{name}.{number}"])
        for name, effect in EFFECTS.items() if name not in _BENDING
        for number, column in effect.columns.items()
    }
    columns[at.HEATED_OTHERWISE] = float(_any_on(HEATING_EFFECTS, parameters))
    columns[at.EVOLVES] = float(
        _any_on(_EVOLVING, parameters) or columns[at.RETURN_POINT] != 0.0
    )
    columns[at.READ_OTHERWISE] = float(_any_on(_READING, parameters))
    return columns


def _wire(parameters: Parameters) -> Mapping[int, float]:
    wire = {name: float(parameters[f"wire.{name}"]) for name in _WIRE_NUMBERS}
    loss = wire["heat_transfer_coefficient"] * wire["surface_area"]
    a_s, a_f = wire["austenite_start_temperature"], wire["austenite_finish_temperature"]
    m_s, m_f = wire["martensite_start_temperature"], wire["martensite_finish_temperature"]
    shift = f"{EFFECT_PREFIX}stress_dependent_transition."
    return {
        at.AMBIENT: parameters["environment.ambient_temperature"],
        at.HEATING: 1.0 / (wire["resistance"] * loss),
        at.TIME_CONSTANT: time_constant(parameters),
        at.LATENT_RISE: parameters["effect.latent_heat.heat"] / wire["specific_heat"],
        at.CAPACITY: wire["mass"] * wire["specific_heat"],
        at.LOSS: loss,
        at.RESISTANCE: wire["resistance"],
        at.AUSTENITE_FINISH: a_f,
        at.AUSTENITE_FINISH_FRESH: a_f,
        at.AUSTENITE_SLOPE: 1.0 / (a_f - a_s),
        at.AUSTENITE_SHIFT: max(
            1.0 / wire["stress_influence_austenite"] + parameters[shift + "austenite"], 0.0
        ),
        at.AUSTENITE_SPREAD: wire["transition_spread"] / (a_f - a_s),
        at.MARTENSITE_SPREAD: wire["transition_spread"] / (m_s - m_f),
        at.TAIL: wire["transition_tail"],
        at.MARTENSITE_FINISH: m_f,
        at.MARTENSITE_FINISH_FRESH: m_f,
        at.MARTENSITE_SLOPE: 1.0 / (m_s - m_f),
        at.MARTENSITE_SHIFT: max(
            1.0 / wire["stress_influence_martensite"] + parameters[shift + "martensite"], 0.0
        ),
        at.AUSTENITE_MODULUS: wire["austenite_modulus"],
        at.MODULUS_CHANGE: wire["martensite_modulus"] - wire["austenite_modulus"],
        at.RECOVERABLE_STRAIN: wire["maximum_recoverable_strain"],
        at.FULL_STRAIN: wire["maximum_recoverable_strain"],
        at.EXPANSION: wire["thermal_expansion_factor"],
    }

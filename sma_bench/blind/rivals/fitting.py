"""Bounded least squares with a few simulations: Levenberg and Marquardt on finite differences."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from sma_bench.blind.rivals.observed import Observed
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS

Array = npt.NDArray[np.float64]

_STEP = 0.05  # of a finite difference, in scales
_ROUNDS = 5
_ENOUGH = 1e-4  # relative gain below which a fit is done
_DAMPING, _CALMER, _BOLDER, _TRIALS = 1e-4, 10.0, 0.1, 5
_BACK, _FRONT = "composite.stress_per_deflection_back", "composite.stress_per_deflection_front"

# The numbers of the baseline that may be off. The area acts only together with h, the mass only
# together with c_p; both sides share one beta.
_BASELINE = (
    ("environment.ambient_temperature",),
    ("wire.resistance",),
    ("wire.heat_transfer_coefficient",),
    ("wire.specific_heat",),
    ("wire.austenite_start_temperature",),
    ("wire.austenite_finish_temperature",),
    ("wire.martensite_start_temperature",),
    ("wire.martensite_finish_temperature",),
    ("wire.stress_influence_austenite",),
    ("wire.stress_influence_martensite",),
    ("wire.martensite_modulus",),
    ("wire.austenite_modulus",),
    ("wire.maximum_recoverable_strain",),
    ("wire.thermal_expansion_factor",),
    ("composite.deflection_per_strain",),
    (_FRONT, _BACK),
)


@dataclass(frozen=True)
class Knob:
    """Parameters that share one value, and the scale on which it moves."""

    names: tuple[str, ...]
    scale: float

    @property
    def limits(self) -> tuple[float, float]:
        """Range of the parameter table."""
        low, high = BY_NAME[self.names[0]].low, BY_NAME[self.names[0]].high
        return -np.inf if low is None else low, np.inf if high is None else high


@dataclass(frozen=True)
class Fit:
    """Fitted parameters; `square` is the sum of squares of the residuals over their noise."""

    parameters: Parameters
    square: float
    knobs: tuple[Knob, ...]


def baseline_knobs(parameters: Parameters) -> tuple[Knob, ...]:
    """The baseline's numbers on the scale of their uncertainty; a number that is derived from the
    geometry (0) stays derived."""
    return tuple(
        Knob(names, parameters.std(names[0]))
        for names in _BASELINE
        if parameters[names[0]] != 0.0 and parameters.std(names[0]) > 0.0
    )


@dataclass(frozen=True, eq=False)
class Slope:
    """(n, k) change of the whitened residuals a scale of each of k knobs."""

    knobs: tuple[Knob, ...]
    columns: Array


def effect_knobs(name: str, parameters: Parameters) -> tuple[Knob, ...]:
    """The numbers of an effect."""
    return tuple(Knob((p.name,), parameters.std(p.name)) for p in EFFECTS[name].parameters)


def whitened(observed: Sequence[Observed], parameters: Parameters) -> Array:
    """Residuals of all records over their noise."""
    return np.concatenate([one.whitened(parameters) for one in observed])


def moved(parameters: Parameters, knobs: Sequence[Knob], steps: ArrayLike) -> Parameters:
    """Parameters with every knob moved by so many scales, held within its range."""
    values: dict[str, float] = {}
    for knob, step in zip(knobs, np.asarray(steps, dtype=float).tolist(), strict=True):
        value = float(np.clip(parameters[knob.names[0]] + step * knob.scale, *knob.limits))
        values |= dict.fromkeys(knob.names, value)
    return _ordered(parameters, values)


def _ordered(parameters: Parameters, values: dict[str, float]) -> Parameters:
    """A transformation may not end before it begins; such a move keeps the temperatures."""
    pairs = (("austenite_start", "austenite_finish"), ("martensite_finish", "martensite_start"))
    for lower, upper in pairs:
        names = [f"wire.{which}_temperature" for which in (lower, upper)]
        low, high = (values.get(name, parameters[name]) for name in names)
        if high - low < 0.5:
            values = {name: value for name, value in values.items() if name not in names}
    return parameters.replace(values)


def jacobian(
    observed: Sequence[Observed], parameters: Parameters, knobs: Sequence[Knob], here: Array
) -> Array:
    """(n, k) change of the whitened residuals a scale of each knob.

    Args:
        here: the residuals at `parameters`.
    """
    columns = []
    for k, knob in enumerate(knobs):
        step = _STEP if parameters[knob.names[0]] + _STEP * knob.scale <= knob.limits[1] else -_STEP
        steps = np.zeros(len(knobs))
        steps[k] = step
        columns.append((whitened(observed, moved(parameters, knobs, steps)) - here) / step)
    return np.column_stack(columns)


def fit(
    observed: Sequence[Observed],
    start: Parameters,
    knobs: Sequence[Knob],
    rounds: int = _ROUNDS,
    slow: Slope | None = None,
) -> Fit:
    """Least squares over some knobs.

    Args:
        observed: records; start: where the knobs stand at first.
        slow: knobs that are fitted too, with their slope at the start, which is kept.
    """
    parameters, here = start, whitened(observed, start)
    square, slope = float(here @ here), slow or Slope((), np.zeros((len(here), 0)))
    every, damping = (*knobs, *slope.knobs), _DAMPING
    for _ in range(rounds):
        fast = jacobian(observed, parameters, knobs, here) if knobs else slope.columns[:, :0]
        columns = np.hstack([fast, slope.columns])
        found = _step(observed, parameters, every, columns, here, damping)
        if found is None:
            break
        parameters, here, damping = found
        gain, square = 1.0 - float(here @ here) / square, float(here @ here)
        if gain < _ENOUGH:
            break
    return Fit(parameters, square, every)


def slope_at(
    observed: Sequence[Observed], parameters: Parameters, knobs: Sequence[Knob], here: Array
) -> Slope:
    """Slope of some knobs at a point whose residuals are `here`."""
    return Slope(tuple(knobs), jacobian(observed, parameters, knobs, here))


def _step(
    observed: Sequence[Observed],
    parameters: Parameters,
    knobs: Sequence[Knob],
    slope: Array,
    here: Array,
    damping: float,
) -> tuple[Parameters, Array, float] | None:
    """The least damped step that makes the residuals smaller, these, and the damping to begin
    the next one with (Marquardt's rule); None if no step does."""
    normal, gradient = slope.T @ slope, slope.T @ here
    scale = np.diag(np.diag(normal) + 1e-9 * np.trace(normal) + 1e-12)
    for _ in range(_TRIALS):
        trial = moved(parameters, knobs, -np.linalg.solve(normal + damping * scale, gradient))
        there = whitened(observed, trial)
        if float(there @ there) < float(here @ here):
            return trial, there, damping * _BOLDER
        damping *= _CALMER
    return None

"""What is known of the parameters before a fit: Gaussian priors from values and uncertainties."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from sma_bench.identify.estimate import Array, Mask
from sma_bench.parameters import Parameters
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics import bending_coefficients

BENDING = (
    "composite.deflection_per_strain",
    "composite.stress_per_deflection_front",
    "composite.stress_per_deflection_back",
)
HEAT = (
    "wire.resistance",
    "wire.heat_transfer_coefficient",
    "wire.specific_heat",
    "wire.mass",
    "wire.surface_area",
    "environment.ambient_temperature",
)
MATERIAL = (
    "wire.austenite_start_temperature",
    "wire.austenite_finish_temperature",
    "wire.martensite_start_temperature",
    "wire.martensite_finish_temperature",
    "wire.martensite_modulus",
    "wire.austenite_modulus",
    "wire.maximum_recoverable_strain",
    "wire.thermal_expansion_factor",
    "wire.stress_influence_austenite",
    "wire.stress_influence_martensite",
)
SECTION = ("wire.diameter",)
_STRAIGHT = {
    "environment.ambient_temperature",
    "wire.austenite_start_temperature",
    "wire.austenite_finish_temperature",
    "wire.martensite_start_temperature",
    "wire.martensite_finish_temperature",
    "wire.thermal_expansion_factor",
}
_DERIVED_STD = 0.3  # relative, of bending coefficients that only an assumed geometry gives
_REACH = 100.0
_NARROWEST_RANGE = 0.2
_ORDERED = (
    ("wire.austenite_start_temperature", "wire.austenite_finish_temperature"),
    ("wire.martensite_finish_temperature", "wire.martensite_start_temperature"),
)


@dataclass(frozen=True)
class Prior:
    """Independent Gaussian knowledge of k parameters, and the unknowns x that a fit moves.

    `mean`, `std`, `low`, `high` (k,) in the units of the contract; `base` holds all the others.
    x counts prior standard deviations from the means; of a positive parameter it moves the
    logarithm, because the model mostly knows products, which are straight lines there.
    """

    base: Parameters
    names: tuple[str, ...]
    mean: Array
    std: Array
    low: Array
    high: Array

    @property
    def _relative(self) -> Array:
        """(k,) relative standard deviation of what is moved by its logarithm, 0 of the others."""
        straight = np.array([name in _STRAIGHT for name in self.names])
        return np.where(straight, 0.0, self.std / self.mean)

    def values(self, x: Array) -> Array:
        """(k,) parameters at `x` (k,)."""
        relative = self._relative
        grown = self.mean * np.exp(relative * x)
        moved = np.where(relative > 0.0, grown, self.mean + self.std * x)
        return np.clip(moved, self.low, self.high)

    def slopes(self, x: Array) -> Array:
        """(k,) derivative of the parameters with respect to x."""
        relative = self._relative
        return np.asarray(np.where(relative > 0.0, relative * self.values(x), self.std))

    def x_of(self, values: Array) -> Array:
        """(k,) unknowns of given parameters."""
        relative = self._relative
        safe = np.where(relative > 0.0, relative, 1.0)
        ratio = np.where(relative > 0.0, values / self.mean, 1.0)
        return np.asarray(
            np.where(relative > 0.0, np.log(ratio) / safe, (values - self.mean) / self.std)
        )

    def deviations(self, x: Array) -> Array:
        """(k,) standard deviations from the means: the prior's residuals."""
        return (self.values(x) - self.mean) / self.std

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest (k,) of `x`: the table's range, within 100 standard deviations."""
        low = np.maximum(self.x_of(self.low), -_REACH)
        high = np.minimum(self.x_of(self.high), _REACH)
        return low, high

    def parameters(self, x: Array) -> Parameters:
        """Parameters at `x`; a start temperature that has passed its finish is held below it."""
        values = dict(zip(self.names, self.values(x).tolist(), strict=True))
        for lower, upper in _ORDERED:
            start, finish = (values.get(n, self.base[n]) for n in (lower, upper))
            if finish - start < _NARROWEST_RANGE:
                middle = 0.5 * (start + finish)
                values[lower] = middle - 0.5 * _NARROWEST_RANGE
                values[upper] = middle + 0.5 * _NARROWEST_RANGE
        return self.base.replace(values)

    def widened(self, which: Mask, factor: float) -> "Prior":
        """The same with the standard deviations of `which` (k,) bool enlarged."""
        return replace(self, std=np.where(which, factor * self.std, self.std))


def prior_of(parameters: Parameters, names: Iterable[str]) -> Prior:
    """Prior from the values and the `uncertainty.` of a parameter set.

    A parameter with uncertainty 0 is exact and not among the names. Bending coefficients which are
    derived from the geometry start there, with 30 % unless their uncertainty is given.
    """
    derived = dict(zip(BENDING, bending_coefficients(parameters), strict=True))
    chosen, mean, std = [], [], []
    for name in names:
        value = derived.get(name, parameters[name])
        error = parameters.std(name)
        if name in derived and name not in parameters.given_uncertainty:
            error = max(error, _DERIVED_STD * value) if not parameters[name] else error
        if error > 0.0:
            chosen.append(name)
            mean.append(value)
            std.append(error)
    fixed = {n: v for n, v in derived.items() if n not in chosen and parameters[n] != v}
    low, high = (
        np.array([getattr(BY_NAME[name], end) for name in chosen], float) for end in ("low", "high")
    )
    positive = np.array([name in BENDING for name in chosen])
    low = np.where(positive, 1e-3 * np.array(mean), low)
    return Prior(
        parameters.replace(fixed), tuple(chosen), np.array(mean), np.array(std), low, high
    )

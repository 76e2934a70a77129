"""The constitutive law under constant stress, as the joint fit E9 sees it.

Solved for strain, eqs. (6) to (11) say

    eps = eps_ref + sigma/E(xi) - Theta_T (T - T_inf)/E(xi) - eps_L (1 - xi),

with the cosines of eqs. (10), (11) shifted by sigma/C_A, sigma/C_M and with the contract's rule for
incomplete loops. That is the law "contract". The law "extended" replaces what real, untrained
material does not obey:

- eps_L becomes H(sigma) = H_min + (H_sat - H_min)(1 - exp(-k sigma)), the current transformation
  strain of Lagoudas (Shape memory alloys, 2008, ch. 3) with its critical stress set to zero, since
  data seldom lie below it;
- A_s, A_f, M_s, M_f each have a slope of their own against stress (ranges widen with stress), and
  each direction a bend, T = T_0 + slope sigma + bend sigma^2: by Clausius and Clapeyron dT/dsigma
  goes with the transformation strain, which is no constant;
- expansion is alpha_A + xi (alpha_M - alpha_A) instead of -Theta_T/E(xi), which would make
  martensite expand more than austenite because it is softer;
- martensite's strain fades by a share per kelvin of warming, H (1 - fading (T - T_ref)): variants
  reorient and the least stable ones transform long before A_s;
- irrecoverable strain grows in proportion to the material transformed (Lagoudas and Entchev,
  2004), by one number a loop.

eps_ref is free in every loop: an extensometer's zero means nothing. It and the irrecoverable
strain enter linearly and are eliminated exactly (Golub and Pereyra, 1973).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sma_bench.errors import InputError
from sma_bench.identify.estimate import Array
from sma_bench.identify.instruments.tangents import Bins, strain_tangents
from sma_bench.parameters import Parameters
from sma_bench.records.isobaric import Branch, Cycle, IsobaricRecord

Law = Literal["contract", "extended"]
REFERENCE_STRESS = 100e6  # Pa, unit of stress within the fit
BINS = 150
_NARROWEST = 0.2  # K


@dataclass(frozen=True)
class Path:
    """One branch in order of time: temperature (n,) K as measured, and means (m,) over bins of it:
    `strain`, and `level` K."""

    rising: bool
    temperature: Array
    bins: Bins
    strain: Array
    level: Array


@dataclass(frozen=True)
class Loop:
    """One cycle at one stress (Pa).

    `recovered` is the strain that heating recovers as read by the tangents (their full range where
    none can be drawn); residuals are counted in units of it.
    """

    label: str
    stress: float
    paths: tuple[Path, ...]
    recovered: float
    is_relative: bool

    @property
    def strain(self) -> Array:
        """(n,) of all paths."""
        return np.concatenate([path.strain for path in self.paths])

    @property
    def temperature(self) -> Array:
        """(n,) K of all paths."""
        return np.concatenate([path.level for path in self.paths])


@dataclass(frozen=True)
class Elastic:
    """Moduli E_A, E_M in Pa, and the temperature of zero expansion, K."""

    austenite: float
    martensite: float
    ambient: float


def elastic(parameters: Parameters) -> Elastic:
    """The elastic part, which isobaric tests cannot tell from eps_L and so is taken as given."""
    return Elastic(
        parameters["wire.austenite_modulus"], parameters["wire.martensite_modulus"],
        parameters["environment.ambient_temperature"],
    )


def make_loops(records: Sequence[IsobaricRecord]) -> list[Loop]:
    """Every cycle of every record as a loop, in order of stress."""
    loops = [_loop(record, cycle) for record in records for cycle in record.cycles]
    return sorted(loops, key=lambda loop: loop.stress)


def martensite_fractions(law: Law, p: Mapping[str, float], loop: Loop) -> list[Array]:
    """xi along every path of a loop: from 1 when it begins with heating, else from 0."""
    rising = loop.paths[0].rising
    xi_reversed = 1.0 if rising else 0.0
    found = []
    for path in loop.paths:
        # Lower end and width (K) of the transformation range at a stress.
        names = ("A_s", "A_f") if path.rising else ("M_f", "M_s")
        s = loop.stress / REFERENCE_STRESS
        if law == "contract":
            slopes = (p["slope_A" if path.rising else "slope_M"],) * 2
        else:
            slopes = (p[f"slope_{names[0]}"], p[f"slope_{names[1]}"])
        bend = p.get("bend_A" if path.rising else "bend_M", 0.0) * s**2
        low, high = (p[name] + slope * s + bend for name, slope in zip(names, slopes, strict=True))
        start, width = low, max(high - low, _NARROWEST)
        left = 0.5 + 0.5 * np.cos(np.pi * np.clip((path.temperature - start) / width, 0.0, 1.0))
        if not path.rising:
            # eq. (11) is martensite; what vanishes on cooling is austenite.
            left = 1.0 - left
        share = left / left[0] if left[0] > 1e-9 else left
        vanishing = xi_reversed if path.rising else 1.0 - xi_reversed
        xi = vanishing * share if path.rising else 1.0 - vanishing * share
        xi_reversed = float(xi[-1])
        found.append(xi)
    return found


def strain_of(law: Law, p: Mapping[str, float], loop: Loop, given: Elastic) -> tuple[Array, Array]:
    """Strain (n,) without its free parts, and those parts' columns (n, 1 or 2).

    The columns are the reference strain and, for the extended law, the material transformed so
    far, to which irrecoverable strain is proportional.
    """
    if law == "contract" or "k" not in p:
        grown = p["eps_L"]
    else:  # H(sigma)
        growth = 1.0 - np.exp(-p["k"] * loop.stress / REFERENCE_STRESS)
        grown = float(p["H_min"] + p["dH"] * growth)
    strains, columns = [], []
    transformed = 0.0
    for path, xi in zip(loop.paths, martensite_fractions(law, p, loop), strict=True):
        strain = -grown * (1.0 - xi)
        modulus = given.austenite + xi * (given.martensite - given.austenite)
        warmer = path.temperature - given.ambient
        if not loop.is_relative:
            strain = strain + loop.stress / modulus
        if law == "contract":
            strain = strain - p["Theta_T"] * 1e6 * warmer / modulus
        else:
            expansion = p["alpha_A"] + xi * (p["alpha_M"] - p["alpha_A"])
            fading = p.get("fading", 0.0) * 1e-3 * (path.temperature - p["T_ref"])
            strain = strain + expansion * 1e-6 * warmer - grown * xi * fading
        strains.append(path.bins.mean(strain))
        progress = transformed + np.abs(xi - xi[0])
        transformed = float(progress[-1])
        columns.append(np.column_stack([np.ones(len(path.level)), path.bins.mean(progress)]))
    count = 1 if law == "contract" else 2
    return np.concatenate(strains), np.concatenate(columns)[:, :count]


def without_free_parts(values: Array, columns: Array) -> tuple[Array, Array]:
    """Values less their best combination of the columns, and that combination's weights."""
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    weights, *_ = np.linalg.lstsq(columns / scale, values, rcond=None)
    return values - (columns / scale) @ weights, weights / scale


def _loop(record: IsobaricRecord, cycle: Cycle) -> Loop:
    paths = tuple(_path(branch) for branch in cycle.branches)
    return Loop(
        label=f"{record.name}, cycle {cycle.number}", stress=record.stress, paths=paths,
        recovered=_recovered(cycle, paths), is_relative=record.strain_unit != "1",
    )


def _recovered(cycle: Cycle, paths: Sequence[Path]) -> float:
    first, last = cycle.branches[0], cycle.branches[-1]
    for branch, companion in ((last, first), (first, last)):
        if branch.direction != "heating" and len(cycle.branches) > 1:
            continue
        try:
            tangents = strain_tangents(branch, companion if companion is not branch else None)
        except InputError:
            continue
        if tangents.step[0] > 0.0:
            return tangents.step[0]
    return float(np.ptp(np.concatenate([path.strain for path in paths])))


def _path(branch: Branch) -> Path:
    """Bins numbered in order of time."""
    t, rising = branch.temperature, branch.direction == "heating"
    bins = Bins.of(t, BINS, rising)
    return Path(rising, t, bins, bins.mean(branch.strain), bins.mean(t))

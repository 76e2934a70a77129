"""Least squares of the constitutive law over all loops at once: bounds, starts, errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.findings import Finding, Severity
from sma_bench.identify.constitutive.law import (
    Elastic,
    Law,
    Loop,
    elastic,
    strain_of,
    without_free_parts,
)
from sma_bench.identify.estimate import Array
from sma_bench.parameters import Parameters
from sma_bench.progress import Report, in_turn, silent

STARTS = 5
_SEED = 7
_AT_BOUND = 1e-3
_SMALLEST_STRESS_RANGE = 5e6
Residuals = Callable[..., Array]
_MODULI = ("wire.austenite_modulus", "wire.martensite_modulus")


@dataclass(frozen=True)
class LawNumber:
    """One fitted number: its name, where the search starts, its bounds and a typical size."""

    name: str
    start: float
    low: float
    high: float
    size: float


@dataclass(frozen=True)
class LoopFit:
    """How one loop is met.

    `model`, `residual` (n,) strain; `irrecoverable` the strain left after the loop.
    """

    loop: Loop
    model: Array
    residual: Array
    irrecoverable: float

    @property
    def rms(self) -> float:
        """Root mean square residual over the recovered strain."""
        return float(np.sqrt(np.mean(self.residual**2))) / self.loop.recovered

    @property
    def largest(self) -> float:
        """Largest residual over the recovered strain."""
        return float(np.max(np.abs(self.residual))) / self.loop.recovered


@dataclass(frozen=True)
class LawFit:
    """The fitted law.

    Attributes:
        names, values, std: of the unknowns, (p,); K, strain, 1e-6/K, MPa/K (Theta_T), and per
            100 MPa (slopes in K, k).
        correlation: (p, p).
        at_bound: names of those that a bound stopped.
        fixed: values that the data cannot give and that were taken from the parameters.
        loops: one a cycle.
        starts_agreeing: how many starts of all ended at the same minimum.
    """

    law: Law
    names: tuple[str, ...]
    values: Array
    std: Array
    covariance: Array
    at_bound: tuple[str, ...]
    fixed: dict[str, float]
    loops: tuple[LoopFit, ...]
    starts_agreeing: int

    @property
    def correlation(self) -> Array:
        """(p, p) correlations of the errors."""
        return self.covariance / np.outer(self.std, self.std)

    def __getitem__(self, name: str) -> float:
        return self.all()[name]

    def all(self) -> dict[str, float]:
        """Fitted and fixed numbers by name."""
        return {**self.fixed, **dict(zip(self.names, self.values.tolist(), strict=True))}

    @property
    def errors(self) -> dict[float, float]:
        """Root mean square residual over the recovered strain, by stress in Pa."""
        return {
            s: float(np.sqrt(np.mean([f.rms**2 for f in self.loops if f.loop.stress == s])))
            for s in sorted({f.loop.stress for f in self.loops})
        }

    def error(self, weights: Mapping[str, float]) -> float:
        """Standard error of a linear combination of the unknowns."""
        w = np.array([weights.get(name, 0.0) for name in self.names])
        return float(np.sqrt(w @ self.covariance @ w))


def fit_law(
    loops: Sequence[Loop], law: Law, unknowns: Sequence[LawNumber], fixed: Mapping[str, float],
    parameters: Parameters, report: Report = silent,
) -> LawFit:
    """Fit one law to all loops, each loop's residual counted in units of the strain it recovers.

    `report` is called at every start.

    Standard errors hold the scatter in every loop with its autocorrelation (a misfit of the law
    is no white noise), and the uncertainty of E_A and E_M, which the data do not give.

    Raises:
        InputError: fewer points than unknowns.
    """
    given = elastic(parameters)
    total = sum(len(loop.strain) for loop in loops)
    if total <= 2 * len(unknowns):
        raise InputError(f"{total} points for {len(unknowns)} unknowns of the {law} law")
    names = tuple(u.name for u in unknowns)
    low, high = np.array([u.low for u in unknowns]), np.array([u.high for u in unknowns])
    size = np.array([u.size for u in unknowns])

    def residuals(x: Array, stiffness: Elastic = given) -> Array:
        p = {**fixed, **dict(zip(names, x, strict=True))}
        left = []
        for loop in loops:
            strain, columns = strain_of(law, p, loop, stiffness)
            left.append(without_free_parts(loop.strain - strain, columns)[0] / loop.recovered)
        return np.concatenate(left)

    from scipy.optimize import least_squares  # half a second to load

    rng = np.random.default_rng(_SEED)
    first = np.array([u.start for u in unknowns])
    starts = [first] + [first + size * rng.standard_normal(len(first)) for _ in range(STARTS - 1)]
    margin = 1e-6 * (high - low)
    numbered = [(k, np.clip(x, low + margin, high - margin)) for k, x in enumerate(starts, 1)]
    solutions = [
        least_squares(residuals, start, bounds=(low, high), x_scale=size, max_nfev=300)
        for _, start in in_turn(numbered, report, lambda s: f"{law} law, start {s[0]} of {STARTS}")
    ]
    best = min(solutions, key=lambda s: s.cost)
    agreeing = sum(bool(s.cost < 1.02 * best.cost + 1e-15) for s in solutions)
    x = best.x
    columns = []
    for i in range(len(x)):
        step = 1e-3 * size[i]
        up, down = x.copy(), x.copy()
        up[i], down[i] = min(x[i] + step, high[i]), max(x[i] - step, low[i])
        columns.append((residuals(up) - residuals(down)) / (up[i] - down[i]))
    jacobian = np.column_stack(columns)
    fits = []
    for loop in loops:
        strain, free = strain_of(law, {**fixed, **dict(zip(names, x, strict=True))}, loop, given)
        left, weights = without_free_parts(loop.strain - strain, free)
        last = float(weights[1] * free[-1, 1]) if free.shape[1] > 1 else 0.0
        fits.append(LoopFit(loop, loop.strain - left, left, last))
    # Sandwich: each loop with its own scatter, all with one autocorrelation.
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    pieces = []
    for fit in fits:
        ends = np.cumsum([len(path.strain) for path in fit.loop.paths])[:-1]
        pieces.extend(np.split(fit.residual / fit.loop.recovered, ends))
    correlated = inflation(autocorrelation(pieces))
    total = sum(len(fit.residual) for fit in fits)
    meat = np.zeros_like(bread)
    begin = 0
    for fit in fits:
        rows = jacobian[begin : begin + len(fit.residual)]
        begin += len(fit.residual)
        variance = correlated * float(np.mean((fit.residual / fit.loop.recovered) ** 2))
        meat += variance * total / (total - len(names) - 2 * len(fits)) * (rows.T @ rows)
    covariance = np.asarray(bread @ meat @ bread)
    # What the uncertainty of E_A and E_M adds to the covariance.
    added = np.zeros_like(bread)
    at_best = residuals(x)
    for name in _MODULI:
        step = 1e-3 * parameters[name]
        shifted = elastic(parameters.replace({name: parameters[name] + step}))
        slope = -bread @ jacobian.T @ ((residuals(x, shifted) - at_best) / step)
        added += np.outer(slope, slope) * parameters.std(name) ** 2
    covariance += added
    near = np.minimum(x - low, high - x) < _AT_BOUND * (high - low)
    return LawFit(
        law=law, names=names, values=x, std=np.sqrt(np.maximum(np.diag(covariance), 1e-300)),
        covariance=covariance,
        at_bound=tuple(name for name, is_near in zip(names, near, strict=True) if is_near),
        fixed=dict(fixed), loops=tuple(fits), starts_agreeing=agreeing,
    )


def has_several_stresses(loops: Sequence[Loop]) -> bool:
    """Whether slopes against stress are identifiable."""
    return float(np.ptp([loop.stress for loop in loops])) >= _SMALLEST_STRESS_RANGE


# --- Remarks on the joint fit of the constitutive law.

_STRONG = 0.9
_IRRECOVERABLE = 0.02


def about_fits(fits: Sequence[LawFit], tolerance: float) -> list[Finding]:
    """The error of each law at each stress, and whether the contract's constant eps_L suffices."""
    findings = []
    for fit in fits:
        errors = fit.errors
        worst = max(errors.values())
        table = ", ".join(f"{e:.1%} at {s / 1e6:.0f} MPa" for s, e in errors.items())
        text = f"{fit.law} law: rms residual over the recovered strain {table}"
        if worst >= tolerance:
            text += f"; above {tolerance:.0%}"
            if fit.law == "contract" and len(errors) > 1:
                text += ": a constant eps_L and constant C_A, C_M do not suffice for this material"
        numbers = {f"{s / 1e6:.0f} MPa": e for s, e in errors.items()}
        severity: Severity = "warning" if worst >= tolerance else "info"
        findings.append(Finding(severity, "fit error", text, numbers))
    return findings


def about_numbers(fit: LawFit) -> list[Finding]:
    """Bounds, starts, correlations and irrecoverable strain of the fit that is given."""
    findings = []
    if fit.at_bound:
        text = f"{', '.join(fit.at_bound)} stopped at a bound of the search: not identified"
        findings.append(Finding("warning", "bounds", text))
    if fit.starts_agreeing < STARTS:
        text = f"{fit.starts_agreeing} of {STARTS} starts ended at the same minimum, the lowest"
        findings.append(Finding("info", "starts", text, {"agreeing": float(fit.starts_agreeing)}))
    slopes = {name: value for name, value in fit.fixed.items() if name != "T_ref"}
    if slopes:
        given = ", ".join(f"{name} = {value:.4g}" for name, value in slopes.items())
        text = f"{given} were taken as given: these tests do not tell them"
        findings.append(Finding("info", "fixed", text, slopes))
    pairs = {
        f"{fit.names[i]}, {fit.names[j]}": float(fit.correlation[i, j])
        for i in range(len(fit.names)) for j in range(i)
    }
    strong = {pair: c for pair, c in pairs.items() if abs(c) > _STRONG}
    text = "no two unknowns correlate by more than 0.9"
    if strong:
        listed = "; ".join(f"{pair} {c:+.2f}" for pair, c in strong.items())
        text = f"the data hardly tell apart {listed}"
    findings.append(Finding("info", "correlation", text, pairs))
    left = {f.loop.label: f.irrecoverable / f.loop.recovered for f in fit.loops}
    large = {label: share for label, share in left.items() if abs(share) > _IRRECOVERABLE}
    if large:
        listed = ", ".join(f"{share:.0%} in {label}" for label, share in large.items())
        text = f"strain left after the loop, over the recovered one: {listed}"
        findings.append(Finding("info", "irrecoverable strain", text, large))
    return findings

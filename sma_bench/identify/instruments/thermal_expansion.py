"""E8: thermal expansion factor from a clamped temperature staircase below A_s (eq. 8, Fig. 10).

sigma - sigma_0 = Theta_T (T - T_0). A wire that expands between clamps loses tension, so Theta_T
is negative and its size is alpha E; the wire must be tight enough to stay so.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, fit_linear
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import CAMERA, means
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import CONVECTION_FACTOR, NITI_EXPANSION
from sma_bench.parameters.table import BY_NAME
from sma_bench.records.record import Record, samples

NAME = "E8"
TITLE = "Thermal expansion factor (eq. 8, Fig. 10)"
_START = "wire.austenite_start_temperature"
PARAMETER = "wire.thermal_expansion_factor"
SHORTEST_PLATEAU = 5.0  # s
STEADY = 0.3  # K over a window
WINDOW = 2.0  # s
FEWEST_LEVELS = 3
_SAME_LEVEL = 1.0  # K
_TAIL = 0.6
_SLACK = 5.0
_BAD_MISFIT = 9.0  # chi square per degree of freedom


@dataclass(frozen=True)
class _Plateaus:
    """Points (p,): temperature K and stress Pa with their errors; samples behind them."""

    temperature: Array
    temperature_std: Array
    stress: Array
    stress_std: Array
    n: int


def identify_thermal_expansion(
    records: Record | Sequence[Record], parameters: Parameters | None = None, *,
    temperature: str = "wire.temperature", force: str = "force",
) -> Experiment:
    """Evaluate clamped staircases of temperature.

    Args:
        records: with a wire temperature (K) and the tensile force (N).
        parameters: diameter (area), A_s and C_A (above which the wire transforms), moduli (check).
        temperature, force: names of the signals.

    Returns:
        Estimate of Theta_T; `curves` `temperature`, `stress`, `used` (1 or 0), `line`.

    Raises:
        InputError: a signal is absent, or fewer than three temperatures remain below A_s.
    """
    parameters = parameters or Parameters.defaults()
    records = [records] if isinstance(records, Record) else list(records)
    if not records:
        raise InputError("thermal expansion: no records")
    findings: list[Finding] = []
    all_points, used, groups = [], [], []
    for index, record in enumerate(records):
        time, kelvin = samples(record, temperature)
        force_time, newton = samples(record, force)
        windows = steady_windows(time, kelvin)
        inside = (windows[:, 0] >= force_time[0]) & (windows[:, 1] <= force_time[-1])
        windows = windows[inside]
        if not len(windows):
            raise InputError(
                f"{record.path}: {temperature} never holds still for {SHORTEST_PLATEAU:g} s, "
                "expected a staircase"
            )
        area = 0.25 * math.pi * parameters["wire.diameter"] ** 2
        warm = means(time, kelvin, windows, temperature)
        f = means(force_time, newton, windows, force)
        points = _Plateaus(
            warm.value, np.hypot(warm.noise, warm.hidden), f.value / area,
            np.hypot(f.noise, f.hidden) / area, int(np.sum(f.n)),
        )
        all_points.append(points)
        used.append(_usable(record, points, parameters, findings))
        groups.append(np.full(len(points.temperature), index))
    chosen = np.concatenate(used)
    t, t_std, stress, stress_std = (
        np.concatenate([getattr(p, name) for p in all_points])
        for name in ("temperature", "temperature_std", "stress", "stress_std")
    )
    group = np.concatenate(groups)
    levels = 1 + int(np.sum(np.diff(np.sort(t[chosen])) > _SAME_LEVEL)) if chosen.any() else 0
    if levels < FEWEST_LEVELS:
        raise InputError(
            f"{records[0].path}: {levels} temperatures held steady below A_s with the wire tight, "
            f"expected {FEWEST_LEVELS} or more"
        )

    # One slope, and a zero a record.
    kinds, centre = np.unique(group[chosen]), float(t[chosen].mean())
    design = np.column_stack([*((group == k).astype(np.float64) for k in kinds), t - centre])
    slope = 0.0
    for _ in range(3):
        variance = stress_std[chosen] ** 2 + (slope * t_std[chosen]) ** 2
        floor = (1e-6 * float(np.ptp(stress[chosen])) + 1.0) ** 2
        fit = fit_linear(design[chosen], stress[chosen], np.diag(variance + floor))
        slope = float(fit.beta[-1])
    std = float(fit.std[-1])

    # The area behind stress and the camera's scale have errors common to all points.
    shares = {
        "wire.diameter": -2.0 * slope * parameters.std("wire.diameter")
        / parameters["wire.diameter"],
        **{name: -slope * parameters.std(name) / parameters[name] for name in CAMERA},
    }
    findings.extend(check_size(slope, math.hypot(std, *shares.values()), parameters))
    if fit.misfit >= _BAD_MISFIT:
        text = (
            f"the plateaus scatter {math.sqrt(fit.misfit):.1f} times more about the line than "
            "their noise: creeping clamps, drifting force, or R-phase; the error is enlarged "
            "accordingly"
        )
        findings.append(Finding("warning", "Theta_T", text, {"misfit": fit.misfit}))
    estimate = Estimate(
        slope, std, "Pa/K",
        f"line through {int(chosen.sum())} plateaus at {levels} temperatures below A_s",
        sum(p.n for p in all_points),
    ).with_shares(shares)
    curves = {
        "temperature": t, "stress": stress, "used": chosen.astype(np.float64),
        "line": design @ fit.beta,
    }
    source = "; ".join(str(record.path) for record in records)
    return Experiment(NAME, TITLE, {PARAMETER: estimate}, tuple(findings), curves, source)


def check_size(value: float, std: float, parameters: Parameters) -> list[Finding]:
    """Sign and size of Theta_T (Pa/K) against -alpha E of a clamped wire below A_s."""
    soft = NITI_EXPANSION[0] * parameters["wire.martensite_modulus"]
    stiff = NITI_EXPANSION[1] * parameters["wire.austenite_modulus"]
    numbers = {"value": value, "alpha_E_low": soft, "alpha_E_high": stiff}
    expected = f"-{soft / 1e6:.2f} to -{stiff / 1e6:.2f} MPa/K of -alpha E"
    text = f"Theta_T = {value / 1e6:.3g} +- {std / 1e6:.2g} MPa/K against {expected}"
    faults = []
    if value > 2.0 * std:
        faults.append(
            "of the other sign: a clamped wire that expands loses tension; the clamps move, the "
            "sign of force is turned round, or the wire transforms"
        )
    if CONVECTION_FACTOR * soft < abs(value) - 2.0 * std <= CONVECTION_FACTOR * stiff:
        faults.append(
            f"{abs(value) / soft:.1f} times that of martensite, which a wire below A_s is: a "
            "camera spot that the wire fills in part, or clamps that give way as they warm"
        )
    if abs(value) - 2.0 * std > CONVECTION_FACTOR * stiff:
        faults.append(
            f"{abs(value) / stiff:.0f} times the largest: transformation stress, or the unit is "
            "not Pa/K"
        )
    if abs(value) + 2.0 * std < soft / CONVECTION_FACTOR:
        faults.append("too small: slack, or soft clamps and load cell")
    if faults:
        return [Finding("warning", "Theta_T", f"{text}: {'; '.join(faults)}", numbers)]
    return [Finding("info", "Theta_T", f"{text}: plausible", numbers)]


def steady_windows(time: Array, temperature: Array) -> Array:
    """(p, 2) s: the later parts of the stretches in which temperature holds still.

    Args:
        time: (n,) s, increasing; temperature: (n,) K.
    """
    if len(time) < 2:
        return np.empty((0, 2))
    period = float(np.median(np.diff(time)))
    half = max(int(round(0.5 * WINDOW / period)), 2)
    if len(time) < 4 * half:
        return np.empty((0, 2))
    smooth = np.convolve(temperature, np.ones(half) / half, mode="valid")
    change = np.abs(smooth[half:] - smooth[:-half])
    centre = time[half : half + len(change)]
    # Noise of two means of `half` samples sets the limit where it is larger.
    noise = 1.4826 * float(np.median(np.abs(np.diff(temperature, 2)))) / math.sqrt(6.0)
    steady = change < max(STEADY, 5.0 * noise * math.sqrt(2.0 / half))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(int)))
    spans = [(centre[a], centre[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    long = [(a, b) for a, b in spans if b - a >= SHORTEST_PLATEAU]
    return np.array([(b - _TAIL * (b - a), b) for a, b in long]).reshape(-1, 2)


def _usable(
    record: Record, points: _Plateaus, parameters: Parameters, findings: list[Finding]
) -> Array:
    """Which plateaus lie below A_s (with the stress's shift) with the wire tight."""
    start = parameters[_START]
    # A transforming wire pulls itself up: only the stress before A_s may shift the limit.
    cold = points.stress[points.temperature < start]
    shift = max(float(cold.min()), 0.0) if len(cold) else 0.0
    limit = start + shift / parameters["wire.stress_influence_austenite"]
    if _START in parameters.given:
        limit -= 2.0 * parameters.std(_START)
    else:
        limit -= 2.0 * (BY_NAME[_START].uncertainty or 0.0)
        text = (
            f"{start:.1f} K is nobody's statement of this wire: where it transforms below "
            f"{limit:.1f} K, Theta_T is that of its transformation"
        )
        findings.append(Finding("warning", "A_s", text))
    below = points.temperature < limit
    if not below.all():
        hot = points.temperature[~below]
        text = (
            f"{record.path}: {len(hot)} plateaus at {hot.min():.1f} to {hot.max():.1f} K lie above "
            f"A_s (two standard errors below it, with stress: {limit:.1f} K) and are left "
            "out: the wire transforms there"
        )
        findings.append(Finding("warning", "Theta_T", text, {"count": float(len(hot))}))
    scale = max(float(np.max(np.abs(points.stress))) * 0.02, _SLACK * points.stress_std.max())
    tight = points.stress > scale
    # Once slack, the wire tells nothing; all plateaus below zero force mean another zero or sign.
    if tight.any() and not tight[below].all():
        text = (
            f"{record.path}: {int(np.sum(~tight & below))} plateaus with no tension left are left "
            "out: the wire was slack, clamp it under more load"
        )
        findings.append(Finding("warning", "slack", text))
        below = below & tight
    return np.asarray(below)

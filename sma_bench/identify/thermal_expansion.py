"""E8: thermal expansion factor from a clamped temperature staircase below A_s (eq. 8, Fig. 10).

sigma - sigma_0 = Theta_T (T - T_0). A wire that expands between clamps loses tension, so Theta_T
is negative and its size is alpha E; the wire must be tight enough to stay so.
"""

import math
from collections.abc import Sequence

import numpy as np

from sma_bench.arrays import Array
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import SYMBOLS, fit_slope, scatter
from sma_bench.identify.result import Experiment, refusal, remark, words
from sma_bench.identify.signals import CAMERA, means
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import CONVECTION_FACTOR, NITI_EXPANSION
from sma_bench.physics.bending import channel_section
from sma_bench.records.record import Record, samples

PARAMETER = SYMBOLS["Theta_T"]
_START, _DIAMETER = SYMBOLS["A_s"], "wire.diameter"
_SHORTEST_PLATEAU, _FEWEST_LEVELS = 5.0, 3  # s
_STEADY, _WINDOW = 0.3, 2.0  # K over a window of s
_SAME_LEVEL = 1.0  # K
_TAIL = 0.6  # of a plateau, that counts
_SLACK = 5.0  # errors of the stress
_BAD_MISFIT = 9.0  # chi square per degree of freedom


def identify_thermal_expansion(records: Sequence[Record], parameters: Parameters) -> Experiment:
    """Evaluate clamped staircases of temperature. `records`: each of one wire, with its temperature
    [K] and `force` [N]; `parameters`: diameter and count (area), A_s and C_A (above which the wire
    transforms), moduli (check). Raises InputError: a signal is absent, or fewer than three
    temperatures remain below A_s."""
    # A point (K, Pa, with errors) a plateau of each record, and which of them count.
    findings: list[Finding] = []
    points, used, total = [], [], 0
    area, a_s = channel_section(parameters), parameters[_START]
    for index, record in enumerate(records):
        temperature = f"{record.channels[0]}.temperature"
        time, kelvin = samples(record, temperature)
        force_time, newton = samples(record, "force")
        windows = steady_windows(time, kelvin)
        windows = windows[(windows[:, 0] >= force_time[0]) & (windows[:, 1] <= force_time[-1])]
        if not len(windows):
            raise refusal(
                "never still", path=record.path, name=temperature, shortest=_SHORTEST_PLATEAU
            )
        warm = means(time, kelvin, windows, temperature)
        f = means(force_time, newton, windows, "force")
        here, error = f.value / area, np.hypot(f.noise, f.hidden) / area
        total += f.n
        points.append(np.column_stack([
            warm.value, np.hypot(warm.noise, warm.hidden), here, error, 0.0 * here + index,
        ]))

        # Below A_s, with the stress's shift: a transforming wire pulls itself up, so only the
        # stress before A_s may shift the limit.
        cold = here[warm.value < a_s]
        shift = max(float(cold.min()), 0.0) if len(cold) else 0.0
        stated = _START in parameters.given
        doubt = parameters.std(_START) if stated else BY_NAME[_START].uncertainty or 0.0
        limit = a_s + shift / parameters[SYMBOLS["C_A"]] - 2.0 * doubt
        if not stated:
            findings.append(remark("nobody stated A_s", start=a_s, limit=limit))
        below = warm.value < limit
        if not below.all():
            hot = warm.value[~below]
            findings.append(remark(
                "plateaus too hot", path=record.path, count=len(hot), low=hot.min(),
                high=hot.max(), limit=limit,
            ))
        # Once slack, the wire tells nothing; all plateaus below 0 N mean another zero or sign.
        tight = here > max(float(np.max(np.abs(here))) * 0.02, _SLACK * error.max())
        if tight.any() and not tight[below].all():
            count = int(np.sum(~tight & below))
            findings.append(remark("slack wire", path=record.path, count=count))
            below = below & tight
        used.append(below)
    (t, t_std, stress, stress_std, group), chosen = np.vstack(points).T, np.concatenate(used)
    levels = 1 + int(np.sum(np.diff(np.sort(t[chosen])) > _SAME_LEVEL)) if chosen.any() else 0
    if levels < _FEWEST_LEVELS:
        raise refusal("few levels", path=records[0].path, levels=levels, least=_FEWEST_LEVELS)

    # One slope, and a zero a record.
    kinds, centre = np.unique(group[chosen]), float(t[chosen].mean())
    design = np.column_stack([*((group == k).astype(np.float64) for k in kinds), t - centre])
    floor = (1e-6 * float(np.ptp(stress[chosen])) + 1.0) ** 2

    def covariance(slope: float) -> Array:
        return np.diag(stress_std[chosen] ** 2 + (slope * t_std[chosen]) ** 2 + floor)

    fit = fit_slope(design[chosen].T, stress[chosen], covariance, slope=-1)
    slope = float(fit.beta[-1])

    # The area behind stress and the camera's scale have errors common to all points.
    shares = {name: -slope * parameters.std(name) / parameters[name] for name in CAMERA}
    shares[_DIAMETER] = -2.0 * slope * parameters.std(_DIAMETER) / parameters[_DIAMETER]
    method = f"line through {int(chosen.sum())} plateaus at {levels} temperatures below A_s"
    estimate = Estimate(slope, float(fit.std[-1]), "Pa/K", method, total).with_shares(shares)

    # Sign and size against -alpha E of a clamped wire below A_s.
    soft = NITI_EXPANSION[0] * parameters["wire.martensite_modulus"]
    stiff = NITI_EXPANSION[1] * parameters["wire.austenite_modulus"]
    std, least = estimate.std, abs(slope) - 2.0 * estimate.std
    causes = {
        "expansion of the other sign": slope > 2.0 * std,
        "expansion of a camera": CONVECTION_FACTOR * soft < least <= CONVECTION_FACTOR * stiff,
        "expansion too large": least > CONVECTION_FACTOR * stiff,
        "expansion too small": abs(slope) + 2.0 * std < soft / CONVECTION_FACTOR,
    }
    facts = {"of_soft": abs(slope) / soft, "of_stiff": abs(slope) / stiff}
    faults = [words(cause, **facts) for cause, found in causes.items() if found]
    findings.append(remark(
        "size of the expansion", "warning" if faults else "info", value=slope, std=std,
        alpha_E_low=soft, alpha_E_high=stiff, verdict="; ".join(faults) or "plausible",
    ))
    if fit.misfit >= _BAD_MISFIT:
        findings.append(
            remark("plateaus off the line", misfit=fit.misfit, times=math.sqrt(fit.misfit))
        )
    curves = {
        "temperature": t, "stress": stress, "used": chosen.astype(np.float64),
        "line": design @ fit.beta,
    }
    return Experiment(
        "E8", "Thermal expansion factor (eq. 8, Fig. 10)", {PARAMETER: estimate}, tuple(findings),
        curves, "; ".join(str(record.path) for record in records),
    )


def steady_windows(time: Array, temperature: Array) -> Array:
    """(p, 2) s: the later parts of the stretches in which temperature holds still. `time`: (n,) s,
    increasing; `temperature`: (n,) K."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else _WINDOW
    half = max(round(0.5 * _WINDOW / period), 2)
    if len(time) < 4 * half:
        return np.empty((0, 2))
    smooth = np.convolve(temperature, np.ones(half) / half, mode="valid")
    change = np.abs(smooth[half:] - smooth[:-half])
    centre = time[half : half + len(change)]
    # Noise of two means of `half` samples sets the limit where it is larger.
    steady = change < max(_STEADY, 5.0 * scatter(temperature) * math.sqrt(2.0 / half))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], steady, [False]]).astype(int)))
    first, last = centre[edges[::2]], centre[edges[1::2] - 1]
    long = last - first >= _SHORTEST_PLATEAU
    return np.column_stack([last - _TAIL * (last - first), last])[long]

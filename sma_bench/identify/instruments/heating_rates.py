"""E5 over cycles and heating rates: Table II, prestrain, and onsets extrapolated to zero rate.

Heat takes time to reach the sample, so onsets move with the rate, in proportion to it; the straight
line through several rates gives the onset at rate zero (Hoehne et al., Thermochimica Acta 160,
1990, calibrate the same way). The first heating of a prestrained sample starts
later, because its detwinned martensite is stabilised; the second does not: that difference is the
prestrain, not an error of measurement.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments.transition_temperatures import identify_transition_temperatures
from sma_bench.identify.straight_line import fit_linear
from sma_bench.records.dsc import DscRecord

NAME = "E5"
TITLE = "Transition temperatures over cycles and heating rates (Table II)"
ENDS = {
    "A_s": ("heating", "start", "wire.austenite_start_temperature"),
    "A_f": ("heating", "finish", "wire.austenite_finish_temperature"),
    "M_s": ("cooling", "start", "wire.martensite_start_temperature"),
    "M_f": ("cooling", "finish", "wire.martensite_finish_temperature"),
}
_SAME_RATE = 0.05
_SIGNIFICANT = 3.0
_SMALLEST_SHIFT = 2.0  # K
_STAYS = 0.25


@dataclass(frozen=True)
class Scan:
    """One scan: record by position, segment number, cycle from 1, rate in K/s (positive).

    `values` holds (value, std) in K for those of A_s, A_f, M_s, M_f that it shows.
    """

    record: int
    segment: int
    cycle: int
    rate: float
    values: dict[str, tuple[float, float]]


def identify_heating_rates(records: Sequence[DscRecord] | DscRecord) -> Experiment:
    """Transition temperatures from one DSC run or several of the same material.

    Estimates come from the cycles after the first (the first one only where there is no other),
    extrapolated to zero rate where they were run at two rates or more, else from the slowest.

    Returns:
        `details` "cycle 1, 5 K/min: A_s" and so on (Table II), "A_s at zero rate", "A_s lag" in s;
        `curves` "table" (n, 6): cycle, rate in K/min, A_s, A_f, M_s, M_f in K (NaN: not seen),
        besides those of every scan under "<file>/segment_N/...".

    Raises:
        InputError: no record, or none with a whole peak.
    """
    runs = [records] if isinstance(records, DscRecord) else list(records)
    if not runs:
        raise InputError("DSC: no records")
    experiments = [identify_transition_temperatures(run) for run in runs]
    scans = [s for i, run in enumerate(runs) for s in _scans(i, run, experiments[i])]
    findings = [f for e in experiments for f in e.findings]
    findings.extend(_prestrain(scans, runs))
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    for name, (kind, _, parameter) in ENDS.items():
        seen = [s for s in scans if name in s.values]
        if not seen:
            continue
        estimate, lag, remarks = _at_zero_rate(name, kind, seen)
        estimates[parameter] = estimate
        findings.extend(remarks)
        if lag is not None:
            details[f"{name} at zero rate"], details[f"{name} lag"] = estimate, lag
    details.update(_table_details(scans))
    curves: dict[str, Array] = {"table": _table(scans)}
    for run, experiment in zip(runs, experiments, strict=True):
        curves.update({f"{run.path.name}/{key}": v for key, v in experiment.curves.items()})
        details.update({f"{run.path.name}/{key}": v for key, v in experiment.details.items()})
    return Experiment(
        name=NAME, title=TITLE, estimates=estimates,
        findings=tuple(findings), curves=curves,
        source="; ".join(e.source for e in experiments), details=details,
    )


def _scans(index: int, record: DscRecord, experiment: Experiment) -> list[Scan]:
    cycles = {"heating": 0, "cooling": 0}
    found = []
    for segment in record.segments:
        if segment.kind == "isothermal":
            continue
        cycles[segment.kind] += 1
        values = {
            name: (e.value, e.std)
            for name, (kind, end, _) in ENDS.items()
            if kind == segment.kind
            and (e := experiment.details.get(f"segment_{segment.number}/{end}")) is not None
        }
        if values:
            found.append(
                Scan(index, segment.number, cycles[segment.kind], abs(segment.rate), values)
            )
    return found


def _at_zero_rate(
    name: str, kind: str, seen: Sequence[Scan]
) -> tuple[Estimate, Estimate | None, list[Finding]]:
    """The estimate, the lag (K per K/s, so s) where several rates were run, and remarks."""
    later = [s for s in seen if s.cycle > 1]
    used = later or list(seen)
    remarks: list[Finding] = []
    if _rates(used) < 2 and _rates(seen) > 1:
        # Better all cycles than one rate, as long as it is said.
        used = list(seen)
        text = (
            "rates and cycles changed together; the line to zero rate takes the first "
            "cycle for a later one, which only holds without prestrain"
        )
        remarks.append(Finding("warning", name, text))
    rate = np.array([s.rate for s in used])
    value = np.array([s.values[name][0] for s in used])
    std = np.array([s.values[name][1] for s in used])
    if _rates(used) < 2:
        slowest = float(np.mean(value))
        spread = float(np.std(value, ddof=1)) if len(value) > 1 else 0.0
        own = float(np.sqrt(np.mean(std**2)))
        cycle = "cycle " + ", ".join(str(s.cycle) for s in used)
        text = f"tangents, {rate[0] * 60.0:g} K/min, {cycle}"
        return Estimate(slowest, max(own, spread), "K", text, len(used)), None, remarks
    fit = fit_linear(np.column_stack([np.ones(len(rate)), rate]), value, np.diag(std**2))
    rates = ", ".join(f"{r:g}" for r in sorted({round(r * 60.0, 3) for r in rate.tolist()}))
    method = f"tangents at {rates} K/min, extrapolated to zero rate"
    estimate = Estimate(float(fit.beta[0]), float(fit.std[0]), "K", method, len(used))
    lag = Estimate(
        float(fit.beta[1]), float(fit.std[1]), "s", "change of onset with rate", len(used)
    )
    wrong = -lag.value if kind == "heating" else lag.value
    if wrong > _SIGNIFICANT * lag.std:
        text = (
            f"it moves by {lag.value:+.3g} K per K/s of rate, against the way that thermal lag "
            f"moves it on {kind}: cycles differ, or the sample changed"
        )
        remarks.append(Finding("warning", name, text, {"lag": lag.value, "std": lag.std}))
    return estimate, lag, remarks


def _rates(scans: Sequence[Scan]) -> int:
    ordered = np.sort([s.rate for s in scans])
    return 1 + int(np.sum(np.diff(ordered) > _SAME_RATE * ordered[1:])) if len(ordered) else 0


def _prestrain(scans: Sequence[Scan], runs: Sequence[DscRecord]) -> list[Finding]:
    """The shift from the first to the second cycle of each record, at one rate."""
    findings = []
    for index, run in enumerate(runs):
        shifts: dict[str, tuple[float, float]] = {}
        for name in ENDS:
            mine = [s for s in scans if s.record == index and name in s.values]
            first = next((s for s in mine if s.cycle == 1), None)
            second = next((s for s in mine if s.cycle == 2), None)
            if first and second and abs(first.rate - second.rate) <= _SAME_RATE * first.rate:
                (a, a_std), (b, b_std) = first.values[name], second.values[name]
                shifts[name] = (b - a, math.hypot(a_std, b_std))
        if not shifts:
            continue
        listed = ", ".join(f"{n} {d:+.2f} +- {s:.2f} K" for n, (d, s) in shifts.items())
        moved = {
            n for n, (d, s) in shifts.items() if abs(d) > max(_SIGNIFICANT * s, _SMALLEST_SHIFT)
        }
        text = f"{run.path}: from cycle 1 to 2 {listed}"
        falls = [n for n in ("A_s", "A_f") if n in moved and shifts[n][0] < 0.0]
        largest = max(abs(d) for d, _ in shifts.values())
        cooling = max((abs(shifts[n][0]) for n in ("M_s", "M_f") if n in shifts), default=0.0)
        if falls and cooling < _STAYS * largest:
            text += (
                f": {' and '.join(falls)} fall and the cooling stays nearly, the mark of prestrain "
                "that the first heating recovers; cycle 2 is the material's own"
            )
        elif moved:
            text += f": {', '.join(sorted(moved))} moved, and not as prestrain alone moves them"
        else:
            text += ": no shift beyond the errors"
        numbers = {n: d for n, (d, _) in shifts.items()}
        findings.append(Finding("info", "prestrain", text, numbers))
    return findings


def _table(scans: Sequence[Scan]) -> Array:
    """One row a record, cycle and rate."""
    rows: dict[tuple[int, int, float], list[float]] = {}
    for s in scans:
        row = rows.setdefault(
            (s.record, s.cycle, round(s.rate * 60.0, 3)), [math.nan] * len(ENDS)
        )
        for k, name in enumerate(ENDS):
            if name in s.values:
                row[k] = s.values[name][0]
    return np.array([[cycle, rate, *row] for (_, cycle, rate), row in sorted(rows.items())])


def _table_details(scans: Sequence[Scan]) -> dict[str, Estimate]:
    details = {}
    several = len({s.record for s in scans}) > 1
    for s in scans:
        run = f"run {s.record + 1}, " if several else ""
        for name, (value, std) in s.values.items():
            key = f"{run}cycle {s.cycle}, {s.rate * 60.0:g} K/min: {name}"
            details[key] = Estimate(value, std, "K", f"tangent, segment {s.segment}", 1)
    return details

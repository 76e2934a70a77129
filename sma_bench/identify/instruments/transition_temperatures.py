"""E5, transition temperatures by calorimetry: tangents on every scan (Fig. 7, Table II)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, fit_linear, mean_of_repeats
from sma_bench.identify.instruments.tangents import (
    Onset,
    Scan,
    Transformation,
    find_transformation,
    make_scan,
)
from sma_bench.identify.result import Experiment
from sma_bench.records import DscRecord, DscSegment

# A calorimeter is calibrated with indium to some tenths of a kelvin, which melts within seconds; a
# wire in its pan follows by so many seconds more or less.
_CALORIMETER_STD, _LAG_STD = 0.5, 5.0  # K, s
_METHOD = "baseline against the steepest tangent of the outermost flank"
_NAMES = {
    "heating": ("wire.austenite_start_temperature", "wire.austenite_finish_temperature"),
    "cooling": ("wire.martensite_start_temperature", "wire.martensite_finish_temperature"),
}
_SYMBOLS = {"heating": ("A_s", "A_f"), "cooling": ("M_s", "M_f")}


@dataclass(frozen=True)
class ScanResult:
    """One scan of a run: `cycle` counts from 1 among the scans of its kind."""

    segment: DscSegment
    cycle: int
    scan: Scan
    found: Transformation

    @property
    def label(self) -> str:
        """Key of this scan in `details` and `curves`."""
        return f"segment_{self.segment.number}"

    @property
    def rate_per_minute(self) -> float:
        """Programmed rate in K/min, positive."""
        return abs(self.segment.rate) * 60.0


def identify_transition_temperatures(record: DscRecord) -> Experiment:
    """A_s, A_f, M_s and M_f from a DSC run, stress free.

    The estimates are those of the slowest scan (the last one of these), as thermal lag grows with
    the rate; the standard error takes in how far the tangents depend on smoothing and baseline,
    and the largest difference to the other scans. `details` holds every scan by itself under
    "segment_N/...": start, finish, peak in K and latent_heat in J/kg; `curves` its heat flow in
    W/kg (transformation upward) over temperature in K with baselines and tangents.

    Raises:
        InputError: no scan with a whole peak.
    """
    results, problems = _scan_results(record)
    if not results:
        raise InputError(
            f"{record.path}: no heating or cooling scan with a whole peak"
            + (f" ({problems[0].text})" if problems else "")
        )
    estimates: dict[str, Estimate] = {}
    findings = [*record.findings, *problems]
    for kind, names in _NAMES.items():
        of_kind = [r for r in results if r.segment.kind == kind]
        if not of_kind:
            findings.append(
                Finding("warning", "DSC", f"no {kind} scan, so no {' and '.join(names)}")
            )
            continue
        chosen = min(of_kind, key=lambda r: (r.rate_per_minute, -r.cycle))
        for end, name in enumerate(names):
            estimates[name] = _estimate(chosen, of_kind, end)
        findings.extend(_spread_findings(of_kind, kind))
    findings.extend(_shape_findings(results))
    findings.extend(_order_findings(estimates))
    details: dict[str, Estimate] = {}
    curves: dict[str, Array] = {}
    for result in results:
        details |= _details(result)
        curves |= _curves(result)
    return Experiment(
        "E5", "Transition temperatures", estimates, tuple(findings), curves,
        f"{record.path}: {record.sample or 'sample'}, {record.mass * 1e6:.1f} mg", details,
    )


def _scan_results(record: DscRecord) -> tuple[list[ScanResult], list[Finding]]:
    results: list[ScanResult] = []
    problems: list[Finding] = []
    cycles = {"heating": 0, "cooling": 0}
    upward = record.endothermic_up
    if upward is None and any(s.kind != "isothermal" for s in record.segments):
        text = "the file does not say which way endothermic is; taken as up"
        problems.append(Finding("warning", "DSC", text))
    for segment in record.segments:
        if segment.kind == "isothermal":
            continue
        cycles[segment.kind] += 1
        # Heating takes the latent heat up, cooling gives it back: the peak shall point upward.
        sign = 1.0 if (segment.kind == "heating") == (upward is not False) else -1.0
        try:
            scan = make_scan(
                segment.time, segment.temperature, sign * record.specific_heat_flow(segment)
            )
            found = find_transformation(scan)
        except InputError as error:
            text = f"segment {segment.number} ({segment.kind}) is left out: {error}"
            problems.append(Finding("warning", "DSC", text))
            continue
        results.append(ScanResult(segment, cycles[segment.kind], scan, found))
    return results, problems


def _onsets(result: ScanResult) -> tuple[Onset, Onset]:
    return result.found.start, result.found.finish


def _estimate(chosen: ScanResult, of_kind: Sequence[ScanResult], end: int) -> Estimate:
    onset = _onsets(chosen)[end]
    apart = max(abs(_onsets(r)[end].temperature - onset.temperature) for r in of_kind)
    method = f"{_METHOD}, {chosen.rate_per_minute:g} K/min, cycle {chosen.cycle}"
    return Estimate(
        onset.temperature, math.hypot(onset.std, apart), "K", method, len(of_kind)
    ).with_shares(_instrument(chosen.rate_per_minute / 60.0))


def _instrument(rate: float) -> dict[str, float]:
    """K, what no scan at this rate (K/s) shows; at rate zero nothing lags."""
    return {"calorimeter": _CALORIMETER_STD, "lag of the sample": _LAG_STD * rate}


def _details(result: ScanResult) -> dict[str, Estimate]:
    n = len(result.scan.temperature)
    where = f"{result.segment.kind}, {result.rate_per_minute:g} K/min, cycle {result.cycle}"
    start, finish = _onsets(result)
    heat, heat_std = result.found.latent_heat, result.found.latent_heat_std
    numbers = {
        "start": Estimate(start.temperature, start.std, "K", f"tangent, {where}", n),
        "finish": Estimate(finish.temperature, finish.std, "K", f"tangent, {where}", n),
        "latent_heat": Estimate(heat, heat_std, "J/kg", f"area over a baseline, {where}", n),
    }
    for k, peak in enumerate(result.found.peaks):
        name = "peak" if k == 0 else f"peak_{k + 1}"
        numbers[name] = Estimate(peak, 0.1, "K", f"maximum over the baseline, {where}", n)
    return {f"{result.label}/{name}": number for name, number in numbers.items()}


def _curves(result: ScanResult) -> dict[str, Array]:
    """Everything a figure of the scan needs, lines cut to where they touch it."""
    scan, found = result.scan, result.found
    top = float(np.max(scan.flow))
    curves = {"temperature": scan.temperature, "heat_flow": scan.flow, "base": found.base}
    forward = 1.0 if scan.temperature[-1] > scan.temperature[0] else -1.0
    for name, onset, far in (
        ("start", found.start, scan.temperature[0]),
        ("finish", found.finish, scan.temperature[-1]),
    ):
        inward = forward if name == "start" else -forward
        baseline_ends = np.array([far, onset.temperature + 5.0 * inward])
        level = float(onset.baseline(np.array(onset.temperature)))
        tangent_ends = onset.temperature + np.array([0.0, (top - level) / onset.tangent.slope])
        curves |= {
            f"{name}/baseline_temperature": baseline_ends,
            f"{name}/baseline": onset.baseline(baseline_ends),
            f"{name}/tangent_temperature": tangent_ends,
            f"{name}/tangent": onset.tangent(tangent_ends),
        }
    return {f"{result.label}/{name}": curve for name, curve in curves.items()}


def _spread_findings(of_kind: Sequence[ScanResult], kind: str) -> list[Finding]:
    if len(of_kind) < 2:
        return []
    parts = []
    for symbol, end in zip(_SYMBOLS[kind], (0, 1), strict=True):
        shown = ", ".join(f"{_onsets(r)[end].temperature:.2f}" for r in of_kind)
        parts.append(f"{symbol} {shown} K")
    runs = ", ".join(f"{r.rate_per_minute:g} K/min (cycle {r.cycle})" for r in of_kind)
    text = f"{'; '.join(parts)} at {runs}"
    if len({r.rate_per_minute for r in of_kind}) == len(of_kind):
        text += "; rate and cycle changed together, so their effects cannot be told apart"
    return [Finding("info", f"DSC {kind}", text)]


def _shape_findings(results: Sequence[ScanResult]) -> list[Finding]:
    findings = []
    for r in results:
        inside = sorted(r.found.peaks)
        if len(inside) < 2:
            continue
        shown = ", ".join(f"{peak:.1f}" for peak in inside)
        text = (
            f"segment {r.segment.number} ({r.segment.kind}) has peaks at {shown} K: the "
            "transformation goes in steps, start and finish enclose all of them"
        )
        findings.append(Finding("info", "DSC", text, {"peaks": float(len(inside))}))
    return findings


def _order_findings(estimates: dict[str, Estimate]) -> list[Finding]:
    start, finish = (estimates.get(name) for name in (_NAMES["heating"][0], _NAMES["cooling"][0]))
    if start is None or finish is None or finish.value <= start.value:
        return []
    text = (
        f"M_s = {finish.value:.1f} K lies above A_s = {start.value:.1f} K: the two transformation "
        "ranges overlap"
    )
    return [Finding("warning", "DSC", text, {"overlap": finish.value - start.value})]


# --- E5 over cycles and heating rates: Table II, prestrain, and onsets extrapolated to zero rate.
#
# Heat takes time to reach the sample, so onsets move with the rate, in proportion to it; the
# straight line through several rates gives the onset at rate zero (Hoehne et al., Thermochimica
# Acta 160, 1990, calibrate the same way). The first heating of a prestrained sample starts later,
# because its detwinned martensite is stabilised; the second does not: that difference is the
# prestrain, not an error of measurement.

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
class RatedScan:
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


def _scans(index: int, record: DscRecord, experiment: Experiment) -> list[RatedScan]:
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
                RatedScan(index, segment.number, cycles[segment.kind], abs(segment.rate), values)
            )
    return found


def _at_zero_rate(
    name: str, kind: str, seen: Sequence[RatedScan]
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
        slowest, *errors = mean_of_repeats([s.values[name] for s in used])
        cycle = "cycle " + ", ".join(str(s.cycle) for s in used)
        text = f"tangents, {rate[0] * 60.0:g} K/min, {cycle}"
        estimate = Estimate(slowest, math.hypot(*errors), "K", text, len(used))
        return estimate.with_shares(_instrument(float(rate[0]))), None, remarks
    fit = fit_linear(np.column_stack([np.ones(len(rate)), rate]), value, np.diag(std**2))
    rates = ", ".join(f"{r:g}" for r in sorted({round(r * 60.0, 3) for r in rate.tolist()}))
    method = f"tangents at {rates} K/min, extrapolated to zero rate"
    estimate = Estimate(float(fit.beta[0]), float(fit.std[0]), "K", method, len(used))
    estimate = estimate.with_shares(_instrument(0.0))
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


def _rates(scans: Sequence[RatedScan]) -> int:
    ordered = np.sort([s.rate for s in scans])
    return 1 + int(np.sum(np.diff(ordered) > _SAME_RATE * ordered[1:])) if len(ordered) else 0


def _prestrain(scans: Sequence[RatedScan], runs: Sequence[DscRecord]) -> list[Finding]:
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
            text += (
                f": {', '.join(sorted(moved))} moved, and not as prestrain alone moves them: the "
                "sample still trains, or the calorimeter drifts"
            )
        else:
            text += ": no shift beyond the errors"
        numbers = {n: d for n, (d, _) in shifts.items()}
        trains = moved and not (falls and cooling < _STAYS * largest)
        findings.append(
            Finding("warning", ", ".join(sorted(moved)), text, numbers) if trains
            else Finding("info", "prestrain", text, numbers)
        )
    return findings


def _table(scans: Sequence[RatedScan]) -> Array:
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


def _table_details(scans: Sequence[RatedScan]) -> dict[str, Estimate]:
    details = {}
    several = len({s.record for s in scans}) > 1
    for s in scans:
        run = f"run {s.record + 1}, " if several else ""
        for name, (value, std) in s.values.items():
            key = f"{run}cycle {s.cycle}, {s.rate * 60.0:g} K/min: {name}"
            details[key] = Estimate(value, std, "K", f"tangent, segment {s.segment}", 1)
    return details

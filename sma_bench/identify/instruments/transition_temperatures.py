"""E5, transition temperatures by calorimetry: tangents on every scan (Fig. 7, Table II)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments.tangents import (
    Onset,
    Scan,
    Transformation,
    find_transformation,
    make_scan,
)
from sma_bench.records import DscRecord, DscSegment

KELVIN = 273.15
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
    )


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

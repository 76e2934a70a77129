"""E5, transition temperatures by calorimetry: tangents on every scan (Fig. 7, Table II)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, fit_linear, mean_of_repeats
from sma_bench.identify.instruments.tangents import find_transformation, make_scan
from sma_bench.identify.result import Experiment
from sma_bench.records import DscRecord, DscSegment

NAME = "E5"
TITLE = "Transition temperatures over cycles and heating rates (Table II)"
ENDS = {
    "A_s": ("heating", "start", "wire.austenite_start_temperature"),
    "A_f": ("heating", "finish", "wire.austenite_finish_temperature"),
    "M_s": ("cooling", "start", "wire.martensite_start_temperature"),
    "M_f": ("cooling", "finish", "wire.martensite_finish_temperature"),
}
# A calorimeter is calibrated with indium to some tenths of a kelvin, which melts within seconds; a
# wire in its pan follows by so many seconds more or less.
_CALORIMETER_STD, _LAG_STD = 0.5, 5.0  # K, s
_SAME_RATE = 0.05  # share of a rate
_SIGNIFICANT = 3.0  # standard errors
_SMALLEST_SHIFT = 2.0  # K
_STAYS = 0.25  # of the largest shift: cooling that moves by less stays


@dataclass(frozen=True)
class RatedScan:
    """One scan with a whole peak: record by position, cycle from 1 among the scans of its kind.

    `values` holds (value, std) in K for those of A_s, A_f, M_s, M_f that it shows; `details` and
    `curves` what else it gives; `peaks` in K, the largest first.
    """

    record: int
    segment: DscSegment
    cycle: int
    values: dict[str, tuple[float, float]]
    details: dict[str, Estimate]
    curves: dict[str, Array]
    peaks: tuple[float, ...]

    @property
    def rate(self) -> float:
        """K/s, positive."""
        return abs(self.segment.rate)

    @property
    def per_minute(self) -> float:
        """K/min, positive."""
        return self.rate * 60.0


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
    return _one_run(0, record)[0]


def _one_run(place: int, record: DscRecord) -> tuple[Experiment, list[RatedScan]]:
    """What one run gives by itself, and its scans."""
    findings = list(record.findings)
    scans: list[RatedScan] = []
    problems: list[Finding] = []
    cycles = {"heating": 0, "cooling": 0}
    upward = record.endothermic_up
    driven = [s for s in record.segments if s.kind != "isothermal"]
    if upward is None and driven:
        text = "the file does not say which way endothermic is; taken as up"
        problems.append(Finding("warning", "DSC", text))
    for segment in driven:
        cycles[segment.kind] += 1
        try:
            scans.append(_read_scan(place, record, segment, cycles[segment.kind]))
        except InputError as error:
            text = f"segment {segment.number} ({segment.kind}) is left out: {error}"
            problems.append(Finding("warning", "DSC", text))
    if not scans:
        raise InputError(
            f"{record.path}: no heating or cooling scan with a whole peak"
            + (f" ({problems[0].text})" if problems else "")
        )
    findings += problems

    # The slowest scan of each direction, in doubt by its largest difference to the others.
    estimates: dict[str, Estimate] = {}
    for kind in ("heating", "cooling"):
        names = [name for name, end in ENDS.items() if end[0] == kind]
        of_kind = [s for s in scans if s.segment.kind == kind]
        if not of_kind:
            missing = " and ".join(ENDS[name][2] for name in names)
            findings.append(Finding("warning", "DSC", f"no {kind} scan, so no {missing}"))
            continue
        chosen = min(of_kind, key=lambda s: (s.per_minute, -s.cycle))
        method = (
            "baseline against the steepest tangent of the outermost flank, "
            f"{chosen.per_minute:g} K/min, cycle {chosen.cycle}"
        )
        for name in names:
            value, std = chosen.values[name]
            apart = max(abs(s.values[name][0] - value) for s in of_kind)
            estimates[ENDS[name][2]] = Estimate(
                value, math.hypot(std, apart), "K", method, len(of_kind)
            ).with_shares(_instrument(chosen.per_minute / 60.0))
        if len(of_kind) > 1:
            text = "; ".join(
                f"{name} " + ", ".join(f"{s.values[name][0]:.2f}" for s in of_kind) + " K"
                for name in names
            )
            runs = ", ".join(f"{s.per_minute:g} K/min (cycle {s.cycle})" for s in of_kind)
            text += f" at {runs}"
            if len({s.per_minute for s in of_kind}) == len(of_kind):
                text += "; rate and cycle changed together, so their effects cannot be told apart"
            findings.append(Finding("info", f"DSC {kind}", text))

    # Steps, and ranges that overlap.
    for s in scans:
        if len(s.peaks) > 1:
            text = (
                f"segment {s.segment.number} ({s.segment.kind}) has peaks at "
                f"{', '.join(f'{peak:.1f}' for peak in sorted(s.peaks))} K: the transformation "
                "goes in steps, start and finish enclose all of them"
            )
            findings.append(Finding("info", "DSC", text, {"peaks": float(len(s.peaks))}))
    heated, cooled = (estimates.get(ENDS[name][2]) for name in ("A_s", "M_s"))
    if heated and cooled and cooled.value > heated.value:
        text = (
            f"M_s = {cooled.value:.1f} K lies above A_s = {heated.value:.1f} K: the two "
            "transformation ranges overlap"
        )
        numbers = {"overlap": cooled.value - heated.value}
        findings.append(Finding("warning", "DSC", text, numbers))
    experiment = Experiment(
        NAME, "Transition temperatures", estimates, tuple(findings),
        {name: curve for s in scans for name, curve in s.curves.items()},
        f"{record.path}: {record.sample or 'sample'}, {record.mass * 1e6:.1f} mg",
        {name: number for s in scans for name, number in s.details.items()},
    )
    return experiment, scans


def _instrument(rate: float) -> dict[str, float]:
    """K, what no scan at this rate (K/s) shows; at rate zero nothing lags."""
    return {"calorimeter": _CALORIMETER_STD, "lag of the sample": _LAG_STD * rate}


def _read_scan(place: int, record: DscRecord, segment: DscSegment, cycle: int) -> RatedScan:
    """Tangents of one scan, and everything a figure of it needs.

    Raises:
        InputError: no whole peak.
    """
    # Heating takes the latent heat up, cooling gives it back: the peak shall point upward.
    sign = 1.0 if (segment.kind == "heating") == (record.endothermic_up is not False) else -1.0
    flow = sign * record.specific_heat_flow(segment)
    scan = make_scan(segment.time, segment.temperature, flow)
    found = find_transformation(scan)
    n = len(scan.temperature)
    where = f"{segment.kind}, {abs(segment.rate) * 60.0:g} K/min, cycle {cycle}"
    ends = {"start": found.start, "finish": found.finish}
    details = {
        end: Estimate(onset.temperature, onset.std, "K", f"tangent, {where}", n)
        for end, onset in ends.items()
    }
    details["latent_heat"] = Estimate(
        found.latent_heat, found.latent_heat_std, "J/kg", f"area over a baseline, {where}", n
    )
    for k, peak in enumerate(found.peaks):
        name = "peak" if k == 0 else f"peak_{k + 1}"
        details[name] = Estimate(peak, 0.1, "K", f"maximum over the baseline, {where}", n)

    # Lines are cut to where they touch the scan.
    top = float(np.max(scan.flow))
    curves = {"temperature": scan.temperature, "heat_flow": scan.flow, "base": found.base}
    forward = 1.0 if scan.temperature[-1] > scan.temperature[0] else -1.0
    for name, far, inward in (("start", 0, forward), ("finish", -1, -forward)):
        onset = ends[name]
        baseline = np.array([scan.temperature[far], onset.temperature + 5.0 * inward])
        level = float(onset.baseline(np.array(onset.temperature)))
        tangent = onset.temperature + np.array([0.0, (top - level) / onset.tangent.slope])
        curves |= {
            f"{name}/baseline_temperature": baseline,
            f"{name}/baseline": onset.baseline(baseline),
            f"{name}/tangent_temperature": tangent,
            f"{name}/tangent": onset.tangent(tangent),
        }
    key = f"segment_{segment.number}"
    return RatedScan(
        place, segment, cycle,
        {
            name: (ends[end].temperature, ends[end].std)
            for name, (kind, end, _) in ENDS.items() if kind == segment.kind
        },
        {f"{key}/{name}": number for name, number in details.items()},
        {f"{key}/{name}": curve for name, curve in curves.items()},
        found.peaks,
    )


# --- E5 over cycles and heating rates: Table II, prestrain, and onsets extrapolated to zero rate.
#
# Heat takes time to reach the sample, so onsets move with the rate, in proportion to it; the
# straight line through several rates gives the onset at rate zero (Hoehne et al., Thermochimica
# Acta 160, 1990, calibrate the same way). The first heating of a prestrained sample starts later,
# because its detwinned martensite is stabilised; the second does not: that difference is the
# prestrain, not an error of measurement.


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
    read = [_one_run(place, run) for place, run in enumerate(runs)]
    scans = [s for _, own in read for s in own]
    findings = [f for experiment, _ in read for f in experiment.findings]
    for run, (_, own) in zip(runs, read, strict=True):
        findings.extend(_prestrain(run, own))
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    for name, (_, _, parameter) in ENDS.items():
        seen = [s for s in scans if name in s.values]
        if not seen:
            continue
        estimates[parameter], lag = _at_zero_rate(name, seen, findings)
        if lag is not None:
            details[f"{name} at zero rate"], details[f"{name} lag"] = estimates[parameter], lag

    # Table II: a row of each record, cycle and rate.
    rows: dict[tuple[int, int, float], list[float]] = {}
    for s in scans:
        row = rows.setdefault((s.record, s.cycle, round(s.per_minute, 3)), [math.nan] * len(ENDS))
        of_run = f"run {s.record + 1}, " if len({other.record for other in scans}) > 1 else ""
        for name, (value, std) in s.values.items():
            row[list(ENDS).index(name)] = value
            details[f"{of_run}cycle {s.cycle}, {s.per_minute:g} K/min: {name}"] = Estimate(
                value, std, "K", f"tangent, segment {s.segment.number}", 1
            )
    table = [[cycle, rate, *row] for (_, cycle, rate), row in sorted(rows.items())]
    curves: dict[str, Array] = {"table": np.array(table)}
    for run, (experiment, _) in zip(runs, read, strict=True):
        curves |= {f"{run.path.name}/{key}": v for key, v in experiment.curves.items()}
        details |= {f"{run.path.name}/{key}": v for key, v in experiment.details.items()}
    source = "; ".join(experiment.source for experiment, _ in read)
    return Experiment(NAME, TITLE, estimates, tuple(findings), curves, source, details)


def _at_zero_rate(
    name: str, seen: Sequence[RatedScan], findings: list[Finding]
) -> tuple[Estimate, Estimate | None]:
    """The estimate, and the lag (K per K/s, so s) where several rates were run."""

    def rates(scans: Sequence[RatedScan]) -> int:
        ordered = np.sort([s.rate for s in scans])
        return 1 + int(np.sum(np.diff(ordered) > _SAME_RATE * ordered[1:])) if scans else 0

    used = [s for s in seen if s.cycle > 1] or list(seen)
    if rates(used) < 2 and rates(seen) > 1:
        # Better all cycles than one rate, as long as it is said.
        used = list(seen)
        text = (
            "rates and cycles changed together; the line to zero rate takes the first "
            "cycle for a later one, which only holds without prestrain"
        )
        findings.append(Finding("warning", name, text))
    rate = np.array([s.rate for s in used])
    value, std = np.array([s.values[name] for s in used]).T
    if rates(used) < 2:
        slowest, *errors = mean_of_repeats([s.values[name] for s in used])
        cycle = "cycle " + ", ".join(str(s.cycle) for s in used)
        text = f"tangents, {rate[0] * 60.0:g} K/min, {cycle}"
        estimate = Estimate(slowest, math.hypot(*errors), "K", text, len(used))
        return estimate.with_shares(_instrument(float(rate[0]))), None
    fit = fit_linear(np.column_stack([np.ones(len(rate)), rate]), value, np.diag(std**2))
    shown = ", ".join(f"{r:g}" for r in sorted({round(r * 60.0, 3) for r in rate.tolist()}))
    method = f"tangents at {shown} K/min, extrapolated to zero rate"
    estimate = Estimate(float(fit.beta[0]), float(fit.std[0]), "K", method, len(used))
    lag = Estimate(
        float(fit.beta[1]), float(fit.std[1]), "s", "change of onset with rate", len(used)
    )
    kind = ENDS[name][0]
    if (-lag.value if kind == "heating" else lag.value) > _SIGNIFICANT * lag.std:
        text = (
            f"it moves by {lag.value:+.3g} K per K/s of rate, against the way that thermal lag "
            f"moves it on {kind}: cycles differ, or the sample changed"
        )
        findings.append(Finding("warning", name, text, {"lag": lag.value, "std": lag.std}))
    return estimate.with_shares(_instrument(0.0)), lag


def _prestrain(run: DscRecord, scans: Sequence[RatedScan]) -> list[Finding]:
    """The shift from the first to the second cycle of a record, at one rate."""
    shifts: dict[str, tuple[float, float]] = {}
    for name in ENDS:
        mine = [s for s in scans if name in s.values]
        first, second = (next((s for s in mine if s.cycle == k), None) for k in (1, 2))
        if first and second and abs(first.rate - second.rate) <= _SAME_RATE * first.rate:
            (a, a_std), (b, b_std) = first.values[name], second.values[name]
            shifts[name] = (b - a, math.hypot(a_std, b_std))
    if not shifts:
        return []
    moved = sorted(
        n for n, (d, s) in shifts.items() if abs(d) > max(_SIGNIFICANT * s, _SMALLEST_SHIFT)
    )
    falls = [n for n in ("A_s", "A_f") if n in moved and shifts[n][0] < 0.0]
    largest = max(abs(d) for d, _ in shifts.values())
    cooling = max((abs(shifts[n][0]) for n in ("M_s", "M_f") if n in shifts), default=0.0)
    recovers = bool(falls) and cooling < _STAYS * largest
    listed = ", ".join(f"{n} {d:+.2f} +- {s:.2f} K" for n, (d, s) in shifts.items())
    text = f"{run.path}: from cycle 1 to 2 {listed}"
    if recovers:
        text += (
            f": {' and '.join(falls)} fall and the cooling stays nearly, the mark of prestrain "
            "that the first heating recovers; cycle 2 is the material's own"
        )
    elif moved:
        text += (
            f": {', '.join(moved)} moved, and not as prestrain alone moves them: the sample still "
            "trains, or the calorimeter drifts"
        )
    else:
        text += ": no shift beyond the errors"
    trains = moved and not recovers
    return [Finding(
        "warning" if trains else "info", ", ".join(moved) if trains else "prestrain", text,
        {n: d for n, (d, _) in shifts.items()},
    )]

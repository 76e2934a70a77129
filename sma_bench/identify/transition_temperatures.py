"""E5, transition temperatures by calorimetry: tangents on every scan (Fig. 7) of several
cycles and rates (Table II); a line over the rates gives the onset at rate zero (Hoehne et al.,
Thermochimica Acta 160, 1990). Prestrain raises A_s and A_f of the first heating only."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import scatter
from sma_bench.findings import Finding
from sma_bench.identify.fits import Line, fit_linear, mean_of_repeats, straight_line
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.records import DscRecord, DscSegment

_ENDS = {"heating": ("A_s", "A_f"), "cooling": ("M_s", "M_f")}  # start and finish
# Systematic: calibration with indium, to some tenths of a kelvin; the sample lags by seconds.
_CALORIMETER_STD, _LAG_STD = 0.5, 5.0  # K, s
_SAME_RATE = 0.05  # share by which equal rates may differ
_SIGNIFICANT = 3.0  # standard errors
_SMALLEST_SHIFT = 2.0  # K, from cycle 1 to 2, least reported
_STAYS = 0.25  # of the largest shift: on cooling, less than that counts as none
_GRID = 0.05  # K
# The first choices give the result, the others its error.
_SMOOTHINGS = (4.0, 2.0, 6.0)  # K, over which the slope of a flank is taken
_ON_BASELINE, _FACTORS = 0.003, (1.0, 0.3, 3.0)  # of the scan's height, by which a baseline misses
_BASELINE = 5.0  # K, least length
_LONGEST_START_UP, _STRAIGHT = 180.0, 0.0015  # s; of the scan's height: deviation of a settled scan
_LARGEST_NOISE = 4.0  # standard deviations, which hardly one of a hundred readings exceeds
_FLANK_HEIGHT, _FLANK_PROMINENCE = 0.05, 0.05  # of the peak; of the steepest slope
_PEAK_PROMINENCE = 0.002  # of the scan's height
_SMALLEST_PEAK = 20.0  # times the noise
_SIGMOID_PASSES = 8


class Scan(NamedTuple):
    """One scan with a whole peak."""

    run: int  # index of its record
    segment: DscSegment
    cycle: int  # from 1, among the scans of its kind
    rate: float  # K/s, positive
    per_minute: float  # K/min
    values: dict[str, tuple[float, float]]  # K and standard error, by A_s ... M_f
    details: dict[str, Estimate]
    curves: dict[str, Array]
    peaks: tuple[float, ...]  # K, the largest first


def _read_scan(run: int, record: DscRecord, segment: DscSegment, cycle: int) -> Scan:
    """Onset and finish by tangents to the outermost flanks (a transformation may go in steps),
    peaks, and the area over a baseline. InputError: too short, never straight, or no peak."""
    # Make the peak point upward: heating absorbs latent heat, cooling releases it.
    upward = (segment.kind == "heating") == (record.endothermic_up is not False)
    flow = (1.0 if upward else -1.0) * record.specific_heat_flow(segment)
    time, temperature = segment.time, segment.temperature
    span, least = np.ptp(temperature), 4.0 * _BASELINE
    if len(time) < 100 or span < least:
        raise refusal("short scan", n=len(time), span=span, least=least)
    # An even grid of the furthest temperature so far: at the start and with noise it goes back.
    spread = _LARGEST_NOISE * scatter(flow)
    sign = 1.0 if temperature[-1] > temperature[0] else -1.0
    reached = np.maximum.accumulate(sign * temperature)
    keep = np.concatenate([[True], np.diff(reached) > 0.0])
    steps = np.arange(reached[0], reached[-1], _GRID)
    stamps, flow = (np.interp(steps, reached[keep], v[keep]) for v in (time, flow))
    measured_rate = float((reached[-1] - reached[0]) / (time[-1] - time[0]))
    # Begin where the next kelvins are straight within the noise: the instrument has settled.
    width = round(_BASELINE / _GRID)
    limit = max(_STRAIGHT * float(np.ptp(flow[len(flow) // 10 : -len(flow) // 10])), spread)
    last = min(int(np.searchsorted(stamps, stamps[0] + _LONGEST_START_UP)), len(flow) - width)
    for first in range(0, last, round(0.5 / _GRID)):
        x, piece = steps[first : first + width], flow[first : first + width]
        if np.max(np.abs(piece - straight_line(x, piece)(x))) < limit:
            break
    else:
        raise refusal("scan never settles", width=_BASELINE, longest=_LONGEST_START_UP)
    t, flow = sign * steps[first:], flow[first:]
    height, noise = float(np.ptp(flow)), float(np.std(np.diff(flow, 2))) / math.sqrt(6.0)
    if height < _SMALLEST_PEAK * noise or height <= 0.0:
        raise InputError(f"DSC scan: no peak, its {height:.3g} W/kg are noise")
    ends = {"start": _onset(t, flow, spread), "finish": _onset(t[::-1], flow[::-1], spread)}
    (begin, _, before, _, head), (end, _, after, _, tail) = ends.values()
    if (end - begin) * sign <= 0.0:
        raise refusal("tangents in the wrong order", begin=begin, end=end)
    # Baselines under the peak: a sigmoid, by the share of the area so far, and a straight chord.
    n = len(flow)
    first = min(round(head / _GRID), n - 2)
    last = max(n - 1 - round(tail / _GRID), first + 1)
    inside, count = slice(first, last + 1), last + 1 - first
    left, right = before(t), after(t)
    chord, base, share = flow.copy(), flow.copy(), np.linspace(0.0, 1.0, count)
    chord[inside] = np.linspace(left[first], right[last], count)
    for _ in range(_SIGMOID_PASSES):
        sigmoid = left[inside] * (1.0 - share) + right[inside] * share
        area = np.cumsum(np.maximum(flow[inside] - sigmoid, 0.0))
        share = area / area[-1]
    base[inside] = sigmoid
    heat, plain = (float(np.sum(flow - b)) * _GRID / measured_rate for b in (base, chord))

    from scipy.signal import find_peaks  # half a second to load
    found, _ = find_peaks(flow - base, prominence=_PEAK_PROMINENCE * height)
    between = found[(t[found] - begin) * (t[found] - end) < 0.0]
    peaks = tuple(t[between[np.argsort(-(flow - base)[between])]].tolist())
    rate, per_minute = abs(segment.rate), abs(segment.rate) * 60.0
    where = f"{segment.kind}, {per_minute:g} K/min, cycle {cycle}"
    details, top = {}, float(np.max(flow))
    curves = {"temperature": t, "heat_flow": flow, "base": base}
    for name, far, inward in (("start", 0, sign), ("finish", -1, -sign)):
        kelvin, std, baseline, tangent, _ = ends[name]
        details[name] = Estimate(kelvin, std, "K", f"tangent, {where}", n)
        rise = top - float(baseline(np.array(kelvin)))
        x = np.array([t[far], kelvin + 5.0 * inward])
        curves |= {f"{name}/baseline_temperature": x, f"{name}/baseline": baseline(x)}
        x = kelvin + np.array([0.0, rise / tangent.slope])
        curves |= {f"{name}/tangent_temperature": x, f"{name}/tangent": tangent(x)}
    std = max(abs(heat - plain), 0.01 * heat)
    details["latent_heat"] = Estimate(heat, std, "J/kg", f"area over a baseline, {where}", n)
    for k, peak in enumerate(peaks, 1):
        name = f"peak_{k}" if k > 1 else "peak"
        details[name] = Estimate(peak, 0.1, "K", f"maximum over the baseline, {where}", n)
    values = dict(zip(_ENDS[segment.kind], (found[:2] for found in ends.values()), strict=True))
    return Scan(run, segment, cycle, rate, per_minute, values, details, curves, peaks)


def _onset(t: Array, flow: Array, spread: float) -> tuple[float, float, Line, Line, float]:
    """Where the outermost flank's tangent meets the baseline at the beginning of a scan with noise
    within `spread`: K, its error from other choices, baseline, tangent, K of baseline."""
    from scipy.signal import find_peaks, savgol_filter  # half a second to load
    # Lines through the scan's beginning, extended while the scan stays on them.
    height, shortest, baselines = float(np.ptp(flow)), round(_BASELINE / _GRID), []
    for factor in _FACTORS:
        count = shortest
        for _ in range(10):
            line = straight_line(t[:count], flow[:count])
            away = np.abs(flow - line(t)) > max(factor * _ON_BASELINE * height, spread)
            reach = int(np.argmax(away)) if away.any() else len(away)
            longer = max(min(reach, len(away) // 2), shortest)
            if longer <= count:
                break
            count = longer
        baselines.append((line, count * _GRID))
    baseline, extent = baselines[0]
    # Tangents at the first inflection met on the way up from the baseline.
    tangents = []
    for smoothing in _SMOOTHINGS:
        window = 2 * round(0.5 * smoothing / _GRID) + 1
        smooth, slope = (savgol_filter(flow, window, 2, deriv=k) for k in (0, 1))
        above = smooth - baseline(t)
        top = int(np.argmax(above))
        rise = slope[: top + 1]
        inflections, _ = find_peaks(rise, prominence=_FLANK_PROMINENCE * float(np.max(rise)))
        high = inflections[above[inflections] > _FLANK_HEIGHT * above[top]]
        if not len(high):
            raise InputError("DSC scan: no flank between baseline and peak, expected a whole peak")
        touch = int(high[0])
        steepness = float(slope[touch]) / float(t[1] - t[0])
        tangents.append(Line(float(t[touch]), float(smooth[touch]), steepness))
    temperature = tangents[0].crossing(baseline)
    others = [other.crossing(baseline) for other in tangents]
    others += [tangents[0].crossing(other) for other, _ in baselines]
    spread = float(np.max(np.abs(np.array(others) - temperature)))
    return temperature, max(spread, 2.0 * _GRID), baseline, tangents[0], extent


def identify_transition_temperatures(runs: Sequence[DscRecord]) -> Experiment:
    """A_s, A_f, M_s and M_f, stress free, from DSC runs of one material: from the cycles after the
    first, extrapolated to zero rate where several runs have two rates or more. If one run has
    several rates, its slowest scan counts, the others enter the error. `details` holds "cycle 1,
    5 K/min: A_s" (Table II), "A_s at zero rate", "A_s lag" [s], and of every scan
    "<file>/segment_N/..." (no file in one run of several rates) start, finish, peak [K] and
    latent_heat [J/kg]; `curves` its heat flow [W/kg, upward] over temperature [K] with baselines
    and tangents. InputError: a run without a peak."""
    findings, scans, rates = list[Finding](), list[Scan](), set[float]()
    for place, run in enumerate(runs):
        own, problems, cycles = list[Scan](), list[Finding](), {"heating": 0, "cooling": 0}
        driven = [scan for scan in run.segments if scan.kind != "isothermal"]
        rates |= {round(abs(scan.rate) * 60.0, 1) for scan in driven}
        if run.endothermic_up is None and driven:
            problems.append(remark("endothermic which way"))
        for scan in driven:
            kind = scan.kind
            cycles[kind] += 1
            try:
                own.append(_read_scan(place, run, scan, cycles[kind]))
            except InputError as error:
                problems.append(remark("scan left out", number=scan.number, kind=kind, error=error))
        if not own:
            why = f" ({problems[0].text})" if problems else ""
            raise InputError(f"{run.path}: no heating or cooling scan with a whole peak{why}")
        findings += [*run.findings, *problems, *_prestrain(run, own)]
        scans += own
    mixed = len(runs) == 1 and len(rates) > 1
    if mixed:
        findings.append(remark("rates and cycles of one run"))
    estimates, details, curves = dict[str, Estimate](), dict[str, Estimate](), dict[str, Array]()
    for name, parameter in TRANSITIONS.items():
        seen = [s for s in scans if name in s.values]
        if seen and mixed:
            chosen = min(seen, key=lambda s: (s.per_minute, -s.cycle))
            value, std = chosen.values[name]
            std = math.hypot(std, max(abs(s.values[name][0] - value) for s in seen))
            method = ("baseline against the steepest tangent of the outermost flank, "
                      f"{chosen.per_minute:g} K/min, cycle {chosen.cycle}")
            slowest = Estimate(value, std, "K", method, len(seen))
            estimates[parameter] = slowest.with_shares(_instrument(chosen.rate))
        elif seen:
            estimates[parameter], lag = _at_zero_rate(name, seen, findings)
            if lag:
                details |= {f"{name} at zero rate": estimates[parameter], f"{name} lag": lag}
    if missing := [name for name, own in TRANSITIONS.items() if own not in estimates]:
        findings.append(remark("no scan of a kind", missing=" and ".join(missing)))
    heated, cooled = (estimates.get(TRANSITIONS[name]) for name in ("A_s", "M_s"))
    if heated and cooled and (overlap := cooled.value - heated.value) > 0.0:
        findings.append(remark("ranges overlap", cooled=cooled.value, heated=heated.value,
                               overlap=overlap))
    for s in scans:
        number = s.segment.number
        of_run = f"run {s.run + 1}, " if len(runs) > 1 else ""
        stem = f"{'' if mixed else runs[s.run].path.name + '/'}segment_{number}"
        for name, found in s.values.items():
            words = f"{of_run}cycle {s.cycle}, {s.per_minute:g} K/min: {name}"
            details[words] = Estimate(*found, "K", f"tangent, segment {number}", 1)
        details |= {f"{stem}/{key}": value for key, value in s.details.items()}
        curves |= {f"{stem}/{key}": curve for key, curve in s.curves.items()}
        if len(s.peaks) > 1:
            peaks, count = ", ".join(f"{peak:.1f}" for peak in sorted(s.peaks)), float(len(s.peaks))
            findings.append(remark("steps of transformation", numbers={"peaks": count},
                                   number=number, kind=s.segment.kind, peaks=peaks))
    each = (f"{run.path}: {run.sample or 'sample'}, {run.mass * 1e6:.1f} mg" for run in runs)
    return Experiment("E5", "Transition temperatures", estimates, tuple(findings), curves,
                      "; ".join(each), details)


def _instrument(rate: float) -> dict[str, float]:
    """Systematic errors [K] of a scan at this rate [K/s]; at rate zero nothing lags."""
    return {"calorimeter": _CALORIMETER_STD, "lag of the sample": _LAG_STD * rate}


def _at_zero_rate(name: str, seen: Sequence[Scan],
                  findings: list[Finding]) -> tuple[Estimate, Estimate | None]:
    """The estimate, and the lag (K per K/s, so s) where several rates were run."""
    used = [s for s in seen if s.cycle > 1] or list(seen)
    rate, n = np.array([s.rate for s in used]), len(used)
    if np.ptp(rate) <= _SAME_RATE * rate.max():
        mean, *errors = mean_of_repeats([s.values[name] for s in used])
        cycles = ", ".join(str(s.cycle) for s in used)
        method = f"tangents, {rate[0] * 60.0:g} K/min, cycle {cycles}"
        estimate = Estimate(mean, math.hypot(*errors), "K", method, n)
        return estimate.with_shares(_instrument(float(rate[0]))), None
    value, std = np.array([s.values[name] for s in used]).T
    fit = fit_linear(np.column_stack([np.ones(n), rate]), value, np.diag(std**2))
    shown = ", ".join(f"{r:g}" for r in sorted({round(r * 60.0, 3) for r in rate.tolist()}))
    method = f"tangents at {shown} K/min, extrapolated to zero rate"
    (zero, slope), (zero_std, slope_std) = fit.beta.tolist(), fit.std.tolist()
    lag = Estimate(slope, slope_std, "s", "change of onset with rate", n)
    facts = {"lag": slope, "std": slope_std, "kind": seen[0].segment.kind}
    if (-slope if facts["kind"] == "heating" else slope) > _SIGNIFICANT * slope_std:
        findings.append(remark("lag the wrong way", subject=name, **facts))
    return Estimate(zero, zero_std, "K", method, n).with_shares(_instrument(0.0)), lag


def _prestrain(run: DscRecord, scans: Sequence[Scan]) -> list[Finding]:
    """Finding on temperatures that shifted from cycle 1 to 2 of a run at the same rate."""
    shifts: dict[str, tuple[float, float]] = {}
    for name in TRANSITIONS:
        mine = {s.cycle: s for s in scans if name in s.values}
        first, second = mine.get(1), mine.get(2)
        if first and second and abs(first.rate - second.rate) <= _SAME_RATE * first.rate:
            (a, a_std), (b, b_std) = first.values[name], second.values[name]
            shifts[name] = (b - a, math.hypot(a_std, b_std))
    large = {n for n, (d, s) in shifts.items() if abs(d) > max(_SIGNIFICANT * s, _SMALLEST_SHIFT)}
    if not large:
        return []
    falls = [n for n in ("A_s", "A_f") if n in large and shifts[n][0] < 0.0]
    numbers, moved = {n: d for n, (d, _) in shifts.items()}, ", ".join(sorted(large))
    cooling = max((abs(numbers[n]) for n in ("M_s", "M_f") if n in shifts), default=0.0)
    prestrained = falls and cooling < _STAYS * max(map(abs, numbers.values()))
    return [remark("prestrain" if prestrained else "sample still trains",
                   path=run.path, moved=moved, subject="prestrain" if prestrained else moved,
                   numbers=numbers, falls=" and ".join(falls),
                   listed=", ".join(f"{n} {d:+.2f} +- {s:.2f} K" for n, (d, s) in shifts.items()))]

"""Checks of a record: missing signals, order, gaps, clocks, units, saturation, response to heat."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.border import read_yaml
from sma_bench.findings import Finding
from sma_bench.records.record import Record, Signal, first_order_lag, has_samples, held_at, samples

_GAP_PERIODS = 10  # a longer step is a gap: a stalled driver, not random losses
_LOSS_INFO, _LOSS_WARNING = 0.02, 0.2  # share of lost samples from which each is reported
CLOCK_TOLERANCE, DRIFT_TOLERANCE, _FUTURE_TOLERANCE = 0.1, 0.05, 0.01  # s
_IRREGULAR = 0.1  # periods, median distance of the steps from whole ones
_REVERSED = 0.9  # share of readings with the other sign than the voltage
# An outlier is farther from its neighbours than each of: standard deviations, share of the range,
# steps of the resolution. More than _MOST_OUTLIERS are not measurement errors.
_OUTLYING, _OUT_OF_RANGE, _FEW_STEPS, _MOST_OUTLIERS = 12.0, 0.05, 3, 5
_DROP, _MOST_DROPPED = 0.2, 0.1  # of the range within a sample (heat is slower); of all readings
DROPS_OUT = ("temperature", "deflection", "range")
FEWEST, _TICKS = 50, 0.01  # samples for statistics; share of receive times a real clock repeats
_FLAT_SAMPLES = 20  # of the shortest flat stretch of a clipped signal
_ENTRY_SAMPLES, _ENTRY_FRACTION = 3, 0.01  # samples before it, and how far they move (of the range)
_TEXTS: dict[str, Any] = read_yaml(Path(__file__).with_suffix(".yaml"))
_PLAUSIBLE = _TEXTS.pop("plausible")
_MECHANICS = ("deflection", "elongation", "force", "front.range", "back.range")


def check_record(record: Record) -> list[Finding]:
    """All findings about a record, those of its reader included."""
    found, signals = list(record.findings), record.signals
    names = [f"{c}.{k}" for c in record.channels for k in ("voltage", "current", "temperature")]
    found += [Finding("info", n, "absent from the record") for n in names if n not in signals]
    if signals and not record.channels:
        found.append(Finding("warning", "record", "no channel: neither voltages nor temperatures"))
    if signals and not any(name in signals for name in _MECHANICS):
        found.append(Finding("info", "record", f"no mechanical signal ({', '.join(_MECHANICS)})"))
    for check in (_values, _rate, _clocks, _saturation, check_response):
        found += check(record)
    return found


def finding_of(key: str, subject: str, **facts: Any) -> Finding:
    """A finding of check.yaml, filled in."""
    severity, text, *numbers = _TEXTS[key]
    kept = {name: float(facts[name]) for name in numbers}
    return Finding(severity, subject, text.format(**facts), kept)


def kind_of(name: str) -> str:
    return name.rpartition(".")[2]


def _values(record: Record) -> Iterator[Finding]:
    """Order of stamps; missing, outlying and implausible values; a reversed current sensor."""
    for name, signal in record.signals.items():
        kind, unit, off = kind_of(name), signal.unit, outliers(signal)
        steps = np.diff(signal.time)
        backward, repeated = int(np.sum(steps < 0)), int(np.sum(steps == 0))
        if backward or repeated:
            yield finding_of("order", name, backward=backward, duplicates=repeated)
        finite = signal.values[np.isfinite(signal.values)]
        if missing := signal.values.size - len(finite):
            yield finding_of("holes", name, count=missing, of=signal.values.size)
        if kind == "current" and (share := against_voltage(record, signal)):
            yield finding_of("against", name, share=share)
        if len(off):  # the plausible range is checked without them
            finite = np.delete(finite, off)
            values = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            yield finding_of("single", name, outliers=len(off), values=values, unit=unit)
        if not len(finite):
            continue
        low, high = float(finite.min()), float(finite.max())
        for key, least, most, hint in _PLAUSIBLE.get(kind, ()):
            if not (least[0] <= low <= least[1] and most[0] <= high <= most[1]):
                yield finding_of(key, name, low=low, high=high, unit=unit, hint=hint)
                break


def against_voltage(record: Record, current: Signal) -> float:
    """Share of a current's readings whose sign differs from the voltage's; 0 unless nearly all."""
    name = current.name.removesuffix("current") + "voltage"
    if not (has_samples(record, name) and has_samples(record, current.name)):
        return 0.0
    volts, size = np.interp(current.time, *samples(record, name)), np.abs(current.values)
    heated = (size > 0.2 * np.nanmax(size)) & (np.abs(volts) > 0.2 * np.abs(volts).max())
    if heated.sum() < 10:
        return 0.0
    share = float(np.mean(current.values[heated] * volts[heated] < 0.0))
    return share if share > _REVERSED else 0.0


def outliers(signal: Signal) -> IntArray:
    """Indices of a few single readings far from both neighbours, which agree, and of dropouts, one
    value far from those around it. None for commands, voltages and currents: they may pulse."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    pulses = signal.name.endswith(("voltage", "voltage_command", "current"))
    if values.ndim != 1 or len(values) < FEWEST or pulses or not np.isfinite(values).all():
        return none
    # Stretches of one value, far from the readings before and after them, which agree.
    begins = np.append(0, np.flatnonzero(np.diff(values)) + 1)
    ends = np.append(begins[1:], len(values))  # the first reading after each
    inside = (begins > 0) & (ends < len(values))
    begins, ends = begins[inside], ends[inside]
    level, before, after = values[begins], values[begins - 1], values[ends]
    jump = np.minimum(np.abs(level - before), np.abs(level - after))
    off = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    span = float(np.subtract(*np.quantile(values, [0.99, 0.01])))
    least = max(_OUT_OF_RANGE * span, _FEW_STEPS * _resolution(values))
    least = max(_OUTLYING * float(np.median(off)) / 0.6745, least)
    far = (jump > least) & (np.abs(after - before) < 0.25 * jump) & (least > 0.0)
    found = far & (ends - begins == 1)
    found &= np.sum(found) <= _MOST_OUTLIERS
    if kind_of(signal.name) in DROPS_OUT:  # one value again and again, as a sensor's code
        far &= jump > _DROP * float(np.ptp(values))
        few = _MOST_DROPPED * len(values)
        codes = [v for v in (values.min(), values.max())
                 if np.sum(far & (level == v)) > 2 and np.sum(values == v) < few]
        again = far & ((ends - begins > 1) | np.isin(level, codes)) & ~np.isin(before, codes)
        found |= again & (np.sum((ends - begins)[again]) < few)
    pairs = zip(begins[found], ends[found], strict=True)
    return np.concatenate([none, *(np.arange(begin, end) for begin, end in pairs)])


def _resolution(values: Array) -> float:
    """The smallest step of readings with few digits; 0 for others."""
    levels = np.unique(values)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.2 * len(values) else 0.0


def _rate(record: Record) -> Iterator[Finding]:
    """Gaps, irregular sampling, lost samples."""
    # By number and place: signals that pause together, as when a node ends, are one finding.
    pauses = defaultdict[tuple[int, int], list[tuple[float, float, str]]](list)
    for name, signal in record.signals.items():
        period = signal.period
        if len(signal) < 10 or name == "voltage_command" or not period > 0:
            continue
        steps = np.diff(signal.time)
        # Lost samples can be counted only if there is a regular period.
        is_irregular = np.median(np.abs(steps / period - np.rint(steps / period))) > _IRREGULAR
        gaps = steps > _GAP_PERIODS * (np.percentile(steps, 95) if is_irregular else period)
        if gaps.any():
            k = int(np.argmax(steps))
            longest, at = float(steps[k]), float(signal.time[k])
            pauses[int(gaps.sum()), round(at / longest)].append((longest, at, name))
        lost = float(np.sum(np.maximum(np.rint(steps[~gaps] / period) - 1, 0)))
        share = lost / (lost + len(signal))
        if is_irregular:
            yield finding_of("irregular", name, rate=(len(steps) - gaps.sum()) / steps[~gaps].sum())
        elif share > _LOSS_INFO:
            key = "many_lost" if share > _LOSS_WARNING else "few_lost"
            yield finding_of(key, name, fraction=share, percent=100 * share, hertz=1 / period)
    for (count, _), alike in pauses.items():
        (longest, at, _), names = max(alike), ", ".join(name for *_, name in alike)
        yield finding_of("gaps", names, gaps=count, longest=longest, at=at, periods=_GAP_PERIODS)


def delays_of(record: Record) -> dict[str, tuple[float, float]]:
    """Median delay (receive time minus stamp) and its growth over the record, s by signal; empty
    for a simulated clock, whose delays only show how busy the computer was."""
    received = {n: s.received for n, s in record.signals.items()
                if s.received is not None and len(s.received) == len(s) > 0}
    ticks = [np.mean(np.diff(r) < 1e-9) for r in received.values() if len(r) >= FEWEST]
    found = {}
    for name, times in received.items() if max(ticks, default=0.0) <= _TICKS else ():
        delay, tenth = times - record[name].time, max(1, len(times) // 10)
        growth = float(np.median(delay[-tenth:]) - np.median(delay[:tenth]))
        found[name] = float(np.median(delay)), growth
    return found


def _clocks(record: Record) -> Iterator[Finding]:
    """Topics whose delays differ from the others' or drift."""
    of_signals = delays_of(record).items()
    delays = {record[name].topic or name: d for name, d in of_signals if name != "voltage_command"}
    common, common_drift = np.median([*delays.values()] or [(0.0, 0.0)], axis=0).tolist()
    if abs(common_drift) > DRIFT_TOLERANCE:
        yield finding_of("drifts", "record", drift=common_drift)
    for topic, (median, growth) in delays.items():
        offset, drift = median - common, growth - common_drift
        if abs(offset) > CLOCK_TOLERANCE:
            yield finding_of("clock_off", topic, offset=offset, own=median, common=common)
        elif abs(drift) > DRIFT_TOLERANCE:
            yield finding_of("clock_drifts", topic, drift=drift)
        elif -1.0 < median < -_FUTURE_TOLERANCE:
            yield finding_of("future", topic, ahead=-median, offset=median)


def _saturation(record: Record) -> Iterator[Finding]:
    """Sensors that are constant while a voltage changes, or clip at their highest or lowest."""
    voltages = [s.values for n, s in record.signals.items() if kind_of(n) == "voltage" and len(s)]
    driven = any(np.ptp(values) > _LEAST_DRIVE for values in voltages)
    still, force = {"ambient.temperature"}, record.get("force")
    if force is not None and len(force) and np.ptp(force.values) > 0:
        still.add("elongation")  # a clamped wire
    for name, signal in record.signals.items():
        values, kind = signal.values, kind_of(name)
        is_short = len(values) < _FLAT_SAMPLES * 2
        if kind in ("voltage", "voltage_command") or is_short or not np.isfinite(values).all():
            continue
        if np.ptp(values) == 0:
            if driven and kind != "current" and name not in still:
                yield finding_of("dead", name, value=values[0], unit=signal.unit)
            continue
        for extreme, word in ((float(values.max()), "highest"), (float(values.min()), "lowest")):
            if count := len(clipped_samples(record, signal, extreme)):
                facts = {"value": extreme, "word": word, "unit": signal.unit}
                yield finding_of("clipped", name, samples=count, **facts)


def clipped_samples(record: Record, signal: Signal, extreme: float) -> IntArray:
    """Indices of the samples at `extreme` if the sensor clips there, else none. It clips if a flat
    stretch is entered fast or its noise rules one out; a current, if its voltage changes there."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    if extreme == values[0] and signal.name in _MECHANICS:
        return none  # the rest position
    # Differences of noise grow with their order; those of a smooth signal shrink.
    second, third = (np.abs(np.diff(values[values != extreme], k)) for k in (2, 3))
    noisy = len(third) > _FLAT_SAMPLES and np.median(third) > np.median(second) > 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], values == extreme, [False]))))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if stop - start < _FLAT_SAMPLES:
            continue
        if kind_of(signal.name) == "current":
            voltage = record.get(signal.name.removesuffix("current") + "voltage")
            if voltage is None or extreme == 0.0:
                continue
            first, last = signal.time[start], signal.time[stop - 1]
            inside = voltage.values[(voltage.time >= first) & (voltage.time <= last)]
            clipped = len(inside) > 1 and np.ptp(inside) > 0.05 * np.ptp(voltage.values)
        else:
            before = np.abs(values[max(0, start - _ENTRY_SAMPLES) : start] - extreme)
            # Readings of few digits are flat anyway, and change by their resolution at least.
            fast = max(_ENTRY_FRACTION * np.ptp(values), 2.0 * _resolution(values))
            clipped = noisy or (len(before) == _ENTRY_SAMPLES and before.max() > fast)
        if clipped:
            return np.flatnonzero(values == extreme)
    return none


# --- Do voltages and readings belong together?
# Share of a reading's variance that a linear filter of the heat (V squared, lags of 0.2 to 64 s)
# explains, with the voltages of the same and of another run: temperature 99.9 % and below 90 %,
# deflection (which has hysteresis) above 90 % and 60 to 90 %, elongation (under load, strokes end
# at stops) 60 to 90 % and below 50 %.

_LAGS = (0.2, 1.0, 4.0, 16.0, 64.0)  # s
_EXPLAINED = {"temperature": 0.93, "deflection": 0.7, "elongation": 0.55}
_RESPONSE_SAMPLES = 2000
_MOTION_LAGS = (0.5, 1.5, 4.0)  # s, of a motion behind the heat of its wires
_AGAINST_HEAT = 0.6  # correlation with heat, from which a motion has the wrong sign
_DELAYS = np.linspace(-1.0, 1.0, 41)  # s, tried for a current behind its voltage
_CLEARLY = 0.2  # of the residual variance without delay: the best delay leaves less
_LEAST_DRIVE, _LEAST_MISSING = 0.1, 1.0  # V, range of a voltage that drives; s
_LEAST_RESPONSE = 25.0  # variance of a reading, in variances of its noise


def check_response(record: Record) -> Iterator[Finding]:
    """Readings that do not follow their voltages: swapped, sign or clock wrong, or cut short."""
    volts = {c: f"{c}.voltage" for c in record.channels if has_samples(record, f"{c}.voltage")}
    reach = {c: float(np.ptp(samples(record, name)[1])) for c, name in volts.items()}
    driven = [channel for channel, span in reach.items() if span > _LEAST_DRIVE]
    if not driven:
        return
    responses = [n for n in record.signals if kind_of(n) in _EXPLAINED and has_samples(record, n)]
    last = max((float(samples(record, name)[0][-1]) for name in responses), default=-inf)
    for name in (volts[channel] for channel in driven):
        time, values = samples(record, name)
        missing = last - float(time[-1])
        if missing > max(_GAP_PERIODS * record[name].period, _LEAST_MISSING):
            yield finding_of("ends_early", name, missing=missing, volts=values[-1])
    # Signs of motions: of an elongation against temperature or heat, of a tip against front - back.
    if len(record.channels) == 1 and "elongation" in responses:
        time, metres = samples(record, "elongation")
        if not has_samples(record, f"{driven[0]}.temperature"):
            together = _together(record, {driven[0]: 1.0}, "elongation")
        else:
            kelvin = np.interp(time, *samples(record, f"{driven[0]}.temperature"))
            moves = np.ptp(kelvin) * np.ptp(metres)
            together = float(np.corrcoef(kelvin, metres)[0, 1]) if moves else 0.0
        if together > _AGAINST_HEAT:
            yield finding_of("lengthens", "elongation", together=together)
    if "deflection" in responses:
        sides = {c: float(c.startswith("front")) - float(c.startswith("back")) for c in driven}
        if (together := _together(record, sides, "deflection")) < -_AGAINST_HEAT:
            yield finding_of("leans", "deflection", together=together)
    for channel in driven:
        if apart := _apart(record, channel):
            yield finding_of("apart", volts[channel], apart=apart)
    for name in responses:
        kind, channel = kind_of(name), name.removesuffix(".temperature")
        if kind == "temperature" and channel not in driven:
            continue
        causes = [channel] if kind == "temperature" else driven
        share = _explained(record, [volts[cause] for cause in causes], name)
        if share is None or share >= _EXPLAINED[kind]:
            continue
        facts = {"share": max(share, 0.0), "expected": _EXPLAINED[kind], "explained": share}
        if kind == "temperature":
            others = {o: _explained(record, [volts[o]], name) or 0.0 for o in driven}
            other = max(others, key=lambda o: others[o])
            # A wire that is hardly driven may really be warmed by the others.
            if others[other] >= _EXPLAINED[kind] and reach[channel] > 0.5 * reach[other]:
                yield finding_of("swapped", name, other=other, follows=others[other], **facts)
                continue
        yield finding_of("unexplained", name, **facts)


def _heat(record: Record, voltage: str, grid: Array) -> Array:
    return held_at(*samples(record, voltage), grid) ** 2


def _lagged(heat: Array, grid: Array, lags: Sequence[float] = _LAGS) -> list[Array]:
    return [first_order_lag(heat, float(np.exp(-(grid[1] - grid[0]) / lag))) for lag in lags]


def _together(record: Record, signs: dict[str, float], motion: str) -> float:
    """Correlation of a motion with the heat of wires (times `signs`), at the lag of the largest."""
    time, metres = samples(record, motion)
    grid = np.linspace(time[0], time[-1], _RESPONSE_SAMPLES)
    tip, most = np.interp(grid, time, metres), 0.0
    heat = sum((s * _heat(record, f"{c}.voltage", grid) for c, s in signs.items()), 0.0 * grid)
    for pull in _lagged(heat, grid, _MOTION_LAGS):
        if np.ptp(pull) * np.ptp(tip):
            most = max(most, float(np.corrcoef(pull, tip)[0, 1]), key=abs)
    return most


def _apart(record: Record, channel: str) -> float:
    """Delay (s) of a current behind its voltage; 0 unless clear, as resistance varies with heat."""
    if not has_samples(record, f"{channel}.current"):
        return 0.0
    stamps, volts = samples(record, f"{channel}.voltage")
    time, amperes = samples(record, f"{channel}.current")
    some = slice(None, None, max(1, len(time) // _RESPONSE_SAMPLES))
    time, amperes = time[some], amperes[some]
    grid = np.linspace(stamps[0], stamps[-1], _RESPONSE_SAMPLES)
    lagged = _lagged(_heat(record, f"{channel}.voltage", grid), grid)
    warm = [np.interp(time, grid, heat) for heat in lagged]
    conductance = np.column_stack([np.ones_like(time), *(w / max(w.max(), 1e-12) for w in warm)])
    left = []
    for delay in _DELAYS:
        own = np.interp(time - delay, stamps, volts)[:, np.newaxis] * conductance
        left.append(float(np.var(amperes - own @ np.linalg.lstsq(own, amperes, rcond=None)[0])))
    best, undelayed = int(np.argmin(left)), left[len(_DELAYS) // 2]
    least = max(CLOCK_TOLERANCE, float(np.median(np.diff(stamps))))
    clear = 0 < best < len(_DELAYS) - 1 and left[best] < _CLEARLY * undelayed
    return float(_DELAYS[best]) if clear and abs(_DELAYS[best]) > least else 0.0


def _explained(record: Record, voltages: list[str], response: str) -> float | None:
    """Share of a response's variance, without noise, that heat explains; None if it is tiny."""
    time, values = samples(record, response)
    # The longest stretch without a gap, as the heat in a gap is not known.
    clocks = [time, *(samples(record, name)[0] for name in voltages)]
    gaps = [clock[k : k + 2] for clock in clocks for k in np.flatnonzero(np.diff(clock) > max(
        _GAP_PERIODS * float(np.median(np.diff(clock))), _LEAST_MISSING))]
    begins = np.sort([max(clock[0] for clock in clocks[1:]), *(end for _, end in gaps)])
    ends = np.sort([*(begin for begin, _ in gaps), time[-1]])
    longest = np.argmax(ends - begins)
    inside = (time >= begins[longest]) & (time <= ends[longest])
    time, values = time[inside], values[inside]
    if len(values) < 2 * _FLAT_SAMPLES or not time[-1] > time[0]:
        return None
    noise = float(np.mean(np.diff(values, 2) ** 2)) / 6.0
    grid = np.linspace(time[0], time[-1], _RESPONSE_SAMPLES)
    wanted = np.interp(grid, time, values)
    if np.var(wanted) < _LEAST_RESPONSE * noise or np.ptp(wanted) == 0.0:
        return None
    columns = [np.ones_like(grid)]
    for name in voltages:
        columns += _lagged(_heat(record, name, grid), grid)
    design = np.column_stack([c / max(float(np.abs(c).max()), 1e-12) for c in columns])
    variance = float(np.var(wanted))
    if not np.isfinite(design).all() or not np.isfinite(variance):
        return None  # from voltages such as 1e200; LAPACK would print to the terminal
    residual = wanted - design @ np.linalg.lstsq(design, wanted, rcond=None)[0]
    return 1.0 - max(float(np.var(residual)) - noise, 0.0) / (variance - noise)

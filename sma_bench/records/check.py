"""What a record holds, and can it be trusted? Order, gaps, clocks, units, saturation, absences."""

from collections.abc import Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.border import read_yaml
from sma_bench.findings import Finding
from sma_bench.records.record import Record, Signal, first_order_lag, has_samples, held_at, samples

_GAP_PERIODS = 10  # of random losses ten in a row do not happen; a stalled driver does
_LOSS_TOLD, _LOSS_WARNED = 0.02, 0.2  # shares of the samples
CLOCK_TOLERANCE, DRIFT_TOLERANCE, _FUTURE_TOLERANCE = 0.1, 0.05, 0.01  # s
# Of a period that steps differ from whole ones; samples; of readings against their voltage's sign.
_IRREGULAR, _FLAT_SAMPLES, _AGAINST = 0.1, 20, 0.9
# Standard deviations, share of the usual range, that one reading is off its neighbours; most such.
_OUTLYING, _OUT_OF_RANGE, _MOST_OUTLIERS = 12.0, 0.05, 5
# Of the range within a sample, which neither heat nor a beam does, of all readings; of last digits.
_DROP, _MOST_DROPPED, _FEW_STEPS = 0.2, 0.1, 3
DROPS_OUT = ("temperature", "deflection", "range")
FEWEST, _TICKS = 50, 0.01  # samples; share of receive times that repeat
_ENTRY_SAMPLES, _ENTRY_FRACTION = 3, 0.01  # before a flat stretch; of the signal's range
_TEXTS: dict[str, Any] = read_yaml(Path(__file__).with_suffix(".yaml"))
_SENSE = _TEXTS.pop("sense")
_MECHANICS = ("deflection", "elongation", "force", "front.range", "back.range")


def check_record(record: Record) -> list[Finding]:
    """Everything to know before using a record, what the reader noticed included."""
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


def said(key: str, subject: str, **facts: Any) -> Finding:
    """A finding of check.yaml about a subject, with its facts."""
    severity, text, *numbers = _TEXTS[key]
    kept = {name: float(facts[name]) for name in numbers}
    return Finding(severity, subject, text.format(**facts), kept)


def kind_of(name: str) -> str:
    return name.rpartition(".")[2]


def _values(record: Record) -> Iterator[Finding]:
    """Order, missing values, those that no bench has, a reversed current sensor."""
    for name, signal in record.signals.items():
        kind, unit, off = kind_of(name), signal.unit, outliers(signal)
        steps = np.diff(signal.time)
        backward, repeated = int(np.sum(steps < 0)), int(np.sum(steps == 0))
        if backward or repeated:
            yield said("order", name, backward=backward, duplicates=repeated)
        finite = signal.values[np.isfinite(signal.values)]
        if missing := signal.values.size - len(finite):
            yield said("holes", name, count=missing, of=signal.values.size)
        if kind == "current" and (share := against_voltage(record, signal)):
            yield said("against", name, share=share)
        if len(off):  # they decide nothing
            finite = np.delete(finite, off)
            values = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            yield said("single", name, outliers=len(off), values=values, unit=unit)
        if not len(finite):
            continue
        low, high = float(finite.min()), float(finite.max())
        for key, least, most, hint in _SENSE.get(kind, ()):
            if not (least[0] <= low <= least[1] and most[0] <= high <= most[1]):
                yield said(key, name, low=low, high=high, unit=unit, hint=hint)
                break


def against_voltage(record: Record, current: Signal) -> float:
    """Share of a current's readings that have not its voltage's sign; 0 where not nearly all."""
    name = current.name.removesuffix("current") + "voltage"
    if not (has_samples(record, name) and has_samples(record, current.name)):
        return 0.0
    volts, size = np.interp(current.time, *samples(record, name)), np.abs(current.values)
    heated = (size > 0.2 * np.nanmax(size)) & (np.abs(volts) > 0.2 * np.abs(volts).max())
    if heated.sum() < 10:
        return 0.0
    share = float(np.mean(current.values[heated] * volts[heated] < 0.0))
    return share if share > _AGAINST else 0.0


def outliers(signal: Signal) -> IntArray:
    """Where single readings lie far off both neighbours, which agree, unless many do, or a sensor
    drops out for some, all of one value. Commands, voltages and currents may pulse."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    pulses = signal.name.endswith(("voltage", "voltage_command", "current"))
    if values.ndim != 1 or len(values) < FEWEST or pulses or not np.isfinite(values).all():
        return none
    off = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    apart = np.abs(values[2:] - values[:-2])
    low, high = np.quantile(values, [0.01, 0.99])
    least = max(_OUT_OF_RANGE * float(high - low), _FEW_STEPS * _resolution(values))
    least = max(_OUTLYING * float(np.median(off)) / 0.6745, least)
    found = np.flatnonzero((off > least) & (apart < 0.25 * off)) + 1 if least > 0.0 else none
    found = found if len(found) <= _MOST_OUTLIERS else none
    if kind_of(signal.name) not in DROPS_OUT:
        return found
    # One number for a while, between others that agree and are far off.
    begins = np.append(0, np.flatnonzero(np.diff(values)) + 1)
    ends = np.append(begins[1:], len(values))  # the first reading after each
    inside = (begins > 0) & (ends < len(values)) & (ends - begins > 1)
    begins, ends = begins[inside], ends[inside]
    level, before, after = values[begins], values[begins - 1], values[ends % len(values)]
    jump = np.minimum(np.abs(level - before), np.abs(level - after))
    least = max(_DROP * float(np.ptp(values)), least)
    out = (jump > least) & (np.abs(after - before) < 0.25 * jump)
    spans = [np.arange(b, e) for b, e in zip(begins[out], ends[out], strict=True)]
    dropped = np.concatenate([none, *spans])
    return np.union1d(found, dropped) if len(dropped) < _MOST_DROPPED * len(values) else found


def _resolution(values: Array) -> float:
    """The step of a reading of few digits; 0 where it has none."""
    levels = np.unique(values)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.2 * len(values) else 0.0


def _rate(record: Record) -> Iterator[Finding]:
    """Gaps and losses."""
    for name, signal in record.signals.items():
        period = signal.period
        if len(signal) < 10 or name == "voltage_command" or not period > 0:
            continue
        steps = np.diff(signal.time)
        # An irregular clock has no period that samples could be missing at.
        is_irregular = np.median(np.abs(steps / period - np.rint(steps / period))) > _IRREGULAR
        gaps = steps > _GAP_PERIODS * (np.percentile(steps, 95) if is_irregular else period)
        if gaps.any():
            k = int(np.argmax(steps))
            longest = {"longest": steps[k], "at": signal.time[k], "periods": _GAP_PERIODS}
            yield said("gaps", name, gaps=int(gaps.sum()), **longest)
        lost = float(np.sum(np.maximum(np.rint(steps[~gaps] / period) - 1, 0)))
        share = lost / (lost + len(signal))
        if is_irregular:
            yield said("irregular", name, rate=(len(steps) - gaps.sum()) / steps[~gaps].sum())
        elif share > _LOSS_TOLD:
            key = "many_lost" if share > _LOSS_WARNED else "few_lost"
            yield said(key, name, fraction=share, percent=100 * share, hertz=1 / period)


def delays_of(record: Record) -> dict[str, tuple[float, float]]:
    """Median of receive time minus stamp and its growth over the record, in s by signal; none of a
    simulated clock, whose ticks tell how busy the computer was."""
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
    """Topics whose receive times minus stamps differ from the others' or drift."""
    of_signals = delays_of(record).items()
    delays = {record[name].topic or name: d for name, d in of_signals if name != "voltage_command"}
    common, common_drift = np.median([*delays.values()] or [(0.0, 0.0)], axis=0).tolist()
    if abs(common_drift) > DRIFT_TOLERANCE:
        yield said("drifts", "record", drift=common_drift)
    for topic, (median, growth) in delays.items():
        offset, drift = median - common, growth - common_drift
        if abs(offset) > CLOCK_TOLERANCE:
            yield said("clock_off", topic, offset=offset, own=median, common=common)
        elif abs(drift) > DRIFT_TOLERANCE:
            yield said("clock_drifts", topic, drift=drift)
        elif -1.0 < median < -_FUTURE_TOLERANCE:
            yield said("future", topic, ahead=-median, offset=median)


def _saturation(record: Record) -> Iterator[Finding]:
    """Sensors that are dead while something happens, or clipped at their highest or lowest."""
    voltages = [s.values for n, s in record.signals.items() if kind_of(n) == "voltage" and len(s)]
    driven = any(np.ptp(values) > 0.1 for values in voltages)
    still, force = {"ambient.temperature"}, record.get("force")
    if force is not None and len(force) and np.ptp(force.values) > 0:
        still.add("elongation")  # clamped
    for name, signal in record.signals.items():
        values, kind = signal.values, kind_of(name)
        is_short = len(values) < _FLAT_SAMPLES * 2
        if kind in ("voltage", "voltage_command") or is_short or not np.isfinite(values).all():
            continue
        if np.ptp(values) == 0:
            if driven and kind != "current" and name not in still:
                yield said("dead", name, value=values[0], unit=signal.unit)
            continue
        for extreme, word in ((float(values.max()), "highest"), (float(values.min()), "lowest")):
            if count := len(clipped_samples(record, signal, extreme)):
                facts = {"value": extreme, "word": word, "unit": signal.unit}
                yield said("clipped", name, samples=count, **facts)


def clipped_samples(record: Record, signal: Signal, extreme: float) -> IntArray:
    """All samples at an extreme where a sensor ends: it has a flat stretch that the signal ran
    into at speed or whose noise would not let it be flat; of a current, while its voltage moves."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    if extreme == values[0] and signal.name in _MECHANICS:
        return none  # at rest, where it began
    # Differences of noise grow with their order, those of a course that is smooth shrink.
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
            # A reading of few digits stays flat by itself, and enters by its own step.
            fast = max(_ENTRY_FRACTION * np.ptp(values), 2.0 * _resolution(values))
            clipped = noisy or (len(before) == _ENTRY_SAMPLES and before.max() > fast)
        if clipped:
            return np.flatnonzero(values == extreme)
    return none


# --- Do command and response belong together?
# A linear filter of the heat (V squared through lags of 0.2 to 64 s) explains 99.9 % of a
# temperature that its voltage made, and less than 90 % where the voltages of one run stand beside
# the readings of another; of a motion, which has hysteresis, 90 % and more against 60 to 90 %; of a
# wire with a load, whose strokes end at stops, 60 to 90 % against below 50 %.

_LAGS = (0.2, 1.0, 4.0, 16.0, 64.0)  # s
_EXPLAINED = {"temperature": 0.93, "deflection": 0.7, "elongation": 0.55}
_RESPONSE_SAMPLES = 2000
_FOLLOWS = (0.5, 1.5, 4.0)  # s, after which a motion follows the heat of its wires
_LENGTHENS = 0.6  # correlation of a motion with the heat that it runs against
_LATE, _CLEARLY = np.linspace(-1.0, 1.0, 41), 0.2  # s; of the variance that is left
_LEAST_DRIVE, _LEAST_MISSING, _LEAST_RESPONSE = 0.1, 1.0, 25.0  # V; s; variance over noise's


def check_response(record: Record) -> Iterator[Finding]:
    """Readings that do not follow their voltages: swapped, of other clocks, or cut short."""
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
            yield said("ends_early", name, missing=missing, volts=values[-1])
    # Motions against the heat, of a wire (or its temperature), or of front less back for a tip.
    if len(record.channels) == 1 and "elongation" in responses:
        time, metres = samples(record, "elongation")
        if not has_samples(record, f"{driven[0]}.temperature"):
            together = _together(record, {driven[0]: 1.0}, "elongation")
        else:
            kelvin = np.interp(time, *samples(record, f"{driven[0]}.temperature"))
            moves = np.ptp(kelvin) * np.ptp(metres)
            together = float(np.corrcoef(kelvin, metres)[0, 1]) if moves else 0.0
        if together > _LENGTHENS:
            yield said("lengthens", "elongation", together=together)
    if "deflection" in responses:
        sides = {c: float(c.startswith("front")) - float(c.startswith("back")) for c in driven}
        if (together := _together(record, sides, "deflection")) < -_LENGTHENS:
            yield said("leans", "deflection", together=together)
    for channel in driven:
        if apart := _apart(record, channel):
            yield said("apart", volts[channel], apart=apart)
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
            # A wire that is hardly driven is warmed by the others.
            if others[other] >= _EXPLAINED[kind] and reach[channel] > 0.5 * reach[other]:
                yield said("swapped", name, other=other, follows=others[other], **facts)
                continue
        yield said("unexplained", name, **facts)


def _heat(record: Record, voltage: str, grid: Array) -> Array:
    return held_at(*samples(record, voltage), grid) ** 2


def _lagged(course: Array, grid: Array, lags: Sequence[float] = _LAGS) -> list[Array]:
    return [first_order_lag(course, float(np.exp(-(grid[1] - grid[0]) / lag))) for lag in lags]


def _together(record: Record, signs: dict[str, float], motion: str) -> float:
    """Correlation of a motion with the heat of wires, by their signs, as long ago as it is most."""
    time, metres = samples(record, motion)
    grid = np.linspace(time[0], time[-1], _RESPONSE_SAMPLES)
    tip, most = np.interp(grid, time, metres), 0.0
    heat = sum((s * _heat(record, f"{c}.voltage", grid) for c, s in signs.items()), 0.0 * grid)
    for pull in _lagged(heat, grid, _FOLLOWS):
        if np.ptp(pull) * np.ptp(tip):
            most = max(most, float(np.corrcoef(pull, tip)[0, 1]), key=abs)
    return most


def _apart(record: Record, channel: str) -> float:
    """s from a voltage to its current, 0 where a resistance that heat changes explains as much."""
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
    for late in _LATE:
        own = np.interp(time - late, stamps, volts)[:, np.newaxis] * conductance
        left.append(float(np.var(amperes - own @ np.linalg.lstsq(own, amperes, rcond=None)[0])))
    best, usual = int(np.argmin(left)), left[len(_LATE) // 2]
    least = max(CLOCK_TOLERANCE, float(np.median(np.diff(stamps))))
    clear = 0 < best < len(_LATE) - 1 and left[best] < _CLEARLY * usual
    return float(_LATE[best]) if clear and abs(_LATE[best]) > least else 0.0


def _explained(record: Record, voltages: list[str], response: str) -> float | None:
    """Share of a response's variance, but noise, that lagged heat explains; None for too little."""
    time, values = samples(record, response)
    start = max(float(samples(record, name)[0][0]) for name in voltages)
    time, values = time[time >= start], values[time >= start]
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
        return None  # readings that no bench has; LAPACK would write on the terminal
    residual = wanted - design @ np.linalg.lstsq(design, wanted, rcond=None)[0]
    return 1.0 - max(float(np.var(residual)) - noise, 0.0) / (variance - noise)

"""What a record holds, and can it be trusted? Order, gaps, clocks, units, saturation, absences; and
what of it is mended before a model is fitted to it."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.border import read_yaml
from sma_bench.findings import Finding
from sma_bench.records.record import Record, Signal, first_order_lag, has_samples, samples

# At 5 % random losses ten in a row do not happen; a stalled driver does.
_GAP_PERIODS = 10
_LOSS_TOLD, _LOSS_WARNED = 0.02, 0.2  # shares of the samples
_CLOCK_TOLERANCE, _DRIFT_TOLERANCE, _FUTURE_TOLERANCE = 0.1, 0.05, 0.01  # s
# s; a step of a protocol is longer, a delay that grows at once shrinks with every message.
_JUMP, _TURN, _FEW_TURNS = 0.5, 1.0, 5
_IRREGULAR = 0.1  # of a period that steps differ from whole ones
_FLAT_SAMPLES = 20
_AGAINST = 0.9  # of a current's readings that have not its voltage's sign
# Standard deviations, and share of the usual range, that a single reading lies off both beside it;
# most of them in a record, as more are a sensor's way.
_OUTLYING, _OUT_OF_RANGE, _MOST_OUTLIERS = 12.0, 0.05, 5
# Of the range within a sample, which neither heat nor a beam does, and of all readings.
_DROP, _MOST_DROPPED = 0.2, 0.1
_DROPS_OUT = ("temperature", "deflection", "range")
_FEW_STEPS = 3  # of the reading's last digit
_FEWEST, _TICKS = 50, 0.01  # samples; share of receive times that repeat
# Of a sensor's readings, each published as often as the others; times, from which once more or less
# can be told from chance.
_STEADY, _TWO_CLOCKS = 0.95, 5
_IMPOSED = ("voltage", "elongation")
_ENTRY_SAMPLES, _ENTRY_FRACTION = 3, 0.01  # before a flat stretch; of the signal's range

_TEXTS: dict[str, Any] = read_yaml(Path(__file__).with_suffix(".yaml"))
_SENSE = _TEXTS.pop("sense")
_MECHANICS = ("deflection", "elongation", "force", "front.range", "back.range")
_EVENTS = ("voltage_command",)
_READ = ("temperature", "elongation", "deflection", "force")
_FEWEST_LEVELS, _MOST_LEVELS, _SAMPLES_A_LEVEL = 3, 100, 5  # of a coarse reading


def check_record(record: Record) -> list[Finding]:
    """Everything to know before using a record, what the reader noticed included."""
    found = list(record.findings)
    for channel in record.channels:
        for kind in ("voltage", "current", "temperature"):
            if f"{channel}.{kind}" not in record.signals:
                found.append(Finding("info", f"{channel}.{kind}", "absent from the record"))
    if record.signals and not record.channels:
        text = "no channel: neither voltages nor temperatures"
        found.append(Finding("warning", "record", text))
    if record.signals and not any(name in record.signals for name in _MECHANICS):
        text = f"no mechanical signal ({', '.join(_MECHANICS)})"
        found.append(Finding("info", "record", text))
    for check in (_values, _rate, _clocks, _saturation, check_response):
        found += check(record)
    return found


def _said(key: str, subject: str, **facts: Any) -> Finding:
    """A finding of check.yaml about a subject, with its facts."""
    severity, text, *numbers = _TEXTS[key]
    kept = {name: float(facts[name]) for name in numbers}
    return Finding(severity, subject, text.format(**facts), kept)


def _kind(name: str) -> str:
    return name.rpartition(".")[2]


def _values(record: Record) -> Iterator[Finding]:
    """Order and missing values, of records made in memory (a bag's are sorted out when they get
    here), values that no bench has, a reversed current sensor, and coarse steps."""
    for name, signal in record.signals.items():
        kind, unit, off = _kind(name), signal.unit, _outliers(signal)
        steps = np.diff(signal.time)
        backward, repeated = int(np.sum(steps < 0)), int(np.sum(steps == 0))
        if backward or repeated:
            yield _said("order", name, backward=backward, duplicates=repeated)
        finite = signal.values[np.isfinite(signal.values)]
        levels = np.unique(finite)
        if missing := signal.values.size - len(finite):
            yield _said("holes", name, count=missing, of=signal.values.size)
        if kind == "current" and (share := _against_voltage(record, signal)):
            yield _said("against", name, share=share)
        if len(off):  # they decide nothing
            finite = np.delete(finite, off)
            values = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            yield _said("single", name, outliers=len(off), values=values, unit=unit)
        if not len(finite):
            continue
        low, high = float(finite.min()), float(finite.max())
        for key, least, most, hint in _SENSE.get(kind, ()):
            if not (least[0] <= low <= least[1] and most[0] <= high <= most[1]):
                yield _said(key, name, low=low, high=high, unit=unit, hint=hint)
                break
        if kind in _READ and _FEWEST_LEVELS < len(levels) < _MOST_LEVELS:
            step = float(np.diff(levels).min())
            apart = np.diff(levels) / step
            is_even = np.abs(apart - np.rint(apart)).max() < _IRREGULAR
            if is_even and len(signal) > _SAMPLES_A_LEVEL * len(levels):
                facts = {"unit": unit, "levels": len(levels), "of": len(signal)}
                yield _said("coarse", name, resolution=step, **facts)


def _against_voltage(record: Record, current: Signal) -> float:
    """Share of a current's readings, of those worth the name, that have not its voltage's sign; 0
    where that is not nearly all."""
    name = current.name.removesuffix("current") + "voltage"
    if not (has_samples(record, name) and has_samples(record, current.name)):
        return 0.0
    volts = np.interp(current.time, *samples(record, name))
    size = np.abs(current.values)
    heated = (size > 0.2 * np.nanmax(size)) & (np.abs(volts) > 0.2 * np.abs(volts).max())
    if heated.sum() < 10:
        return 0.0
    share = float(np.mean(current.values[heated] * volts[heated] < 0.0))
    return share if share > _AGAINST else 0.0


def _outliers(signal: Signal) -> IntArray:
    """Where single readings of a sensor lie far off both neighbours, which agree, none where there
    are more of them than a mishap makes; and where it drops out for some, all of one value. A
    command, a voltage and its current may pulse, and what a machine imposes."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    pulses = signal.name.endswith(("voltage", "voltage_command", "current"))
    if values.ndim != 1 or len(values) < _FEWEST or pulses or not np.isfinite(values).all():
        return none
    off = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    apart = np.abs(values[2:] - values[:-2])
    low, high = np.quantile(values, [0.01, 0.99])
    # A reading of few digits flickers by a step.
    least = max(
        _OUTLYING * float(np.median(off)) / 0.6745, _OUT_OF_RANGE * float(high - low),
        _FEW_STEPS * _resolution(values),
    )
    found = np.flatnonzero((off > least) & (apart < 0.25 * off)) + 1 if least > 0.0 else none
    found = found if len(found) <= _MOST_OUTLIERS else none
    return np.union1d(found, _dropouts(values)) if _kind(signal.name) in _DROPS_OUT else found


def _dropouts(values: Array) -> IntArray:
    """Where (n,) readings are one number for a while, between others that agree and are far off."""
    begins = np.append(0, np.flatnonzero(np.diff(values)) + 1)
    ends = np.append(begins[1:], len(values))  # the first reading after each
    inside = (begins > 0) & (ends < len(values)) & (ends - begins > 1)
    begins, ends = begins[inside], ends[inside]
    level, before, after = values[begins], values[begins - 1], values[ends % len(values)]
    jump = np.minimum(np.abs(level - before), np.abs(level - after))
    off = (jump > _DROP * float(np.ptp(values))) & (np.abs(after - before) < 0.25 * jump)
    spans = [np.arange(b, e) for b, e in zip(begins[off], ends[off], strict=True)]
    found = np.concatenate(spans) if spans else np.zeros(0, dtype=np.int64)
    return found if len(found) < _MOST_DROPPED * len(values) else found[:0]


def _resolution(values: Array) -> float:
    """The step of a reading of few digits; 0 where it has none."""
    levels = np.unique(values)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.2 * len(values) else 0.0


def _rate(record: Record) -> Iterator[Finding]:
    """Gaps and losses; signals of one clock have them in common and share a remark."""
    shared: dict[str, tuple[Finding, list[str]]] = {}
    for name, signal in record.signals.items():
        period = signal.period
        if len(signal) < 10 or name in _EVENTS or not period > 0:
            continue
        steps = np.diff(signal.time)
        # An irregular clock has no period that samples could be missing at.
        away = np.median(np.abs(steps / period - np.rint(steps / period)))
        is_irregular = bool(away > _IRREGULAR)
        gaps = steps > _GAP_PERIODS * (np.percentile(steps, 95) if is_irregular else period)
        found = []
        if gaps.any():
            k = int(np.argmax(steps))
            longest = {"longest": steps[k], "at": signal.time[k], "periods": _GAP_PERIODS}
            found.append(_said("gaps", name, gaps=int(gaps.sum()), **longest))
        lost = float(np.sum(np.maximum(np.rint(steps[~gaps] / period) - 1, 0)))
        share = lost / (lost + len(signal))
        if is_irregular:
            rate = (len(steps) - gaps.sum()) / steps[~gaps].sum()
            found.append(_said("irregular", name, rate=rate))
        elif share > _LOSS_TOLD:
            key = "many_lost" if share > _LOSS_WARNED else "few_lost"
            found.append(_said(key, name, fraction=share, percent=100 * share, hertz=1 / period))
        for finding in found:
            shared.setdefault(finding.text, (finding, []))[1].append(name)
    for finding, names in shared.values():
        beside = f"; of {', '.join(names[1:])} too" if names[1:] else ""
        yield replace(finding, text=finding.text + beside)


def _delays(record: Record) -> dict[str, tuple[float, float]]:
    """Median of receive time minus stamp, and its growth from the first tenth to the last, in s by
    signal; none where the recorder's clock was a simulated one, whose ticks come again and again
    and tell how busy the computer was."""
    received = {n: s.received for n, s in record.signals.items()
                if s.received is not None and len(s.received) == len(s) > 0}
    ticks = [np.mean(np.diff(r) < 1e-9) for r in received.values() if len(r) >= _FEWEST]
    found = {}
    for name, times in received.items() if max(ticks, default=0.0) <= _TICKS else ():
        delay, tenth = times - record[name].time, max(1, len(times) // 10)
        growth = float(np.median(delay[-tenth:]) - np.median(delay[:tenth]))
        found[name] = float(np.median(delay)), growth
    return found


def _clocks(record: Record) -> Iterator[Finding]:
    """Topics whose receive times minus stamps differ from the others', or drift against them; and
    what a second publisher of /clock leaves behind: a run or a recorder in two times."""
    delays = {
        record[name].topic or name: delay
        for name, delay in _delays(record).items() if name not in _EVENTS
    }
    common, common_drift = np.median([*delays.values()] or [(0.0, 0.0)], axis=0).tolist()
    if abs(common_drift) > _DRIFT_TOLERANCE:
        yield _said("drifts", "record", drift=common_drift)
    for topic, (median, growth) in delays.items():
        offset, drift = median - common, growth - common_drift
        if abs(offset) > _CLOCK_TOLERANCE:
            yield _said("clock_off", topic, offset=offset, own=median, common=common)
        elif abs(drift) > _DRIFT_TOLERANCE:
            yield _said("clock_drifts", topic, drift=drift)
        elif -1.0 < median < -_FUTURE_TOLERANCE:
            yield _said("future", topic, ahead=-median, offset=median)
    for signal in record.signals.values():
        if signal.received is None:
            continue
        # One clock, however late its ticks are heard, never goes back.
        steps, back = np.diff(signal.received - signal.time), np.diff(signal.received)
        jumps = np.abs(steps[np.abs(steps) > _JUMP])
        turns = min(int(np.sum(steps > _JUMP)), int(np.sum(back < -_JUMP)))
        if turns > _FEW_TURNS:
            topic = signal.topic or signal.name
            yield _said("two_clocks", topic, turns=turns, jump=np.median(jumps))
    between = zip(record.markers, record.markers[1:], record.markers[2:], strict=False)
    turns = sum(a[1] == c[1] != b[1] and c[0] - a[0] < _TURN for a, b, c in between)
    # Where stamps keep pace with a recorder that no ticks have driven there is no /clock.
    if turns > _FEW_TURNS and not (delays and abs(common_drift) <= _DRIFT_TOLERANCE):
        facts = {"steps": len(record.markers), "within": _TURN}
        yield _said("two_runs", "experiment/marker", turns=turns, **facts)


def _saturation(record: Record) -> Iterator[Finding]:
    """Sensors that are dead while something happens, or clipped at their highest or lowest."""
    voltages = [s.values for n, s in record.signals.items() if _kind(n) == "voltage" and len(s)]
    driven = any(np.ptp(values) > 0.1 for values in voltages)
    still = {"ambient.temperature"}
    force = record.get("force")
    if force is not None and len(force) and np.ptp(force.values) > 0:
        still.add("elongation")  # clamped
    for name, signal in record.signals.items():
        values, kind = signal.values, _kind(name)
        if kind in ("voltage", "voltage_command") or len(values) < _FLAT_SAMPLES * 2:
            continue
        if not np.isfinite(values).all():
            continue
        if np.ptp(values) == 0:
            if driven and kind != "current" and name not in still:
                yield _said("dead", name, value=values[0], unit=signal.unit)
            continue
        for extreme, word in ((float(values.max()), "highest"), (float(values.min()), "lowest")):
            if extreme == values[0] and name in _MECHANICS:
                continue  # at rest, where it began
            if clipped := _clipped_samples(record, signal, extreme):
                facts = {"value": extreme, "word": word, "unit": signal.unit}
                yield _said("clipped", name, samples=clipped, **facts)


def _clipped_samples(record: Record, signal: Signal, extreme: float) -> int:
    """Samples in flat stretches at an extreme that the signal ran into at speed.

    A signal that settles slows down before; one that is clipped does not. Leaving it at speed is
    what a plateau without noise does when the drive ends. A current jumps with its voltage, so for
    it flat means flat while the voltage moves.
    """
    values, total = signal.values, 0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], values == extreme, [False]))))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if stop - start < _FLAT_SAMPLES:
            continue
        if _kind(signal.name) == "current":
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
            clipped = len(before) == _ENTRY_SAMPLES and before.max() > fast
        total += (stop - start) * bool(clipped)
    return total


# --- Do command and response belong together?
#
# A linear filter of the heat (V squared through lags of 0.2 to 64 s) explains 99.9 % of a
# temperature that its voltage made, and less than 90 % where the voltages of one run stand beside
# the readings of another; of a motion, which has hysteresis, 90 % and more against 60 to 90 %; of a
# wire with a load, whose strokes end at stops, 60 to 90 % against below 50 %.

_LAGS = (0.2, 1.0, 4.0, 16.0, 64.0)  # s
_EXPLAINED = {"temperature": 0.93, "deflection": 0.7, "elongation": 0.55}
_RESPONSE_SAMPLES = 2000
_LENGTHENS = 0.7  # correlation of an elongation with the wire's temperature
_LEAST_DRIVE = 0.1  # V
_LEAST_MISSING = 1.0  # s
_LEAST_RESPONSE = 25.0  # variance over that of the noise


def check_response(record: Record) -> Iterator[Finding]:
    """Readings that do not follow the voltages beside them: stored runs swapped, channels swapped,
    or clocks apart by more than the wire takes to warm; or that go on when these have ended."""
    driven = [
        channel
        for channel in record.channels
        if has_samples(record, f"{channel}.voltage")
        and np.ptp(samples(record, f"{channel}.voltage")[1]) > _LEAST_DRIVE
    ]
    if not driven:
        return

    # Voltages that end before the readings.
    responses = [n for n in record.signals if _kind(n) in _EXPLAINED and has_samples(record, n)]
    last = max((float(samples(record, name)[0][-1]) for name in responses), default=-inf)
    for name in (f"{channel}.voltage" for channel in driven):
        time, volts = samples(record, name)
        missing = last - float(time[-1])
        if missing > max(_GAP_PERIODS * record[name].period, _LEAST_MISSING):
            yield _said("ends_early", name, missing=missing, volts=volts[-1])

    # Readings that do not follow, and a motion that follows the heat the wrong way.
    hot = f"{driven[0]}.temperature"
    if len(record.channels) == 1 and has_samples(record, "elongation") and hot in responses:
        time, metres = samples(record, "elongation")
        kelvin = np.interp(time, *samples(record, hot))
        together = np.corrcoef(kelvin, metres)[0, 1] if np.ptp(kelvin) * np.ptp(metres) else 0.0
        if together > _LENGTHENS:
            yield _said("lengthens", "elongation", together=together)
    for name in responses:
        kind, channel = _kind(name), name.removesuffix(".temperature")
        if kind == "temperature" and channel not in driven:
            continue
        causes = [channel] if kind == "temperature" else driven
        share = _explained(record, [f"{cause}.voltage" for cause in causes], name)
        if share is not None and share < _EXPLAINED[kind]:
            facts = {"share": max(share, 0.0), "expected": _EXPLAINED[kind]}
            yield _said("unexplained", name, explained=share, **facts)


def _explained(record: Record, voltages: list[str], response: str) -> float | None:
    """Share of a response's variance, its noise apart, that lagged heat explains; None where there
    is too little of it to tell."""
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
        stamps, volts = samples(record, name)
        heat = volts[np.clip(np.searchsorted(stamps, grid, side="right") - 1, 0, None)] ** 2
        for lag in _LAGS:
            columns.append(first_order_lag(heat, float(np.exp(-(grid[1] - grid[0]) / lag))))
    design = np.column_stack([c / max(float(np.abs(c).max()), 1e-12) for c in columns])
    if not np.isfinite(design).all() or not np.isfinite(np.var(wanted)):
        return None  # readings that no bench has; LAPACK would write on the terminal
    residual = wanted - design @ np.linalg.lstsq(design, wanted, rcond=None)[0]
    unexplained = max(float(np.var(residual)) - noise, 0.0)
    return 1.0 - unexplained / (float(np.var(wanted)) - noise)


# --- Before a model is fitted: what can be mended, and signals under suspicion.

# s. A camera's picture takes up to a second on its way, with a right stamp: no reason to move it.
# s, for which a computer may be busy with a message; none has one before its stamp.
_MOVED = 1.0
_BELIEVED = 0.1  # of the scatter, least of a stated deviation
# Share of readings that lie this near, of the range, to one of two values; jumps between these;
# samples that the briefer of two levels is held.
_SHARE, _NEAR, _TURNS, _BRIEF = 0.98, 0.05, 20, 2.5
_SUSPECT = {"value", "drift", "turns", "common"}  # of the numbers of a finding


def _published_again(signal: Signal) -> IntArray:
    """Where readings are what the sensor read before, published again at a fixed rate; none where
    that is not told from a reading of few digits, or of what is imposed, which may be held."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    if values.ndim != 1 or len(values) < _FEWEST or _kind(signal.name).startswith(_IMPOSED):
        return none
    new = np.flatnonzero(np.diff(values) != 0.0)
    times = np.diff(new)
    if len(times) < _FEWEST:
        return none
    # Whole multiples, as a sensor may read the same twice; of two clocks now and then one more.
    usual = int(np.quantile(times, 0.1, method="lower"))
    off = np.abs(times - usual * np.rint(times / usual)) > (usual >= _TWO_CLOCKS)
    steady = usual > 1 and np.mean(~off) > _STEADY
    if not steady:
        return none
    # A stretch of one value is so many readings, the first of which come in even parts of it.
    begins = np.append(0, new + 1)
    length = np.diff(np.append(begins, len(values)))
    stretch = np.repeat(np.arange(len(begins)), length)
    count, place = np.maximum(np.rint(length / usual), 1)[stretch], np.arange(len(values))
    part = (place - begins[stretch]) * count // length[stretch]
    return np.flatnonzero((np.diff(part) == 0.0) & (np.diff(stretch) == 0)) + 1


def mended(record: Record) -> tuple[Record, list[Finding]]:
    """The record without what is known to be wrong of it, and what that was: clocks that lie a
    constant time off the drive's, over a second behind or ahead of their messages, are moved onto
    it, by when the recorder got these, currents that run against their voltage are turned, and
    readings far off their neighbours, or published again, and deviations far below a reading's
    scatter, are left out."""
    moved: dict[str, Signal] = {}
    found: list[Finding] = []
    for name, signal in record.signals.items():
        if name.endswith(".current") and (share := _against_voltage(record, signal)):
            moved[name] = signal = replace(signal, values=-signal.values)
            found.append(_said("turned", name, share=share))
        if len(again := _published_again(signal)):
            times = len(signal) / (len(signal) - len(again))
            moved[name] = signal = _without(signal, again)
            found.append(_said("again", name, times=times))
        if len(off := _outliers(signal)):
            shown = ", ".join(dict.fromkeys(f"{signal.values[i]:.4g}" for i in off.tolist()))
            moved[name] = signal = _without(signal, off)
            facts = {"values": shown, "unit": signal.unit}
            found.append(_said("left_out", name, outliers=len(off), **facts))
        if signal.std is None or len(signal) < _FEWEST:
            continue
        stated = float(np.median(signal.std))
        scatter = float(np.median(np.abs(np.diff(signal.values, 2)))) / 0.6745 / np.sqrt(6.0)
        if 0.0 < stated < _BELIEVED * scatter:
            moved[name] = replace(signal, std=None)
            facts = {"scatter": scatter, "unit": signal.unit}
            found.append(_said("understated", name, stated=stated, **facts))
    delays = _delays(record)
    drive = next((n for n in delays if n.endswith(".voltage")), None)
    for name, (delay, growth) in delays.items() if drive else ():
        late = delay - delays[str(drive)][0]
        is_off = late > _MOVED or late < -_CLOCK_TOLERANCE
        if is_off and abs(growth) < _DRIFT_TOLERANCE:
            own = moved.get(name, record.signals[name])
            moved[name] = replace(own, time=own.time + late)
            found.append(_said("clock_moved", name, offset=late, drive=drive))
    return replace(record, signals=record.signals | moved), found


def _without(signal: Signal, which: IntArray) -> Signal:
    left: dict[str, Any] = {
        field: np.delete(values, which) for field in ("time", "values", "received", "std")
        if (values := getattr(signal, field)) is not None
    }
    return replace(signal, **left)


def under_suspicion(record: Record) -> Iterator[Finding]:
    """Signals whose readings are not what they seem: clipped, of two values, on a clock that
    drifts, jumps or lies off the others'. The subject is the signal's name."""
    by_topic = {s.topic: n for n, s in record.signals.items() if s.topic}
    for finding in check_record(record):
        if finding.severity != "info" and _SUSPECT & set(finding.numbers):
            name = by_topic.get(finding.subject, finding.subject)
            if name in record.signals:
                yield replace(finding, subject=name)

    # Readings that jump between two values; a drive switched on purpose holds its level for long.
    for name, signal in record.signals.items():
        values = signal.values
        if not name.endswith((".voltage", ".current")) or len(values) < _FEWEST:
            continue
        span = float(np.ptp(values))
        if not span > 0.0 or not np.isfinite(values).all():
            continue
        up = values > values.min() + 0.5 * span
        near = np.abs(values - np.where(up, values.max(), values.min())) < _NEAR * span
        turns = np.flatnonzero(up[1:] != up[:-1])
        held = np.diff(turns)  # samples, of the two levels in turn
        if near.mean() >= _SHARE and len(turns) >= _TURNS and (
            min(np.median(held[::2]), np.median(held[1::2])) < _BRIEF
        ):
            yield _said("two_valued", name, turns=len(turns), levels=2.0)

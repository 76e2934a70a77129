"""What a record holds, and can it be trusted? Order, gaps, clocks, units, saturation, absences."""

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.findings import Finding, Severity
from sma_bench.records import contract
from sma_bench.records.dsc import DscRecord
from sma_bench.records.isobaric import Cycle, IsobaricRecord
from sma_bench.records.open import AnyRecord
from sma_bench.records.record import (
    FloatArray,
    IntArray,
    Record,
    Signal,
    first_order_lag,
    has_samples,
    samples,
)
from sma_bench.records.tensile import TensileRecord

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
_FEW_STEPS = 3  # of the reading's last digit
_FEWEST, _TICKS = 50, 0.01  # samples; share of receive times that repeat
_ENTRY_SAMPLES, _ENTRY_FRACTION = 3, 0.01  # before a flat stretch; of the signal's range

# Kind of signal, between what its lowest and its highest value lie in SI units, and what is the
# matter where one does not. A wire at rest is at room temperature: 296 on a Celsius topic is 569 K.
_ANY = (-inf, inf)
_SENSE: tuple[tuple[str, tuple[float, float], tuple[float, float], Severity, str], ...] = (
    ("voltage", (-60.0, inf), (-inf, 60.0), "warning", "millivolts?"),
    ("voltage_command", (-60.0, inf), (-inf, 60.0), "warning", "millivolts?"),
    ("current", (-30.0, inf), (-inf, 30.0), "warning", "milliamperes?"),
    ("range", (0.0, inf), (-inf, 5.0), "warning", "millimetres?"),
    ("deflection", (-1.0, inf), (-inf, 1.0), "warning", "millimetres?"),
    ("elongation", (-1.0, inf), (-inf, 1.0), "warning", "millimetres?"),
    ("force", (-5000.0, inf), (-inf, 5000.0), "warning", "millinewtons?"),
    ("temperature", (-inf, 473.15), _ANY, "error", "the topic seems to carry kelvin, the contract "
     "(and sensor_msgs/Temperature) says Celsius"),
    ("temperature", (0.0, inf), _ANY, "error", "below absolute zero"),
    ("temperature", _ANY, (contract.COLDEST_BENCH, inf), "error", "colder than any bench; Celsius "
     "taken for kelvin, or converted twice?"),
)  # fmt: skip
_MECHANICS = ("deflection", "elongation", "force", "front.range", "back.range")
_EVENTS = ("voltage_command",)
_READ = ("temperature", "elongation", "deflection", "force")
_FEWEST_LEVELS, _MOST_LEVELS, _SAMPLES_A_LEVEL = 3, 100, 5  # of a coarse reading


def check_record(record: Record) -> list[Finding]:
    """Everything to know before using a record, what the reader noticed included."""
    found = list(record.findings)
    checks = (_absent, _values, _rate, _coarse, _clocks, _two_times, _saturation, check_response)
    for check in checks:
        found += check(record)
    return found


def _kind(name: str) -> str:
    return name.rpartition(".")[2]


def _absent(record: Record) -> Iterator[Finding]:
    if not record.signals:
        return
    for channel in record.channels:
        for kind in ("voltage", "current", "temperature"):
            if f"{channel}.{kind}" not in record.signals:
                yield Finding("info", f"{channel}.{kind}", "absent from the record")
    if not record.channels:
        yield Finding("warning", "record", "no channel: neither voltages nor temperatures")
    if not any(name in record.signals for name in _MECHANICS):
        yield Finding("info", "record", f"no mechanical signal ({', '.join(_MECHANICS)})")


def _values(record: Record) -> Iterator[Finding]:
    """Order and missing values, of records made in memory (a bag's are sorted out when they get
    here), and values that no bench has."""
    for name, signal in record.signals.items():
        steps = np.diff(signal.time)
        backward, repeated = int(np.sum(steps < 0)), int(np.sum(steps == 0))
        if backward or repeated:
            text = f"{backward} stamps go backward, {repeated} repeat the one before"
            numbers = {"backward": float(backward), "duplicates": float(repeated)}
            yield Finding("warning", name, text, numbers)
        finite = signal.values[np.isfinite(signal.values)]
        if missing := signal.values.size - len(finite):
            text = f"{missing} of {signal.values.size} values are NaN or Inf"
            yield Finding("warning", name, text, {"count": missing})
        if not missing:  # a single reading is named below, and decides nothing
            finite = np.delete(finite, outliers(signal))
        if not len(finite):
            continue
        low, high = float(finite.min()), float(finite.max())
        for kind, (low_from, low_to), (high_from, high_to), severity, hint in _SENSE:
            sensible = low_from <= low <= low_to and high_from <= high <= high_to
            if kind == _kind(name) and not sensible:
                text = f"{low:.4g} to {high:.4g} {signal.unit} is beyond belief: {hint}"
                yield Finding(severity, name, text, {"low": low, "high": high})
                break


def _mishaps(record: Record) -> Iterator[Finding]:
    """Currents of a reversed sensor, and single readings that no neighbour agrees with."""
    for name, signal in record.signals.items():
        if _kind(name) == "current" and (share := against_voltage(record, signal)):
            text = f"runs against its voltage in {share:.0%} of its readings: sensor leads swapped?"
            yield Finding("warning", name, text, {"share": share})
        if len(off := outliers(signal)):
            values = ", ".join(f"{signal.values[i]:.4g}" for i in off.tolist())
            text = f"{len(off)} single readings far off those beside them: {values} {signal.unit}"
            yield Finding("warning", name, text, {"outliers": float(len(off))})


def against_voltage(record: Record, current: Signal) -> float:
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


def outliers(signal: Signal) -> IntArray:
    """Where single readings of a sensor lie far off both beside them, which agree; none where there
    are more of them than a mishap makes. A command, a voltage and its current may pulse."""
    values, none = signal.values, np.zeros(0, dtype=np.int64)
    pulses = signal.name.endswith(("voltage", "voltage_command", "current"))
    if values.ndim != 1 or len(values) < _FEWEST or pulses or not np.isfinite(values).all():
        return none
    beside = 0.5 * (values[:-2] + values[2:])
    off, apart = np.abs(values[1:-1] - beside), np.abs(values[2:] - values[:-2])
    scatter = float(np.median(off)) / 0.6745
    low, high = np.quantile(values, [0.01, 0.99])
    # A reading of few digits flickers by a step.
    steps = _FEW_STEPS * _resolution(values)
    least = max(_OUTLYING * scatter, _OUT_OF_RANGE * float(high - low), steps)
    found = np.flatnonzero((off > least) & (apart < 0.25 * off)) + 1 if least > 0.0 else none
    return found if len(found) <= _MOST_OUTLIERS else none


def _rate(record: Record) -> Iterator[Finding]:
    """Gaps and losses; signals of one clock have them in common and share a remark."""
    shared: dict[str, tuple[Finding, list[str]]] = {}
    for signal in record.signals.values():
        period = signal.period
        if len(signal) < 10 or signal.name in _EVENTS or not period > 0:
            continue
        steps = np.diff(signal.time)
        # An irregular clock has no period that samples could be missing at.
        away = np.median(np.abs(steps / period - np.rint(steps / period)))
        is_irregular = bool(away > _IRREGULAR)
        gaps = steps > _GAP_PERIODS * (np.percentile(steps, 95) if is_irregular else period)
        found = []
        if gaps.any():
            longest = int(np.argmax(steps))
            text = (
                f"{int(gaps.sum())} gaps of more than {_GAP_PERIODS} periods, the longest "
                f"{steps[longest]:.3g} s at t = {signal.time[longest]:.3f} s"
            )
            numbers = {"gaps": float(gaps.sum()), "longest": float(steps[longest])}
            found.append(Finding("warning", signal.name, text, numbers))
        if is_irregular:
            mean = (len(steps) - gaps.sum()) / steps[~gaps].sum()
            text = f"irregular: {mean:.3g} Hz in the mean"
            found.append(Finding("info", signal.name, text, {"rate": float(mean)}))
        lost = float(np.sum(np.maximum(np.rint(steps[~gaps] / period) - 1, 0)))
        fraction = lost / (lost + len(signal))
        if fraction > _LOSS_TOLD and not is_irregular:
            severity: Severity = "warning" if fraction > _LOSS_WARNED else "info"
            text = f"about {100 * fraction:.1f} % of the samples are missing at {1 / period:.4g} Hz"
            found.append(Finding(severity, signal.name, text, {"fraction": fraction}))
        for finding in found:
            shared.setdefault(finding.text, (finding, []))[1].append(signal.name)
    for finding, names in shared.values():
        beside = f"; of {', '.join(names[1:])} too" if names[1:] else ""
        yield replace(finding, text=finding.text + beside)


def _coarse(record: Record) -> Iterator[Finding]:
    """Readings that come in steps coarse for what they show."""
    for name, signal in record.signals.items():
        levels = np.unique(signal.values[np.isfinite(signal.values)])
        if _kind(name) not in _READ or not _FEWEST_LEVELS < len(levels) < _MOST_LEVELS:
            continue
        step = float(np.diff(levels).min())
        multiples = np.diff(levels) / step
        if len(signal) > _SAMPLES_A_LEVEL * len(levels) and (
            np.abs(multiples - np.rint(multiples)).max() < _IRREGULAR
        ):
            text = f"resolution {step:.3g} {signal.unit}: {len(levels)} values of {len(signal)}"
            yield Finding("info", name, text, {"resolution": step})


def receive_delays(record: Record) -> dict[str, FloatArray]:
    """Receive time minus stamp (n,) s by signal; none where the recorder's clock was a simulated
    one, whose ticks come again and again and tell how busy the computer was."""
    delays = {
        name: signal.received - signal.time
        for name, signal in record.signals.items()
        if signal.received is not None and len(signal.received) == len(signal) > 0
    }
    ticks = [
        float(np.mean(np.diff(record[name].time + delay) < 1e-9))
        for name, delay in delays.items() if len(delay) >= _FEWEST
    ]
    return {} if max(ticks, default=0.0) > _TICKS else delays


def _clocks(record: Record) -> Iterator[Finding]:
    """Topics whose receive times minus stamps differ from the others', or drift against them."""
    delays: dict[str, tuple[float, float]] = {}  # median, growth from first to last tenth
    for name, delay in receive_delays(record).items():
        if name not in _EVENTS:
            tenth = max(1, len(delay) // 10)
            growth = float(np.median(delay[-tenth:]) - np.median(delay[:tenth]))
            delays[record[name].topic or name] = float(np.median(delay)), growth
    if not delays:
        return
    common, common_drift = (float(np.median(c)) for c in zip(*delays.values(), strict=True))
    if abs(common_drift) > _DRIFT_TOLERANCE:
        text = f"stamps and receive times drift apart by {common_drift:.3f} s over the record"
        yield Finding("info", "record", text, {"drift": common_drift})
    for topic, (median, growth) in delays.items():
        offset, drift = median - common, growth - common_drift
        if abs(offset) > _CLOCK_TOLERANCE:
            text = (
                f"its clock is {offset:+.3f} s off the other topics' (receive time minus stamp is "
                f"{median:.3f} s, elsewhere {common:.3f} s)"
            )
            yield Finding("warning", topic, text, {"offset": offset})
        elif abs(drift) > _DRIFT_TOLERANCE:
            text = f"its clock drifts by {drift:+.3f} s against the other topics' over the record"
            yield Finding("warning", topic, text, {"drift": drift})
        elif -1.0 < median < -_FUTURE_TOLERANCE:
            text = f"stamps lie {-median:.3f} s after the messages were received"
            yield Finding("warning", topic, text, {"offset": median})


def _two_times(record: Record) -> Iterator[Finding]:
    """What a second publisher of /clock leaves behind: a run or a recorder in two times."""
    for signal in record.signals.values():
        if signal.received is None:
            continue
        steps = np.diff(signal.received - signal.time)
        jumps = np.abs(steps[np.abs(steps) > _JUMP])
        turns = min(int(np.sum(steps > _JUMP)), int(np.sum(steps < -_JUMP)))
        if turns > _FEW_TURNS:
            text = (
                f"receive times jump to and fro {turns} times, by about {np.median(jumps):.3g} s: "
                "two publishers of /clock?"
            )
            yield Finding("warning", signal.topic or signal.name, text, {"turns": float(turns)})
    between = zip(record.markers, record.markers[1:], record.markers[2:], strict=False)
    turns = sum(a[1] == c[1] != b[1] and c[0] - a[0] < _TURN for a, b, c in between)
    if turns > _FEW_TURNS:
        text = (
            f"{len(record.markers)} steps, {turns} times back in the one before the last within "
            f"{_TURN:g} s: a run on two publishers of /clock?"
        )
        yield Finding("warning", "experiment/marker", text, {"turns": float(turns)})


def _saturation(record: Record) -> Iterator[Finding]:
    """Sensors that are dead while something happens, or clipped at their highest or lowest."""
    voltages = [s.values for n, s in record.signals.items() if _kind(n) == "voltage" and len(s)]
    driven = any(np.ptp(values) > 0.1 for values in voltages)
    still = {"ambient.temperature"}
    force = record.get("force")
    if force is not None and len(force) and np.ptp(force.values) > 0:
        still.add("elongation")  # clamped
    for signal in record.signals.values():
        values, kind = signal.values, _kind(signal.name)
        if kind in ("voltage", "voltage_command") or len(values) < _FLAT_SAMPLES * 2:
            continue
        if not np.isfinite(values).all():
            continue
        if np.ptp(values) == 0:
            if driven and kind != "current" and signal.name not in still:
                text = f"stays at {values[0]:.6g} {signal.unit} while the voltage changes"
                yield Finding("warning", signal.name, text, {"value": float(values[0])})
            continue
        for extreme, word in ((float(values.max()), "highest"), (float(values.min()), "lowest")):
            if extreme == values[0] and signal.name in _MECHANICS:
                continue  # at rest, where it began
            if clipped := _clipped_samples(record, signal, extreme):
                text = (
                    f"{clipped} samples are clipped at the {word} value {extreme:.6g} {signal.unit}"
                )
                numbers = {"samples": float(clipped), "value": extreme}
                yield Finding("warning", signal.name, text, numbers)


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


def _resolution(values: FloatArray) -> float:
    """The step of a reading of few digits; 0 where it has none."""
    levels = np.unique(values)
    return float(np.diff(levels).min()) if 1 < len(levels) < 0.2 * len(values) else 0.0


# --- Do command and response belong together?
#
# A linear filter of the heat (V squared through lags of 0.2 to 64 s) explains 99.9 % of a
# temperature that its voltage made, and less than 90 % where the voltages of one run stand beside
# the readings of another; of a motion, which has hysteresis, 90 % and more against 60 to 90 %; of a
# wire with a load, whose strokes end at their stops, 60 to 90 % against less than 50 %. What is
# noise counts for neither.

_LAGS = (0.2, 1.0, 4.0, 16.0, 64.0)  # s
_EXPLAINED = {"temperature": 0.93, "deflection": 0.7, "elongation": 0.55}
_RESPONSE_SAMPLES = 2000
_LEAST_DRIVE = 0.1  # V
_LEAST_MISSING = 1.0  # s
_LEAST_RESPONSE = 25.0  # variance over that of the noise


def check_response(record: Record) -> Iterator[Finding]:
    """Readings that do not follow the voltages beside them: stored runs swapped, channels swapped,
    or clocks apart by more than the wire takes to warm; or that go on when the voltages have
    ended."""
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
            text = (
                f"ends {missing:.3g} s before the last temperature or deflection, at "
                f"{volts[-1]:.3g} V: was its sensor or the recording ended early?"
            )
            yield Finding("warning", name, text, {"missing": missing, "volts": float(volts[-1])})

    # Readings that do not follow.
    for name in responses:
        kind, channel = _kind(name), name.removesuffix(".temperature")
        if kind == "temperature" and channel not in driven:
            continue
        causes = [channel] if kind == "temperature" else driven
        share = _explained(record, [f"{cause}.voltage" for cause in causes], name)
        if share is not None and share < _EXPLAINED[kind]:
            text = (
                f"follows the heat of its voltage for {max(share, 0.0):.0%} of its variance only, "
                f"expected {_EXPLAINED[kind]:.0%} or more: do command and response belong to one "
                "run (stored runs or channels swapped, clocks apart)?"
            )
            yield Finding("warning", name, text, {"explained": share})


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
    if np.var(wanted) < _LEAST_RESPONSE * noise or np.var(wanted) == 0.0:
        return None
    columns = [np.ones_like(grid)]
    for name in voltages:
        stamps, volts = samples(record, name)
        heat = volts[np.clip(np.searchsorted(stamps, grid, side="right") - 1, 0, None)] ** 2
        for lag in _LAGS:
            left = float(np.exp(-(grid[1] - grid[0]) / lag))
            columns.append(first_order_lag(heat, left))
    design = np.column_stack([c / max(float(np.abs(c).max()), 1e-12) for c in columns])
    if not np.isfinite(design).all() or not np.isfinite(np.var(wanted)):
        return None  # readings that no bench has; LAPACK would write on the terminal
    residual = wanted - design @ np.linalg.lstsq(design, wanted, rcond=None)[0]
    unexplained = max(float(np.var(residual)) - noise, 0.0)
    return 1.0 - unexplained / (float(np.var(wanted)) - noise)


# --- Everything `sma-bench info` shows


def describe(record: AnyRecord) -> dict[str, Any]:
    """What a record holds, as JSON-able data in SI units."""
    found = check_record(record) if isinstance(record, Record) else record.findings
    about: dict[str, Any] = {"kind": "bag", "path": str(record.path)}
    if isinstance(record, DscRecord):
        about |= {
            "kind": "dsc",
            "instrument": record.instrument,
            "sample": record.sample,
            "mass": record.mass,
            "endothermic_up": record.endothermic_up,
            "segments": [
                {
                    "number": segment.number,
                    "kind": segment.kind,
                    "rate": segment.rate,
                    "samples": len(segment.time),
                    "start": float(segment.time[0]),
                    "end": float(segment.time[-1]),
                    "from": float(segment.temperature[0]),
                    "to": float(segment.temperature[-1]),
                }
                for segment in record.segments
            ],
        }
    elif isinstance(record, IsobaricRecord):
        about |= {
            "kind": "isobaric",
            "stress": record.stress,
            "strain_unit": record.strain_unit,
            "branches": [
                {
                    "cycle": cycle.number,
                    "kind": branch.direction,
                    "samples": len(branch.temperature),
                    "from": float(branch.temperature[0]),
                    "to": float(branch.temperature[-1]),
                    "strain_from": float(branch.strain[0]),
                    "strain_to": float(branch.strain[-1]),
                }
                for cycle in record.cycles
                for branch in cycle.branches
            ],
            "cycles": [_standard(cycle) for cycle in record.cycles if len(cycle.branches) == 2],
        }
    elif isinstance(record, TensileRecord):
        about |= {
            "kind": "tensile",
            "temperature": record.temperature,
            "samples": len(record.strain),
            "largest_strain": float(record.strain.max()),
            "largest_stress": float(record.stress.max()),
            "is_extension": record.is_extension,
            "is_force": record.is_force,
        }
    else:
        about |= {
            "start": datetime.fromtimestamp(record.start_ns / 1e9, UTC).isoformat(),
            "start_ns": record.start_ns,
            "duration": record.duration,
            "channels": list(record.channels),
            "topics": [
                {"name": name, "type": t.type, "count": t.count, "signals": list(t.signals)}
                for name, t in record.topics.items()
            ],
            "signals": [_describe_signal(signal) for signal in record.signals.values()],
            "markers": [{"time": time, "text": text} for time, text in record.markers],
        }
    return about | {
        "findings": [finding.to_json() for finding in found], "account": account_line(record),
    }


def _standard(cycle: Cycle) -> dict[str, float]:
    """Quantities of a cycle by their names in ASTM E3097: lower and upper cycle temperature (K),
    actuation strain (what heating recovers) and residual strain (end less begin of the cycle)."""
    heating = next(b for b in cycle.branches if b.direction == "heating")
    temperatures = np.concatenate([branch.temperature for branch in cycle.branches])
    first, last = cycle.branches
    return {
        "cycle": cycle.number,
        "lower_cycle_temperature": float(temperatures.min()),
        "upper_cycle_temperature": float(temperatures.max()),
        "actuation_strain": float(heating.strain[0] - heating.strain[-1]),
        "residual_strain": float(last.strain[-1] - first.strain[0]),
    }


def account_line(record: AnyRecord) -> str:
    """What became of the rows and columns of a file, or of the messages and topics of a bag."""
    name = Path(record.path).name
    if not isinstance(record, Record):
        return f"{name}: {record.account}" if record.account else ""
    used = {n: ", ".join(t.signals) for n, t in record.topics.items() if t.signals}
    rest = ", ".join(f"{n} ({t.type}, none of the bench's)" for n, t in record.topics.items()
                     if not t.signals)  # fmt: skip
    read = sum(topic.count for topic in record.topics.values())
    taken = sum(record.topics[topic].count for topic in used)
    shown = ", ".join(f"{topic} ({signals})" for topic, signals in used.items()) or "none"
    return (
        f"{name}: {read} messages read, {taken} used; topics used: {shown}; ignored: "
        f"{rest or 'none'}"
    )


def _describe_signal(signal: Signal) -> dict[str, Any]:
    steps, finite = np.diff(signal.time), signal.values[np.isfinite(signal.values)]
    period, received = signal.period, signal.received
    about: dict[str, Any] = {
        "name": signal.name,
        "unit": signal.unit,
        "topic": signal.topic,
        "samples": len(signal),
        "rate": 1 / period if period > 0 else None,
        "jitter": float(np.subtract(*np.percentile(steps, [95, 5]))) if len(steps) else None,
        "longest_gap": float(steps.max()) if len(steps) else None,
        "delay": None if received is None else float(np.median(received - signal.time)),
        "start": float(signal.time[0]) if len(signal) else None,
        "end": float(signal.time[-1]) if len(signal) else None,
    }
    for name in ("min", "max", "mean"):
        about[name] = float(getattr(finite, name)()) if len(finite) else None
    return about

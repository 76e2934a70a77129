"""E7: E_M and E_A from tensile tests at constant temperature (Fig. 9, Table III).

Martensite: slack (the toe), a short elastic rise, detwinning at nearly constant stress, then the
elastic rise of detwinned martensite, which is the law's E_M: xi = 1 with all of eps_L in it.
Austenite: the rise before the plateau of stress-induced martensite."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from itertools import groupby
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from sma_bench.arrays import Array, IntArray
from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import inflation, scatter
from sma_bench.estimation.rig import find_pulls
from sma_bench.findings import Finding
from sma_bench.identify import fits
from sma_bench.identify.branches import Bins
from sma_bench.identify.fits import GAUGE, SYMBOLS, Line, straight_line
from sma_bench.identify.result import Experiment, refusal, remark
from sma_bench.identify.signals import about_length
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import wire_length, wire_section
from sma_bench.physics.bending import channel_section
from sma_bench.records.instruments import FEWEST_ROWS, PHASES, STEADY, Phase, TensileRecord
from sma_bench.records.record import Record, has_samples, samples

SYMBOL = {"martensite": "E_M", "austenite": "E_A"}
# Pa: martensite after detwinning 20 to 50 GPa, austenite 40 to 90 GPa in the literature.
_NITI_MODULUS = {"martensite": (17e9, 60e9), "austenite": (35e9, 100e9)}
_FINISH = {"martensite": SYMBOLS["M_f"], "austenite": SYMBOLS["A_f"]}
_PLATEAU_SLOPE, _PLATEAU_STRAIN = 0.35, 0.004  # slope over the steepest, at most; length, at least
_GRID = 240  # bins of strain
_MOST_PIECES, _SHORTEST_PIECE = 9, 4  # straight pieces of a curve; points of each
_STRAIGHT = 0.004  # rms distance from them, over the range of stress
_TRIM = 0.1  # of a rise is left out at either end
_SAME_SLOPE = 0.8  # of the steepest: neighbours above that belong to the same rise
_SHORTEST_RISE, _SHORTEST_AFTER = 0.0008, 0.003  # strain: of a piece; of a rise after a plateau
_REVERSAL = 0.03  # of the ranges: a fall of both strain and stress by that ends the loading
_ROWS = 60  # means that a pull in a bag is reduced to
_PARTS = 5  # of a rise, to detect slips
_NOISE_OF_PARTS = 4.0 * 1.25 * _PARTS  # 4 standard errors of their median slope, over the whole's


class Rise(NamedTuple):
    """An elastic rise: modulus and its error in Pa, from n readings."""

    modulus: float
    std: float
    n: int


class TensileReading(NamedTuple):
    """Features of one stress-strain curve."""

    initial: Rise  # before the plateau
    after: Rise | None  # after the plateau
    plateau: tuple[float, float, float] | None  # strain, strain, mean stress Pa
    toe: float  # strain at which the initial rise, extended, begins
    pieces: Array  # (m, 2) the ends of its straight pieces


def read_curve(record: TensileRecord) -> TensileReading:
    """Toe, elastic rises and plateau of one curve; InputError where no elastic part is found."""
    # The first loading ends at the first reversal: inner loops and repeats come after it.
    back = np.ones(len(record.strain), dtype=bool)
    for values in (record.strain, record.stress):
        back &= np.maximum.accumulate(values) - values > _REVERSAL * np.ptp(values)
    last = int(np.argmax(back)) if back.any() else len(back)
    top = int(np.argmax(record.stress[:last]))
    strain, stress = record.strain[: top + 1], record.stress[: top + 1]
    bins = Bins.of(strain, _GRID) if np.ptp(strain) > 0.0 else None
    x, y = (bins.mean(values) if bins else values[:0] for values in (strain, stress))
    if len(x) < 20:
        raise InputError(f"{record.path}: {len(x)} points while loading, expected 20 or more")
    pieces = _straight_pieces(x, y, max(_STRAIGHT * float(np.ptp(y)), 1.2 * scatter(y)))
    lines = {(a, b): straight_line(x[a : b + 1], y[a : b + 1]) for a, b in pieces}

    def long(chosen: Sequence[tuple[int, int]]) -> Sequence[tuple[int, int]]:
        return [p for p in chosen if x[p[1]] - x[p[0]] >= _SHORTEST_RISE] or chosen

    def steepest(chosen: Sequence[tuple[int, int]]) -> tuple[int, int] | None:
        """The steepest piece, joined with neighbours of nearly its slope."""
        if not chosen:
            return None
        best = max(long(chosen), key=lambda p: lines[p].slope)
        flatter = [p for p in chosen if not lines[p].slope > _SAME_SLOPE * lines[best].slope]
        first = max((p[1] + 1 for p in flatter if p < best), default=chosen[0][0])
        last = min((p[0] - 1 for p in flatter if p > best), default=chosen[-1][1])
        return first, last

    def rise(piece: tuple[int, int]) -> Rise:
        low, high = float(x[piece[0]]), float(x[piece[1]])
        for trim in (_TRIM * (high - low), 0.0):
            chosen = (strain >= low + trim) & (strain <= high - trim)
            if np.sum(chosen) >= 5:
                break
        return _modulus(strain[chosen], stress[chosen])

    # The plateau: the longest run of flat pieces after the first steep one.
    steep = max(lines[p].slope for p in long(pieces))
    rising = [k for k, p in enumerate(pieces) if lines[p].slope > 0.5 * steep]
    later, limit = pieces[rising[0] :] if rising else [], _PLATEAU_SLOPE * steep
    groups = groupby(later, lambda p: lines[p].slope > limit)
    runs = [[*group] for is_steep, group in groups if not is_steep]
    lengths = {(run[0][0], run[-1][1]): x[run[-1][1]] - x[run[0][0]] for run in runs}
    flat = [run for run, length in lengths.items() if length > _PLATEAU_STRAIN]
    plateau = max(flat, key=lengths.__getitem__, default=None)
    initial = steepest([p for p in pieces if plateau is None or p[1] < plateau[0]])
    if initial is None:
        raise InputError(f"{record.path}: no elastic rise before the plateau")
    after, level = None, None
    if plateau is not None:
        first, last = plateau
        level = (float(x[first]), float(x[last]), float(np.mean(y[first : last + 1])))
        found = steepest([p for p in pieces if p[0] > last])
        if found is not None and x[found[1]] - x[found[0]] >= _SHORTEST_AFTER:
            after = rise(found)
    whole = slice(initial[0], initial[1] + 1)
    toe = straight_line(x[whole], y[whole]).crossing(Line(0.0, 0.0, 0.0))
    ends = np.array([[x[k], float(lines[p](x[k]))] for p in pieces for k in p])
    return TensileReading(rise(initial), after, level, toe, ends)


def _straight_pieces(x: Array, y: Array, tolerance: float) -> list[tuple[int, int]]:
    """First and last point of the fewest straight pieces, at most nine, whose rms distance from y
    (n,) over x (n,) is below the tolerance: dynamic programming (Bellman, 1961)."""
    # (n + 1, n + 1) sum of squared distances from the line through points first..end - 1.
    n, u, v = len(x), x - x.mean(), y - y.mean()
    sums = [np.append(0.0, np.cumsum(w)) for w in (np.ones(n), u, v, u * u, u * v, v * v)]
    m, sx, sy, sxx, sxy, syy = (s[None, :] - s[:, None] for s in sums)
    with np.errstate(divide="ignore", invalid="ignore"):
        vxx, vxy, vyy = sxx - sx * sx / m, sxy - sx * sy / m, syy - sy * sy / m
        cost = np.maximum(vyy - np.where(vxx > 0.0, vxy * vxy / vxx, 0.0), 0.0)
    cost[m < _SHORTEST_PIECE] = np.inf
    best, origins = np.append(0.0, np.full(n, np.inf)), list[IntArray]()
    while best[n] > n * tolerance**2 and len(origins) < _MOST_PIECES:
        totals = best[:, None] + cost
        best, origins = totals.min(axis=0), [*origins, totals.argmin(axis=0)]
    pieces, end = [], n
    for origin in reversed(origins):
        pieces.append((int(origin[end]), end - 1))
        end = pieces[-1][0]
    return pieces[::-1]


def _modulus(strain: Array, stress: Array) -> Rise:
    """Slope; its error from correlated scatter, and from curvature or slips that parts show."""
    line, n, bend = straight_line(strain, stress), len(strain), 0.0
    variance = line.slope_variance * inflation([stress - line(strain)])
    lower = strain <= 0.5 * (strain.min() + strain.max())
    if min(np.sum(lower), np.sum(~lower)) >= 8:
        low, high = (straight_line(strain[h], stress[h]).slope for h in (lower, ~lower))
        # Noise alone makes halves differ by 4 standard errors of the whole: allow for twice that.
        bend = max(abs(high - low) - 8.0 * math.sqrt(variance), 0.0) / 4.0
    if n >= 8 * _PARTS:
        # A slip changes the slopes of one or two parts and of the whole, not the median of parts.
        order = np.argsort(strain, kind="stable")
        parts = np.array_split(order, _PARTS)
        median = float(np.median([straight_line(strain[k], stress[k]).slope for k in parts]))
        noise = scatter(stress[order]) / math.sqrt(n * float(np.var(strain)))
        bend = max(bend, abs(median - line.slope) - _NOISE_OF_PARTS * noise)
    return Rise(line.slope, math.hypot(math.sqrt(variance), bend), n)


def identify_tensile(records: Sequence[TensileRecord], parameters: Parameters,
                     phases: Mapping[str, Phase] = MappingProxyType({})) -> Experiment:
    """Evaluate tensile tests of one material; tests of one phase are repeats. `details` holds
    plateau stresses, toe, other rises; `curves` `<phase>/<file>/strain`, `/stress` and `/pieces`
    (m, 2). `parameters`: M_f and A_f of this wire, its length and diameter where a file has
    elongation and force; `phases`: phase by pattern of file names, overriding all else. Raises
    InputError: a test of unknown phase, or a curve without elastic part."""
    records = [_of_specimen(record, parameters) for record in records]
    findings = [finding for record in records for finding in record.findings]
    for pattern, phase in phases.items():
        if phase not in PHASES:
            raise InputError(f"phase of {pattern} is {phase!r}, expected {' or '.join(PHASES)}")
        if not any(fnmatch(record.path.name, pattern) for record in records):
            names = ", ".join(record.path.name for record in records)
            raise InputError(f"phase of {pattern}: no such tensile test among {names}")
    tests, curves = dict[Phase, list[tuple[TensileRecord, TensileReading]]](), dict[str, Array]()
    for record in records:
        phase, reading = _phase(record, phases, parameters), read_curve(record)
        tests.setdefault(phase, []).append((record, reading))
        shown = {"strain": record.strain, "stress": record.stress, "pieces": reading.pieces}
        curves |= {f"{phase}/{record.path.name}/{kind}": curve for kind, curve in shown.items()}
    estimates, details = dict[str, Estimate](), dict[str, Estimate]()
    of_gauge, of_section = parameters.std(GAUGE), 2.0 * fits.diameter_error(parameters)
    for phase, group in tests.items():
        symbol, (part, rises) = SYMBOL[phase], _chosen(phase, group, findings)
        value, *errors = fits.mean_of_repeats([(rise.modulus, rise.std) for rise in rises])
        kelvin = [record.temperature for record, _ in group if record.temperature]
        at = f" at {np.mean(kelvin):.2f} K" if kelvin else ""
        repeats = f"mean of {len(rises)} tests" if len(rises) > 1 else "one test"
        method, n = f"slope on {part}{at}, {repeats}", sum(r.n for r in rises)
        shares = {GAUGE: -of_gauge * value, "wire.diameter": -of_section * value}
        modulus = Estimate(value, math.hypot(*errors), "Pa", method, n)
        estimates[SYMBOLS[symbol]] = modulus.with_shares(shares)
        low, high = _NITI_MODULUS[phase]
        if not low <= value <= high:
            findings.append(remark("implausible modulus", symbol=symbol, modulus=value, low=low,
                                   high=high))
        every = [reading for _, reading in group]
        plateaus = [r.plateau for r in every if r.plateau]
        flat, toe = "longest flat part", "first rise extended to zero stress"
        more: list[tuple[str, str, str, list[Rise]]] = [
            (f"{symbol} before the plateau", "Pa", "slope", [r.initial for r in every]),
            (f"{symbol} after the plateau", "Pa", "slope", [r.after for r in every if r.after]),
            *((f"{phase} plateau {what}", unit, flat, [Rise(p[k], 0.0, 1) for p in plateaus])
              for k, (what, unit) in enumerate((("begin", "1"), ("end", "1"), ("stress", "Pa")))),
            (f"{phase} toe", "1", toe, [Rise(r.toe, 0.0, 1) for r in every]),
        ]
        for name, unit, method, found in (one for one in more if one[-1]):
            mean = fits.mean_and_deviation([one[:2] for one in found])
            details[name] = Estimate(*mean, unit, method, sum(one.n for one in found))
    soft, stiff = (estimates.get(SYMBOLS[SYMBOL[phase]]) for phase in ("martensite", "austenite"))
    if soft and stiff and soft.value - stiff.value > 3.0 * math.hypot(soft.std, stiff.std):
        findings.append(remark("moduli swapped", E_M=soft.value, E_A=stiff.value))
    return Experiment("E7", "Tensile tests (Fig. 9, Table III)", estimates, tuple(findings), curves,
                      "; ".join(str(record.path) for record in records), details)


def _of_specimen(record: TensileRecord, parameters: Parameters) -> TensileRecord:
    """The record with elongation and force converted to strain and stress of one wire."""
    if record.is_extension and not {"wire.length", "wire.mass"} & parameters.given:
        raise InputError(f"{record.path}: elongation instead of strain, give wire.length")
    if record.is_force and "wire.diameter" not in parameters.given:
        raise InputError(f"{record.path}: force instead of stress, give wire.diameter")
    if record.is_extension:
        record = replace(record, strain=record.strain / wire_length(parameters), is_extension=False,
                         findings=(*record.findings, about_length(parameters)))
    if record.is_force:
        record = replace(record, stress=record.stress / wire_section(parameters), is_force=False)
    return record


def _phase(record: TensileRecord, phases: Mapping[str, Phase], parameters: Parameters) -> Phase:
    """Phase of a test: as asked for, as its file says, or by M_f and A_f of the wire."""
    path, kelvin = record.path, record.temperature
    asked = dict.fromkeys(phase for name, phase in phases.items() if fnmatch(path.name, name))
    if len(asked) > 1:
        raise InputError(f"{path}: two phases given, {' and '.join(asked)}, expected one")
    if known := next(iter(asked), record.phase):
        return known
    give = f"give --phase {path.name}=martensite or =austenite"
    if kelvin is None:
        raise refusal("phase without temperature", path=path, give=give)
    own = {phase: parameters[name] for phase, name in _FINISH.items() if name in parameters.given}
    if kelvin <= own.get("martensite", -math.inf):
        return "martensite"
    if kelvin >= own.get("austenite", math.inf):
        return "austenite"
    cause = "phase in between" if len(own) == len(_FINISH) else "phase of an unknown wire"
    raise refusal(cause, path=path, kelvin=kelvin, give=give, **own)


def _chosen(phase: Phase, group: Sequence[tuple[TensileRecord, TensileReading]],
            findings: list[Finding]) -> tuple[str, list[Rise]]:
    """The part of the curves whose slope is the modulus, and its rise in each test that has it."""
    initial = [reading.initial for _, reading in group]
    if phase == "austenite":
        return "loading before the plateau", initial
    after = [reading.after for _, reading in group if reading.after]
    for record, own in ((record, own) for record, own in group if not own.after):
        where = (f"ends on the detwinning plateau at {own.plateau[1]:.2%}" if own.plateau
                 else "shows no detwinning plateau")
        cause = "left out" if after else "no rise after the plateau"
        findings.append(remark(cause, name=record.path.name, where=where))
    if after:
        return "loading after detwinning (xi = 1 with all of eps_L in it)", after
    return "loading before detwinning ends", initial


def tensile_tests(record: Record, parameters: Parameters) -> tuple[TensileRecord, ...]:
    """The pulls of a load-frame bag at steady temperature as tensile tests; rows are means of parts
    of a pull, as scatter of the extensometer makes a wire look softer."""
    # The temperature is the wire's own, else the room's if nothing heats the wire, else None.
    wires = record.channels
    heated = any(has_samples(record, f"{c}.{q}") for c in wires for q in ("voltage", "current"))
    names = [*(f"{c}.temperature" for c in wires), *([] if heated else ["ambient.temperature"])]
    thermometer = next((name for name in names if has_samples(record, name)), None)
    if len(wires) > 1 or (heated and thermometer is None):
        return ()
    tests, length, section = [], wire_length(parameters), channel_section(parameters)
    for number, (start, stop) in enumerate(find_pulls(record), 1):
        time, elongation = samples(record, "elongation")
        force = np.interp(time, *samples(record, "force"))
        inside = np.flatnonzero((time >= start) & (time < stop))
        if len(inside) < FEWEST_ROWS:
            continue
        kelvin = None
        if thermometer:
            time, read = samples(record, thermometer)
            read = read[(time >= start) & (time < stop)]
            means = [part.mean() for part in np.array_split(read, _ROWS) if len(part)]
            if not means or np.ptp(means) > STEADY:
                continue
            kelvin = float(np.mean(means))
        rows = [row for row in np.array_split(inside, _ROWS) if len(row)]
        strain = np.array([elongation[row].mean() for row in rows]) / length
        stress = np.array([force[row].mean() for row in rows]) / section
        tests.append(TensileRecord(record.path / f"pull {number}", strain, stress, kelvin))
    return tuple(tests)

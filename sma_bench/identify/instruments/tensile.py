"""E7: E_M and E_A from tensile tests at constant temperature (Fig. 9, Table III).

Martensite: slack (the toe), a short elastic rise, detwinning at nearly constant stress up to some
4 %, then the elastic rise of detwinned martensite, which is what the law's E_M means: xi = 1 with
all of eps_L in it. Austenite: the rise before the plateau of stress-induced martensite. The curve
is cut into straight pieces and the right one is told by its slope and by where the plateau lies.

Which phase a test shows is a matter of the wire's own M_f and A_f or of what its file or the user
says: the paper's wire does not tell it of another.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch

import numpy as np

from sma_bench.errors import InputError
from sma_bench.estimation.estimate import Estimate
from sma_bench.estimation.noise_model import autocorrelation, inflation
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, mean_of_repeats
from sma_bench.identify.instruments.isobaric import GAUGE, diameter_error, mean_and_deviation
from sma_bench.identify.result import Experiment
from sma_bench.identify.signals import Piece, fit_piece, straight_pieces
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import NITI_DENSITY, wire_length
from sma_bench.physics.bending import wire_section
from sma_bench.records.tensile import PHASES, Phase, TensileRecord

# --- What one tensile curve shows: toe, elastic rises, plateau, unloading.

PLATEAU_SLOPE = 0.35
PLATEAU_STRAIN = 0.004
_GRID = 240
_STRAIGHT = 0.004
_TRIM = 0.1
_SAME_SLOPE = 0.8
_SHORTEST_RISE = 0.0008
_SHORTEST_AFTER = 0.003
_UNLOADED = (0.9, 0.5)
_REVERSAL = 0.03  # of the ranges of strain and stress, which both fall
_PARTS = 5
_NOISE_OF_PARTS = 4.0 * 1.25 * _PARTS  # the median of their slopes, in standard errors of the whole


@dataclass(frozen=True)
class Rise:
    """An elastic part: modulus and its error in Pa, strains and stresses (Pa) of its ends, n."""

    modulus: float
    std: float
    strain: tuple[float, float]
    stress: tuple[float, float]
    n: int


@dataclass(frozen=True)
class TensileReading:
    """What one curve shows.

    Attributes:
        initial: the rise before the plateau.
        after: the rise after the plateau, if the test went so far.
        unloading: the first part of unloading, if there is any.
        plateau: (strain, strain, mean stress Pa), None without one.
        toe: strain at which the initial rise, extended, begins (slack before it).
        pieces: (m, 2) strain and stress of the pieces' ends.
    """

    initial: Rise
    after: Rise | None
    unloading: Rise | None
    plateau: tuple[float, float, float] | None
    toe: float
    pieces: Array


def read_curve(record: TensileRecord) -> TensileReading:
    """Find toe, elastic rises and plateau of one curve.

    Raises:
        InputError: no elastic part can be found.
    """
    # The first loading ends at the first reversal: inner loops and repeats come after it.
    fallen = [np.maximum.accumulate(v) - v > _REVERSAL * np.ptp(v)
              for v in (record.strain, record.stress)]  # fmt: skip
    back = fallen[0] & fallen[1]
    last = int(np.argmax(back)) if back.any() else len(back)
    top = int(np.argmax(record.stress[:last]))
    # Means over narrow intervals of strain.
    strain, stress = record.strain[: top + 1], record.stress[: top + 1]
    width = float(np.ptp(strain)) / _GRID
    x = y = strain[:0]
    if width > 0.0:
        index = np.floor((strain - strain.min()) / width).astype(int)
        _, index, count = np.unique(index, return_inverse=True, return_counts=True)
        x, y = np.bincount(index, strain) / count, np.bincount(index, stress) / count
    if len(x) < 20:
        raise InputError(f"{record.path}: {len(x)} points while loading, expected 20 or more")
    noise = 1.4826 * float(np.median(np.abs(np.diff(y, 2)))) / math.sqrt(6.0)
    pieces = straight_pieces(x, y, max(_STRAIGHT * float(np.ptp(y)), 1.2 * noise))
    # First and last point of the longest run of flat pieces after the first steep one.
    steep = max(p.slope for p in [p for p in pieces if _is_long(x, p)] or pieces)
    runs: list[tuple[int, int]] = []
    seen = False
    for p in pieces:
        if p.slope > 0.5 * steep:
            seen = True
        if not seen or p.slope > PLATEAU_SLOPE * steep:
            continue
        if runs and runs[-1][1] + 1 == p.first:
            runs[-1] = (runs[-1][0], p.last)
        else:
            runs.append((p.first, p.last))
    long = [run for run in runs if x[run[1]] - x[run[0]] > PLATEAU_STRAIN]
    plateau = max(long, key=lambda run: float(x[run[1]] - x[run[0]])) if long else None
    initial = _steepest(x, y, [p for p in pieces if plateau is None or p.last < plateau[0]])
    if initial is None:
        raise InputError(f"{record.path}: no elastic rise before the plateau")
    after, level = None, None
    if plateau is not None:
        first, last = plateau
        level = (float(x[first]), float(x[last]), float(np.mean(y[first : last + 1])))
        after = _steepest(x, y, [p for p in pieces if p.first > last])
        if after is not None and x[after.last] - x[after.first] < _SHORTEST_AFTER:
            after = None
    # Unloading: from 90 to 50 % of the largest stress on the way down.
    unloading = None
    down, way = record.stress[top:], record.strain[top:]
    high, low = (share * float(down[0]) for share in _UNLOADED)
    if len(down) >= 10 and down.min() <= low:
        chosen = np.flatnonzero(down[: int(np.argmax(down <= low)) + 1] <= high)
        if len(chosen) >= 5 and np.ptp(way[chosen]) > 0.0:
            unloading = _modulus(way[chosen], down[chosen])
    return TensileReading(
        initial=_rise(strain, stress, x, initial),
        after=_rise(strain, stress, x, after) if after else None,
        unloading=unloading,
        plateau=level,
        toe=initial.at - initial.value / initial.slope,
        pieces=np.array([
            [x[k], p.value + p.slope * (x[k] - p.at)] for p in pieces for k in (p.first, p.last)
        ]),
    )


def _is_long(x: Array, piece: Piece) -> bool:
    return bool(x[piece.last] - x[piece.first] >= _SHORTEST_RISE)


def _steepest(x: Array, y: Array, pieces: Sequence[Piece]) -> Piece | None:
    """The steepest piece that is long enough, joined with neighbours of nearly its slope."""
    long = [p for p in pieces if _is_long(x, p)] or list(pieces)
    if not long:
        return None
    best = max(long, key=lambda p: p.slope)
    at = list(pieces).index(best)
    first, last = at, at
    while first > 0 and pieces[first - 1].slope > _SAME_SLOPE * best.slope:
        first -= 1
    while last + 1 < len(pieces) and pieces[last + 1].slope > _SAME_SLOPE * best.slope:
        last += 1
    return fit_piece(x, y, pieces[first].first, pieces[last].last)


def _rise(strain: Array, stress: Array, x: Array, piece: Piece) -> Rise:
    low, high = float(x[piece.first]), float(x[piece.last])
    trim = _TRIM * (high - low)
    chosen = (strain >= low + trim) & (strain <= high - trim)
    if np.sum(chosen) < 5:
        chosen = (strain >= low) & (strain <= high)
    return _modulus(strain[chosen], stress[chosen])


def _modulus(strain: Array, stress: Array) -> Rise:
    """Slope, its error from coloured scatter, and from the curvature that halves would show."""
    middle = 0.5 * (strain.min() + strain.max())
    centred = strain - strain.mean()
    power = float(centred @ centred)
    slope = float(centred @ stress) / power
    left = stress - stress.mean() - slope * centred
    n = len(strain)
    variance = float(left @ left) / max(n - 2, 1) * inflation(autocorrelation([left])) / power
    halves = [strain <= middle, strain > middle]
    bend = 0.0
    if min(int(np.sum(h)) for h in halves) >= 8:
        slopes = [float(np.polyfit(strain[h], stress[h], 1)[0]) for h in halves]
        # Halves of noise alone differ by 4 sqrt(2) standard errors of the whole.
        bend = max(abs(slopes[1] - slopes[0]) - 8.0 * math.sqrt(variance), 0.0) / 4.0
    if n >= 8 * _PARTS:
        # A slip is in one or two of the parts, and in the slope of the whole.
        order = np.argsort(strain, kind="stable")
        slopes = [
            float(np.polyfit(strain[k], stress[k], 1)[0]) for k in np.array_split(order, _PARTS)
        ]
        noise = 1.4826 * float(np.median(np.abs(np.diff(stress[order], 2)))) / math.sqrt(6.0)
        slip = abs(float(np.median(slopes)) - slope) - _NOISE_OF_PARTS * noise / math.sqrt(power)
        bend = max(bend, slip)
    return Rise(
        slope, math.hypot(math.sqrt(variance), bend),
        (float(strain.min()), float(strain.max())), (float(stress.min()), float(stress.max())), n,
    )


# --- the experiment

NAME = "E7"
TITLE = "Tensile tests (Fig. 9, Table III)"
MODULUS = {"martensite": "wire.martensite_modulus", "austenite": "wire.austenite_modulus"}
SYMBOL = {"martensite": "E_M", "austenite": "E_A"}
# Pa: martensite after detwinning 20 to 50 GPa, austenite 40 to 90 GPa in the literature.
NITI_MODULUS = {"martensite": (17e9, 60e9), "austenite": (35e9, 100e9)}
# What the law's moduli are of a curve that shows more than one slope.
CONVENTION = {
    "martensite": "loading after detwinning (xi = 1 with all of eps_L in it)",
    "austenite": "loading before the plateau",
}
_TRANSITION = {
    "martensite": "wire.martensite_finish_temperature",
    "austenite": "wire.austenite_finish_temperature",
}


def identify_tensile(
    records: Sequence[TensileRecord], parameters: Parameters | None = None, *,
    phases: Mapping[str, Phase] | None = None,
) -> Experiment:
    """Evaluate tensile tests of one material; tests of one phase are repeats.

    Args:
        records: the tests.
        parameters: M_f and A_f of this wire, given or identified, which with the test's
            temperature tell the phase, and its length and diameter where a file has elongation and
            force; those of the table of defaults do not count.
        phases: phase by file name or pattern of names, before everything else.

    Returns:
        Estimates of E_M and E_A (mean and deviation of repeats), `details` with plateau stresses,
        toe, other rises; `curves` `<phase>/<file>/strain`, `/stress`, `/pieces` (m, 2).

    Raises:
        InputError: no records, a test whose phase is not known, or a curve without elastic part.
    """
    parameters = parameters or Parameters.defaults()
    if not records:
        raise InputError("tensile test: no records")
    records = [_of_specimen(record, parameters) for record in records]
    findings = [finding for record in records for finding in record.findings]
    phases = phases or {}
    for pattern, phase in phases.items():
        if phase not in PHASES:
            raise InputError(f"phase of {pattern} is {phase!r}, expected {' or '.join(PHASES)}")
        if not any(fnmatch(record.path.name, pattern) for record in records):
            names = ", ".join(record.path.name for record in records)
            raise InputError(f"phase of {pattern}: no such tensile test among {names}")
    readings: dict[Phase, list[tuple[TensileRecord, TensileReading]]] = {}
    curves: dict[str, Array] = {}
    for record in records:
        phase = _phase(record, phases, parameters)
        reading = read_curve(record)
        readings.setdefault(phase, []).append((record, reading))
        curves[f"{phase}/{record.path.name}/strain"] = record.strain
        curves[f"{phase}/{record.path.name}/stress"] = record.stress
        curves[f"{phase}/{record.path.name}/pieces"] = reading.pieces
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    for phase, group in readings.items():
        part, rises = _chosen(phase, group, findings)
        value, *errors = mean_of_repeats([(rise.modulus, rise.std) for rise in rises])
        std = math.hypot(*errors)
        temperature = [r.temperature for r, _ in group if r.temperature is not None]
        at = f" at {np.mean(temperature):.2f} K" if temperature else ""
        repeats = f"mean of {len(rises)} tests" if len(rises) > 1 else "one test"
        estimates[MODULUS[phase]] = Estimate(
            value, std, "Pa", f"slope on {part}{at}, {repeats}", sum(r.n for r in rises)
        )
        details.update(_details(phase, [reading for _, reading in group]))
        low, high = NITI_MODULUS[phase]
        if not low <= value <= high:
            text = (
                f"{SYMBOL[phase]} = {value / 1e9:.3g} GPa, NiTi has {low / 1e9:g} to "
                f"{high / 1e9:g}: crosshead travel instead of an extensometer, a wrong area, or a "
                "wrong unit"
            )
            findings.append(Finding("warning", "E_M, E_A", text, {"modulus": value}))
    section = -2.0 * diameter_error(parameters)
    estimates = {
        n: e.with_shares({
            GAUGE: -parameters.std(GAUGE) * e.value, "wire.diameter": section * e.value,
        })
        for n, e in estimates.items()
    }
    # Martensite that is stiffer than austenite: the tests' phases are probably swapped.
    soft, stiff = (estimates.get(MODULUS[phase]) for phase in ("martensite", "austenite"))
    if soft and stiff and soft.value - stiff.value > 3.0 * math.hypot(soft.std, stiff.std):
        text = (
            f"E_M = {soft.value / 1e9:.1f} GPa lies above E_A = {stiff.value / 1e9:.1f} GPa: on "
            "NiTi austenite is the stiffer phase; are the phases of the tests swapped?"
        )
        numbers = {"E_M": soft.value, "E_A": stiff.value}
        findings.append(Finding("warning", "E_M, E_A", text, numbers))
    source = "; ".join(str(record.path) for record in records)
    return Experiment(NAME, TITLE, estimates, tuple(findings), curves, source, details)


def _of_specimen(record: TensileRecord, parameters: Parameters) -> TensileRecord:
    """Strain and stress, of elongation and force by the wire's own length and section."""
    if record.is_extension and not {"wire.length", "wire.mass"} & parameters.given:
        raise InputError(f"{record.path}: elongation instead of strain, give wire.length")
    if record.is_force and "wire.diameter" not in parameters.given:
        raise InputError(f"{record.path}: force instead of stress, give wire.diameter")
    findings, strain, stress = [*record.findings], record.strain, record.stress
    if record.is_extension:
        strain = strain / wire_length(parameters)
        findings.append(about_length(parameters))
    if record.is_force:
        stress = stress / wire_section(parameters)
    return replace(record, strain=strain, stress=stress, findings=tuple(findings),
                   is_extension=False, is_force=False)  # fmt: skip


def about_length(parameters: Parameters) -> Finding:
    """Where the gauge length comes from."""
    length = wire_length(parameters)
    source = f"from mass and diameter at {NITI_DENSITY:g} kg/m3"
    if parameters["wire.length"]:
        source = "as given"
    text = (
        f"wire length {length * 1e3:.2f} mm {source}, "
        "taken as the gauge length: strains scale with its inverse, stresses with that of the "
        "section"
    )
    return Finding("info", "wire length", text, {"length": length})


def _phase(
    record: TensileRecord, phases: Mapping[str, Phase], parameters: Parameters
) -> Phase:
    asked = [phase for pattern, phase in phases.items() if fnmatch(record.path.name, pattern)]
    if len(set(asked)) > 1:
        raise InputError(f"{record.path}: said to be {' and to be '.join(dict.fromkeys(asked))}")
    if asked:
        return asked[0]
    if record.phase is not None:
        return record.phase
    give = f"give --phase {record.path.name}=martensite or =austenite"
    if record.temperature is None:
        raise InputError(
            f"{record.path}: no temperature in the file, so the phase is not known; {give}"
        )
    own = {
        phase: parameters[name] for phase, name in _TRANSITION.items() if name in parameters.given
    }
    kelvin = record.temperature
    if "martensite" in own and kelvin <= own["martensite"]:
        return "martensite"
    if "austenite" in own and kelvin >= own["austenite"]:
        return "austenite"
    if len(own) == len(_TRANSITION):
        raise InputError(
            f"{record.path}: tested at {kelvin:.1f} K, between M_f {own['martensite']:.1f} K and "
            f"A_f {own['austenite']:.1f} K: the phase depends on what came before; {give}"
        )
    raise InputError(
        f"{record.path}: tested at {kelvin:.1f} K, but M_f and A_f of this wire are not known, "
        f"expected them given or identified (E5, E6), else {give}"
    )


def _chosen(
    phase: Phase, group: Sequence[tuple[TensileRecord, TensileReading]], findings: list[Finding]
) -> tuple[str, list[Rise]]:
    """Which part of the curves is the modulus, and that part of every test that shows it."""
    if phase == "austenite":
        return CONVENTION[phase], [reading.initial for _, reading in group]
    after = [reading.after for _, reading in group if reading.after is not None]
    for record, reading in group:
        name, before, late, plateau = (
            record.path.name, reading.initial, reading.after, reading.plateau
        )
        if late is None:
            what = (
                f"the test ends on the detwinning plateau at {plateau[1]:.2%}" if plateau else
                "no detwinning plateau"
            )
            use = (
                "left out, as other tests show the rise after it" if after else
                "E_M is the slope before it, in which detwinning has begun" if plateau else
                "E_M is the slope of the first rise"
            )
            findings.append(Finding("warning", "E_M", f"{name}: {what}, {use}"))
        elif abs(before.modulus - late.modulus) > 3.0 * math.hypot(before.std, late.std):
            text = (
                f"{name}: {before.modulus / 1e9:.1f} GPa before the detwinning plateau, "
                f"{late.modulus / 1e9:.1f} GPa after it; E_M is the latter"
            )
            numbers = {"before": before.modulus, "after": late.modulus}
            findings.append(Finding("info", "E_M", text, numbers))
    if after:
        return CONVENTION[phase], after
    return "loading before detwinning ends", [reading.initial for _, reading in group]


def _details(phase: str, readings: Sequence[TensileReading]) -> dict[str, Estimate]:
    details = {}
    symbol = SYMBOL[phase]
    parts = {
        f"{symbol} before the plateau": [r.initial for r in readings],
        f"{symbol} after the plateau": [r.after for r in readings if r.after],
        f"{symbol} on unloading": [r.unloading for r in readings if r.unloading],
    }
    for name, rises in parts.items():
        if rises:
            value, std = mean_and_deviation([(rise.modulus, rise.std) for rise in rises])
            details[name] = Estimate(value, std, "Pa", "slope", sum(r.n for r in rises))
    plateaus = [r.plateau for r in readings if r.plateau]
    if plateaus:
        for name, k, unit in (("begin", 0, "1"), ("end", 1, "1"), ("stress", 2, "Pa")):
            values = np.array([p[k] for p in plateaus])
            deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
            details[f"{phase} plateau {name}"] = Estimate(
                float(values.mean()), deviation, unit, "longest flat part", len(values)
            )
    toes = np.array([r.toe for r in readings])
    deviation = float(np.std(toes, ddof=1)) if len(toes) > 1 else 0.0
    details[f"{phase} toe"] = Estimate(
        float(toes.mean()), deviation, "1", "first rise extended to zero stress", len(toes)
    )
    return details

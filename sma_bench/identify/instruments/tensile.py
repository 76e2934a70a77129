"""E7: E_M and E_A from tensile tests at constant temperature (Fig. 9, Table III).

Martensite: slack (the toe), a short elastic rise, detwinning at nearly constant stress up to some
4 %, then the elastic rise of detwinned martensite, which is what the law's E_M means: xi = 1 with
all of eps_L in it. Austenite: the rise before the plateau of stress-induced martensite. The curve
is cut into straight pieces and the right one is told by its slope and by where the plateau lies.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from sma_bench.errors import InputError
from sma_bench.findings import Finding
from sma_bench.identify.estimate import Array, Estimate, Experiment
from sma_bench.identify.instruments.isobaric_levels import mean_and_deviation
from sma_bench.identify.instruments.tensile_curve import Rise, TensileReading, read_curve
from sma_bench.parameters import Parameters
from sma_bench.records.tensile import TensileRecord

NAME = "E7"
TITLE = "Tensile tests (Fig. 9, Table III)"
MODULUS = {"martensite": "wire.martensite_modulus", "austenite": "wire.austenite_modulus"}
SYMBOL = {"martensite": "E_M", "austenite": "E_A"}
NITI_MODULUS = (5e9, 120e9)  # Pa
Phase = Literal["martensite", "austenite"]


def identify_tensile(
    records: Sequence[TensileRecord],
    parameters: Parameters | None = None,
    *,
    phases: Mapping[str, Phase] | None = None,
) -> Experiment:
    """Evaluate tensile tests of one material; tests of one phase are repeats.

    Args:
        records: the tests.
        parameters: M_f and A_f, which with the test's temperature tell the phase.
        phases: phase by file name, where temperature is not recorded or does not tell.

    Returns:
        Estimates of E_M and E_A (mean and deviation of repeats), `details` with plateau stresses,
        toe, other rises; `curves` `<phase>/<file>/strain`, `/stress`, `/pieces` (m, 2).

    Raises:
        InputError: no records, a test whose phase is not known, or a curve without elastic part.
    """
    parameters = parameters or Parameters.defaults()
    if not records:
        raise InputError("tensile test: no records")
    findings = [finding for record in records for finding in record.findings]
    readings: dict[Phase, list[tuple[TensileRecord, TensileReading]]] = {}
    curves: dict[str, Array] = {}
    for record in records:
        phase: Phase = (phases or {}).get(record.path.name) or _phase(record, parameters)
        reading = read_curve(record)
        readings.setdefault(phase, []).append((record, reading))
        curves[f"{phase}/{record.path.name}/strain"] = record.strain
        curves[f"{phase}/{record.path.name}/stress"] = record.stress
        curves[f"{phase}/{record.path.name}/pieces"] = reading.pieces
    estimates: dict[str, Estimate] = {}
    details: dict[str, Estimate] = {}
    for phase, group in readings.items():
        rises = [_chosen(phase, record, reading, findings) for record, reading in group]
        value, std = mean_and_deviation([(rise.modulus, rise.std) for rise in rises])
        temperature = [r.temperature for r, _ in group if r.temperature is not None]
        at = f" at {np.mean(temperature):.2f} K" if temperature else ""
        repeats = f"mean and deviation of {len(rises)} tests" if len(rises) > 1 else "one test"
        estimates[MODULUS[phase]] = Estimate(
            value, std, "Pa", f"slope of the elastic part{at}, {repeats}", sum(r.n for r in rises)
        )
        details.update(_details(phase, [reading for _, reading in group]))
        findings.extend(_remarks(phase, value))
    return Experiment(
        name=NAME, title=TITLE, estimates=estimates, findings=tuple(findings), curves=curves,
        source="; ".join(str(record.path) for record in records), details=details,
    )


def _phase(record: TensileRecord, parameters: Parameters) -> Phase:
    if record.temperature is None:
        raise InputError(
            f"{record.path}: no temperature in the file, so the phase is not known; give the "
            "temperature or the phase"
        )
    m_f = parameters["wire.martensite_finish_temperature"]
    a_f = parameters["wire.austenite_finish_temperature"]
    if record.temperature <= m_f:
        return "martensite"
    if record.temperature >= a_f:
        return "austenite"
    raise InputError(
        f"{record.path}: tested at {record.temperature:.1f} K, between M_f {m_f:.1f} K and A_f "
        f"{a_f:.1f} K: the phase depends on what came before, give it"
    )


def _chosen(
    phase: str, record: TensileRecord, reading: TensileReading, findings: list[Finding]
) -> Rise:
    if phase == "austenite":
        return reading.initial
    if reading.plateau is None:
        text = f"{record.path.name}: no detwinning plateau, E_M is the slope of the first rise"
        findings.append(Finding("warning", "E_M", text))
        return reading.initial
    if reading.after is None:
        text = (
            f"{record.path.name}: the test ends on the detwinning plateau at "
            f"{reading.plateau[1]:.2%}, E_M is the slope before it, in which detwinning has begun"
        )
        findings.append(Finding("warning", "E_M", text))
        return reading.initial
    before, after = reading.initial, reading.after
    if abs(before.modulus - after.modulus) > 3.0 * math.hypot(before.std, after.std):
        text = (
            f"{record.path.name}: {before.modulus / 1e9:.1f} GPa before the detwinning plateau, "
            f"{after.modulus / 1e9:.1f} GPa after it; E_M is the latter"
        )
        numbers = {"before": before.modulus, "after": after.modulus}
        findings.append(Finding("info", "E_M", text, numbers))
    return after


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


def _remarks(phase: str, modulus: float) -> list[Finding]:
    low, high = NITI_MODULUS
    if low <= modulus <= high:
        return []
    text = (
        f"{SYMBOL[phase]} = {modulus / 1e9:.3g} GPa, NiTi has {low / 1e9:g} to {high / 1e9:g}: "
        "crosshead travel instead of an extensometer, a wrong area, or a wrong unit"
    )
    return [Finding("warning", SYMBOL[phase], text, {"modulus": modulus})]

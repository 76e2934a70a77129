"""The truth about a case, as it is sealed."""

from collections.abc import Mapping
from typing import Any

from sma_bench import __version__
from sma_bench.blind.cases import Case
from sma_bench.blind.deck import NONE, QUANTITIES, RECALIBRATION
from sma_bench.blind.effect_names import STAGE_OF
from sma_bench.blind.rigs import stage_of_parameter, true_values
from sma_bench.blind.separation import Separation
from sma_bench.blind.sizing import Sized, measured, rounded
from sma_bench.blind.stage import RECORDS, Array, Stage, gaps, largest, quantity_of, where
from sma_bench.blind.symptoms import OUTSIDE
from sma_bench.parameters import Parameters

_PLACES = 12
Readings = Mapping[str, Mapping[str, Array]]


def reference(case: Case, stage: Stage, sized: Sized) -> dict[str, dict[str, Array]]:
    """Noise-free readings without what the case hides: the effect, or the owners' mistakes."""
    believed = mistaken(case) if case.wrong else None
    return {record: stage.read(sized.base, record, parameters=believed) for record in RECORDS}


def mistaken(case: Case) -> Parameters:
    """The true rig, but for the numbers about which the owners are badly wrong."""
    return case.truth.replace({name: case.nominal[name] for name in _with_twins(case.wrong)})


def _with_twins(names: Mapping[str, float]) -> list[str]:
    return [n for name in names for n in (name, name.replace("_front", "_back"))]


def make_label(
    case: Case,
    stage: Stage,
    sized: Sized,
    truth: Readings,
    without: Readings,
    separation: Separation | None,
) -> dict[str, Any]:
    """Everything that a scorer may want to know, as plain JSON.

    Args:
        case: as it was drawn.
        stage: the rig and its drives.
        sized: the features found for it.
        truth: noise-free readings by record with what is hidden.
        without: the same without it.
        separation: from rival explanations; None where nothing is hidden.
    """
    quantities = QUANTITIES[case.card.signals]
    gap = {r: rounded(gaps(truth[r], without[r], stage.sensors, quantities)) for r in RECORDS}
    severity = max(largest(gap[record]) for record in RECORDS)
    hides = case.card.kind != NONE
    return {
        "id": case.name,
        "kind": case.card.kind,
        "effects": list(case.card.effects),
        "stages": _stages(case),
        "signals": case.card.signals,
        "noise": case.card.colour,
        "kinetics": case.card.mild_kinetics,
        "severity": severity if hides else 0.0,
        "severities": _severities(case, stage, sized, severity),
        "targets": list(case.card.targets),
        "amounts": dict(sized.amounts),
        "gap": gap,
        "nuisance_gap": round(sized.nuisance_gap, 4),
        "kinetics_gap": round(sized.kinetics_gap, 4),
        "wrong": dict(case.wrong),
        "where": _where(case, stage, truth, without, gap) if hides and severity else None,
        "distinguishable": separation.distinguishable if separation else True,
        "separation": separation.to_json() if separation else None,
        "features": dict(sorted(sized.features.items())),
        "base": dict(sorted(sized.base.items())),
        "truth": true_values(case.truth),
        "sensors": stage.sensors.to_json(),
        "drives": {name: drive.to_json() for name, drive in case.drives.items()},
        "starts": dict(case.starts),
        "version": __version__,
    }


def _stages(case: Case) -> list[str]:
    if case.card.kind == RECALIBRATION:
        return sorted({stage_of_parameter(name) for name in case.wrong})
    return [STAGE_OF.get(name) or OUTSIDE[name].stage for name in case.card.effects]


def _severities(
    case: Case, stage: Stage, sized: Sized, severity: float
) -> dict[str, float]:
    """Of each effect: the gap that it makes beside the others."""
    if len(case.card.effects) < 2:
        return dict.fromkeys(case.card.effects, severity)
    quantities = QUANTITIES[case.card.signals]
    return {
        name: round(measured(stage, sized.features, sized.without(name), quantities), 4)
        for name in case.card.effects
    }


def _where(
    case: Case,
    stage: Stage,
    truth: Readings,
    without: Readings,
    gap: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """Signal of the largest gap in the record that a diagnosis sees; phase and side of most of
    that signal's share; stage of the largest effect."""
    record = RECORDS[0]
    quantities = QUANTITIES[case.card.signals]
    table = where(truth[record], without[record], stage, record, quantities)
    signal = max(gap[record], key=lambda name: gap[record][name])
    first = next(row for row in table if row["signal"] == signal)
    return {
        "signal": quantity_of(signal),
        "channel": signal.rpartition(".")[0],
        "phase": first["phase"],
        "side": first["side"],
        "stage": _stages(case)[0],
        "table": [_rounded_row(row) for row in table[:_PLACES]],
    }


def _rounded_row(row: Mapping[str, Any]) -> dict[str, Any]:
    return {**row, "gap": round(row["gap"], 4), "share": round(row["share"], 4)}

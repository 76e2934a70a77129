"""The report of a diagnosis: the argument as a careful experimenter makes it, with figures."""

from dataclasses import replace
from pathlib import Path

from sma_bench.cards import card, sentences
from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.chain import reading_of
from sma_bench.diagnose.decision import NO_GAP, UNEXPLAINED
from sma_bench.diagnose.sizes import sample_noise
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.findings import fold_audit
from sma_bench.parameters.table import BY_NAME
from sma_bench.progress import Report, silent
from sma_bench.report.diagnosis_figures import (
    candidate_picture,
    evidence_picture,
    gap_picture,
    missing_pictures,
    next_experiment_picture,
    shrinkage_picture,
    signal_pictures,
    stage_picture,
)
from sma_bench.report.drawing import PaperColumn
from sma_bench.report.page import Made, Section, write_report
from sma_bench.report.tables import Table, diagnosis_tables
from sma_bench.results import scale_of, signed, with_error


def write_diagnosis_report(
    directory: str | Path, result: Diagnosis, report: Report = silent,
    made: Made | None = None, column: PaperColumn | None = None,
) -> Path:
    """Write the report's index.html and figures.

    Args:
        report: hears which figure comes.
        made: by which command and of which inputs.
        column: of a paper, for which the figures are written as well.

    Raises:
        InputError: the folder cannot be written.
    """
    tables = diagnosis_tables(result)
    reading = reading_of(result.where.chain) if result.cause else ""
    proposed = next_experiment_picture(result, result.parameters)
    sections = [
        Section("Is there a gap beyond the noise?", sentences(result, "is_there"),
                tables=[_noise(result)], pictures=signal_pictures(result)),
        Section("Where is it?", [*sentences(result, "where"), *filter(None, [reading])],
                tables=[tables["chain"]] if "chain" in tables else [],
                pictures=[gap_picture(result), stage_picture(result)]),
        Section("Which effect, and how sure?", [*sentences(result, "which"), *result.why],
                tables=[tables["candidates"]],
                pictures=[candidate_picture(result), evidence_picture(result)]),
    ]
    if result.decision.verdict == UNEXPLAINED:
        text = (
            "What a further effect would have to do to the readings; what causes it, the figures "
            "can only suggest."
        )
        sections.append(
            Section("The shape of what is missing", [text], pictures=missing_pictures(result))
        )
    sections += [
        Section("How far does it shrink?", sentences(result, "how_far"),
                tables=[] if result.decision.verdict == NO_GAP else [_improved(result)],
                pictures=[shrinkage_picture(result)]),
        Section("What next?", sentences(result, "next", None),
                pictures=[proposed] if proposed else []),
        _looked_at(result),
    ]
    numbered = [replace(s, title=f"{k}. {s.title}") for k, s in enumerate(sections, 1)]
    answer = Section("", card=card(result))
    sources = list(dict.fromkeys(v.path for v in result.observations))
    made = made or Made("sma_bench.diagnose", sources)
    title = "The gap between simulation and bench"
    return write_report(
        directory, title, f"From {'; '.join(sources)}. {made.head}",
        [answer, *numbered, made.section()], column=column, report=report,
    )


def _looked_at(result: Diagnosis) -> Section:
    rows = []
    parts = [("fitted", v) for v in result.fitted] + [("held out", v) for v in result.held_out]
    for part, view in parts:
        for s in view.signals:
            span = f"{s.time[0]:.1f} to {s.time[-1]:.1f}"
            rows.append((view.path, part, s.name, span, f"{int(s.count.sum())}", f"{s.period:.2g}"))
    left_out = dict.fromkeys(name for view in result.observations for name in view.left_out)
    paragraphs = [f"Recorded and not compared: {', '.join(left_out)}."] if left_out else []
    header = ("record", "used", "signal", "time [s]", "samples", "bin [s]")
    findings, audit = fold_audit(result.findings)
    return Section(
        "What was looked at", paragraphs, [str(f) for f in findings],
        [Table(header, rows, frozenset({4, 5}))], folded=[str(f) for f in audit],
    )


def _noise(result: Diagnosis) -> Table:
    rows = []
    problem = result.model.problem
    order = [q for q, _ in result.worst_first]
    order += [q for q in QUANTITIES if q not in order]
    for name, noise in sorted(
        problem.noise.items(), key=lambda item: order.index(item[0].rpartition(".")[2])
    ):
        unit, factor = scale_of(name)
        slow = noise.drift > 0.0
        rows.append((
            name, f"{factor * sample_noise(problem, name):.3g} {unit}",
            f"{factor * noise.drift:.3g} {unit}" if slow else "none found",
            f"{noise.time:{'.2g' if noise.time < 10.0 else '.0f'}}" if slow else "",
        ))
    header = ("sensor", "noise of a sample", "slow part", "its memory [s]")
    return Table(header, rows, frozenset({1, 2, 3}))


def _improved(result: Diagnosis) -> Table:
    unknowns = result.model.unknowns
    values, stds = unknowns.values(result.model.x), result.model.errors
    deviations = unknowns.deviations(result.model.x)
    rows = []
    for item, x, value, std in zip(unknowns.items, deviations, values, stds, strict=True):
        name, believed = item.name, item.value(0.0)  # of what the geometry gives: from there
        effect = name.startswith("effect.") or not item.std
        moved = "" if effect else signed(float(x), ".1f")
        rows.append((name, f"{believed:.6g}", with_error(value, std), BY_NAME[name].unit, moved))
    header = ("parameter", "as believed", "improved", "unit", "moved by (its own std)")
    return Table(header, rows, frozenset({1, 2, 4}))

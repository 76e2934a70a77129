"""The report of an identification: its card, and measured against model under it."""

from pathlib import Path

from sma_bench.cards import identification_card
from sma_bench.findings import Finding
from sma_bench.identify import Identification
from sma_bench.identify.estimate import Experiment
from sma_bench.progress import Report, silent
from sma_bench.report.collected_report import detail_table
from sma_bench.report.drawing import Column
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.report.page import Made, Section, write_report
from sma_bench.report.plots import agreement_picture, correlation_picture


def write_identification_report(
    directory: str | Path, result: Identification, report: Report = silent,
    made: Made | None = None, column: Column | None = None,
) -> Path:
    """Write the report's index.html and figures.

    Args:
        report: hears which figure comes.
        made: by which command and of which inputs.
        column: of a paper, for which the figures are written as well.

    Raises:
        InputError: the folder cannot be written.
    """
    shown, made = result.shown, made or Made("sma_bench.identify")
    drawn = (agreement_picture(shown, "agreement"), correlation_picture(shown, "correlation"))
    sections = [
        Section(
            "", notes=_lines(result.notes),
            pictures=[picture for picture in drawn if picture is not None],
            card=identification_card(shown),
        ),
        *(experiment_section(experiment) for experiment in result.experiments),
        Section("How each number was found", tables=[detail_table(shown.parameters, "numbers")]),
        made.section(),
    ]
    sources = "; ".join(dict.fromkeys(experiment.source for experiment in result.experiments))
    return write_report(
        directory, "Identified parameters", f"From {sources}. {made.head}", sections,
        column=column, report=report,
    )


def experiment_section(experiment: Experiment) -> Section:
    """Remarks and figures of one experiment."""
    return Section(
        f"{experiment.name} {experiment.title}",
        paragraphs=[experiment.source],
        notes=_lines(experiment.findings),
        pictures=experiment_pictures(experiment),
    )


def _lines(findings: tuple[Finding, ...]) -> list[str]:
    return [str(finding) for finding in findings]

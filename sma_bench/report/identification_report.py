"""The report of an identification: numbers with errors, remarks, and the figures behind them."""

from pathlib import Path

from sma_bench.findings import Finding
from sma_bench.identify import Identification
from sma_bench.identify.estimate import Experiment
from sma_bench.progress import Report, silent
from sma_bench.report.experiment_pictures import experiment_pictures
from sma_bench.report.page import Section, Table, write_report

_HEADER = ("parameter", "value", "standard error", "unit", "points", "experiment", "method")


def write_identification_report(
    directory: str | Path, result: Identification, report: Report = silent
) -> Path:
    """Write the report's index.html and PNG figures; `report` is told which one comes.

    Raises:
        InputError: the folder cannot be written.
    """
    sections = [Section("Parameters", tables=[_table(result)], notes=_lines(result.notes))]
    sections += [experiment_section(experiment) for experiment in result.experiments]
    sources = "; ".join(dict.fromkeys(experiment.source for experiment in result.experiments))
    summary = f"From {sources}."
    return write_report(directory, "Identified parameters", summary, sections, report=report)


def experiment_section(experiment: Experiment) -> Section:
    """Remarks and figures of one experiment."""
    return Section(
        f"{experiment.name} {experiment.title}",
        paragraphs=[experiment.source],
        notes=_lines(experiment.findings),
        pictures=experiment_pictures(experiment),
    )


def _table(result: Identification) -> Table:
    rows = []
    for name, e in result.estimates.items():
        numbers = (f"{e.value:.6g}", f"{e.std:.2g}", e.unit, str(e.n))
        rows.append((name, *numbers, result.origin(name), e.method))
    return Table(_HEADER, rows, frozenset({1, 2, 4}))


def _lines(findings: tuple[Finding, ...]) -> list[str]:
    return [str(finding) for finding in findings]

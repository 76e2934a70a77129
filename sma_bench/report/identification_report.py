"""The report of an identification: numbers with errors, remarks, and the figures behind them."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sma_bench.findings import Finding
from sma_bench.identify import Identification
from sma_bench.identify.estimate import Correlation, Experiment
from sma_bench.progress import Report, silent
from sma_bench.report.experiment_figures import experiment_pictures
from sma_bench.report.page import Picture, Section, Table, write_report

_HEADER = (
    "parameter", "value", "standard error", "of it systematic", "unit", "informed", "points",
    "experiment", "method",
)
_INFORMED = (
    "Informed: the share of what is known of a number that came from these records; the rest was "
    "known before."
)
_WORTH_A_MAP = 0.05


def write_identification_report(
    directory: str | Path, result: Identification, report: Report = silent
) -> Path:
    """Write the report's index.html and PNG figures; `report` hears which one comes.

    Raises:
        InputError: the folder cannot be written.
    """
    correlation = result.correlation
    maps = [_correlation_picture(correlation)] if _is_correlated(correlation) else []
    sections = [
        Section(
            "Parameters", [_INFORMED], tables=[_table(result)], notes=_lines(result.notes),
            pictures=maps,
        )
    ]
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
        systematic = f"{e.systematic:.2g}" if e.systematic else ""
        numbers = (f"{e.value:.6g}", f"{e.std:.2g}", systematic, e.unit)
        informed = f"{100.0 * e.informed:.0f} %"
        rows.append((name, *numbers, informed, str(e.n), result.origin(name), e.method))
    return Table(_HEADER, rows, frozenset({1, 2, 3, 5, 6}))


def _correlation_picture(found: Correlation) -> Picture:
    """The correlation matrix as a map."""
    names = [name.partition(".")[2] for name in found.names]
    size = 2.4 + 0.24 * len(names)
    figure = Figure(figsize=(size + 1.4, size), layout="constrained")
    ax = figure.subplots()
    image = ax.imshow(found.matrix, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    ax.set_yticks(range(len(names)), names, fontsize=7)
    ax.spines[:].set_visible(False)
    figure.colorbar(image, ax=ax, label="correlation of the errors", fraction=0.04)
    caption = (
        "Numbers whose errors hang together are known better as a product, a quotient or a "
        "difference than one by one. Numbers of different experiments share what the "
        "scales of their sensors may be off by."
    )
    return Picture("correlation", "Which errors hang together", caption, figure)


def _is_correlated(found: Correlation) -> bool:
    return bool((np.abs(found.matrix - np.eye(len(found.names))) > _WORTH_A_MAP).any())


def _lines(findings: tuple[Finding, ...]) -> list[str]:
    return [str(finding) for finding in findings]

"""Identify and diagnose from files, and write the results to files: for commands and nodes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sma_bench.compiled import load_aside
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.parameter import BY_NAME, EFFECTS
from sma_bench.physics import core
from sma_bench.physics.simulate import run_once
from sma_bench.progress import Report, by_name, in_turn, part, silent
from sma_bench.records import open_records, read_record
from sma_bench.records.instruments import Phase

if TYPE_CHECKING:  # imported where used: each takes time to load
    from sma_bench.diagnose import Diagnosis
    from sma_bench.identify import Identification

_INFORMED = 0.9  # of its spread: an unstated parameter with a smaller error counts as learnt
_READING, _READING_BAGS = 0.2, 0.05  # share of the time for reading, about
# Seconds that each step of `diagnose` takes for a record of a composite, by the name it reports.
_PLAN = {
    "records": 0.1, "recalibration": 0.7, **dict.fromkeys(EFFECTS, 0.13),
    "effects from the stated parameters": 1.5, "refining the best effects": 0.6,
    "pairs of effects": 1.0, "residuals": 0.3, "shrinkage on held-out data": 0.2,
    "the next experiment": 0.8,
}


def identify_files(paths: Sequence[str], parameters: Parameters,
                   experiments: Sequence[str] | None = None, namespace: str | None = None,
                   report: Report = silent, phases: Mapping[str, Phase] | None = None,
                   stated: Mapping[str, float] | None = None) -> "Identification":
    """Identify from bags and instrument files (`identify/`). `parameters`: known beforehand;
    `experiments`: None for all that the records allow; `namespace`: which of two benches in a bag;
    `phases`: of tensile tests, by file name or pattern; `stated`: quantities missing in instrument
    files. Raises InputError: a record that cannot be read, or nothing to identify."""
    from sma_bench.identify import identify

    load_aside(core.run, run_once)
    reading = in_turn(paths, part(report, 0.0, _READING), "reading {}".format)
    records = [record for path in reading for record in open_records(path, namespace, stated)]
    return identify(records, parameters, experiments, part(report, _READING, 1.0), phases)


def diagnose_files(paths: Sequence[str], hold_out: Sequence[str], parameters: Parameters,
                   quantities: Sequence[str] = QUANTITIES, report: Report = silent) -> "Diagnosis":
    """Diagnose the gap between bags of one bench and its model with the stated parameters
    (`diagnose/`), its shrinkage on `hold_out`. InputError: a bag cannot be read or compared."""
    from sma_bench.diagnose import diagnose

    load_aside(core.run, run_once)
    reading = in_turn([*paths, *hold_out], part(report, 0.0, _READING_BAGS), "reading {}".format)
    records, seen = [read_record(path) for path in reading], len(paths)
    reporter = by_name(part(report, _READING_BAGS, 1.0), _PLAN)
    return diagnose(records[:seen], parameters, records[seen:], reporter, quantities)


def write_identified(path: str | Path, result: "Identification", author: str,
                     sources: Sequence[str], template: str | Path | None = None) -> None:
    """Write the identified parameters; comments of the file `template` are kept. If the model does
    not fit well, the first comment says so. Raises InputError: the file cannot be written."""
    comment = f"Identified by {author} from {', '.join(sources)}".replace("\n", " ")
    if fit := result.fit_line:
        comment = f"{fit}.\n{comment}"
    origins = {name: f"identified, {result.origin(name)}" for name in result.estimates}
    write_parameters(path, result.parameters, comment, sources=origins, template=template)


def write_improved(path: str | Path, result: "Diagnosis", author: str) -> None:
    """Write those improved parameters that were stated or learnt. InputError: cannot write."""
    improved, stated = result.improved, result.parameters.given
    learnt = {n for n in improved.given if (spread := BY_NAME[n].spread) is None
            or improved.std(n) < _INFORMED * spread}
    names = [n for n in improved if n in stated | learnt]
    sources = ", ".join(dict.fromkeys(view.path for view in result.observations))
    comment = f"Improved by {author} from {sources}".replace("\n", " ")
    write_parameters(path, result.improved, comment, names)

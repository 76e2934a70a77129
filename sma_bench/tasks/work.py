"""From files to results and from results to files, for whoever asks."""

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

if TYPE_CHECKING:  # who wants the one need not load the other
    from sma_bench.diagnose import Diagnosis
    from sma_bench.identify import Identification

_TOLD = 0.9  # of the spread that a number has which nobody stated
_READING, _READING_BAGS = 0.2, 0.05  # shares of the time, about
# Seconds that each step takes of a composite record, as `diagnose` names them.
_PLAN = {
    "records": 0.1, "recalibration": 0.7, **dict.fromkeys(EFFECTS, 0.13),
    "effects instead of surprising parameters": 1.5, "the best again, carefully": 0.6,
    "pairs": 1.0, "what is left": 0.3, "shrinkage on data that no fit saw": 0.2,
    "the next experiment": 0.8,
}


def identify_files(paths: Sequence[str], parameters: Parameters,
                   experiments: Sequence[str] | None = None, namespace: str | None = None,
                   report: Report = silent, phases: Mapping[str, Phase] | None = None,
                   stated: Mapping[str, float] | None = None) -> "Identification":
    """Identify from bags and instrument files (`identify/`). `parameters`: known beforehand;
    `experiments`: None for all that the records allow; `namespace`: of two benches in one bag;
    `phases`: of tensile tests, by file name or pattern of names; `stated`: what instruments' files
    do not hold. Raises InputError: a record that cannot be read, or nothing to identify."""
    from sma_bench.identify import identify

    load_aside(core.run, run_once)
    reading = in_turn(paths, part(report, 0.0, _READING), "reading {}".format)
    records = [record for path in reading for record in open_records(path, namespace, stated)]
    return identify(records, parameters, experiments, part(report, _READING, 1.0), phases)


def diagnose_files(paths: Sequence[str], hold_out: Sequence[str], parameters: Parameters,
                   quantities: Sequence[str] = QUANTITIES, report: Report = silent) -> "Diagnosis":
    """Diagnose the gap between bags of one bench and its model as believed (`diagnose/`), its
    shrinkage on those of `hold_out`. InputError: a bag that cannot be read or compared."""
    from sma_bench.diagnose import diagnose

    load_aside(core.run, run_once)
    reading = in_turn([*paths, *hold_out], part(report, 0.0, _READING_BAGS), "reading {}".format)
    records, seen = [read_record(path) for path in reading], len(paths)
    reporter = by_name(part(report, _READING_BAGS, 1.0), _PLAN)
    return diagnose(records[:seen], parameters, records[seen:], reporter, quantities)


def write_identified(path: str | Path, result: "Identification", author: str,
                     sources: Sequence[str], template: str | Path | None = None) -> None:
    """Write the parameters with what was identified; comments of the file `template` stay, and
    that the model does not fit is the first. Raises InputError: the file cannot be written."""
    comment = f"Identified by {author} from {', '.join(sources)}".replace("\n", " ")
    if said := result.fit_line:
        comment = f"{said}.\n{comment}"
    origins = {name: f"identified, {result.origin(name)}" for name in result.estimates}
    write_parameters(path, result.parameters, comment, sources=origins, template=template)


def write_improved(path: str | Path, result: "Diagnosis", author: str) -> None:
    """Write the improved parameters, if stated or learnt. InputError: it cannot be written."""
    improved, stated = result.improved, result.parameters.given
    told = {n for n in improved.given if (spread := BY_NAME[n].spread) is None
            or improved.std(n) < _TOLD * spread}
    names = [n for n in improved if n in stated | told]
    sources = ", ".join(dict.fromkeys(view.path for view in result.observations))
    comment = f"Improved by {author} from {sources}".replace("\n", " ")
    write_parameters(path, result.improved, comment, names)

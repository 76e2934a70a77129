"""Make a set of cases: bags, what the owners believe, and labels under seal."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import joblib
import numpy as np

from examination.bags import in_sqlite3
from examination.blind.case_files import CASES, LABELS, MANIFEST, STAGE_OF, seal
from examination.blind.cases import (
    NONE,
    OUTSIDE,
    QUANTITIES,
    RECALIBRATION,
    Case,
    draw_cases,
    split_of,
)
from examination.blind.rigs import (
    RECORDS,
    Array,
    Stage,
    gaps,
    largest,
    quantity_of,
    stage_of_parameter,
    true_values,
    where,
    world_of,
)
from examination.blind.sensors import measure
from examination.blind.severity import (
    Separation,
    Sized,
    measured,
    readings_of,
    rounded,
    separation,
    size,
)
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.records.bag_writer import write_record

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
        "noise": case.card.noise,
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
        "load": load_kind(case.truth),
        "truth": true_values(case.truth),
        "sensors": stage.sensors.to_json(),
        "drives": {name: drive.to_json() for name, drive in case.drives.items()},
        "starts": dict(case.starts),
        "version": VERSION,
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


# --- A set in a new folder.

NOMINAL = "nominal.yaml"
LARGEST_SET = 9999
_LAYOUT = 1


def make(
    out: str | Path,
    seed: int,
    n: int,
    jobs: int = 1,
    progress: Callable[[int], None] = lambda done: None,
    load: str = "beam",
) -> dict[str, Any]:
    """Make n cases in a new folder, which appears when all of them are there.

    Args:
        out: new folder.
        seed: the same seed and n give the same bytes, whatever the number of jobs.
        n: number of cases.
        jobs: processes that share the work.
        progress: called with the number of finished cases.
        load: what the wires of all rigs pull against.

    Returns:
        The manifest.

    Raises:
        InputError: the folder exists or cannot be made, or a number out of range.
    """
    out = Path(out)
    _require(0 <= seed < 2**31, f"seed {seed}", "a whole number from 0 to 2147483647")
    _require(1 <= n <= LARGEST_SET, f"number of cases {n}", f"1 to {LARGEST_SET}")
    _require(1 <= jobs <= 64, f"jobs {jobs}", "1 to 64")
    with new_folder(out) as folder:
        (folder / CASES).mkdir()
        labels = _make_all(draw_cases(seed, n, load), folder / CASES, jobs, progress)
        manifest = {
            "layout": _LAYOUT,
            "version": VERSION,
            "seed": seed,
            "n": n,
            "split": split_of(seed),
            "load": load,
            "cases": [label["id"] for label in labels],
            "sha256": seal(folder / LABELS, labels),
        }
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return manifest


def _require(holds: bool, what: str, expected: str) -> None:
    if not holds:
        raise InputError(f"blind make: {what}, expected {expected}")


@contextmanager
def new_folder(out: str | Path) -> Iterator[Path]:
    """A folder to fill that becomes `out` when all went well, and vanishes when not."""
    out = Path(out)
    if out.exists():
        raise InputError(f"{out}: exists already, expected a new folder")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        parent = Path(mkdtemp(prefix=f".{out.name}.", dir=out.parent))
        folder = parent / out.name
        folder.mkdir()
    except OSError as error:
        raise InputError(f"{out}: cannot be made: {error.strerror}") from None
    try:
        yield folder
        if out.exists():
            raise InputError(f"{out}: exists already, expected a new folder")
        folder.rename(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}") from None
    finally:
        shutil.rmtree(parent, ignore_errors=True)


def _make_all(
    cases: list[Case], folder: Path, jobs: int, progress: Callable[[int], None]
) -> list[dict[str, Any]]:
    labels = []
    if jobs > 1:
        calls = (joblib.delayed(make_case)(case, folder) for case in cases)
        made = joblib.Parallel(jobs, return_as="generator")(calls)
    else:  # joblib's own way in one process now and then lets an interrupt past its caller
        made = (make_case(case, folder) for case in cases)
    for label in made:
        labels.append(label)
        progress(len(labels))
    return labels


def make_case(case: Case, folder: Path) -> dict[str, Any]:
    """Write the bags and the believed numbers of a case below `folder`; its label."""
    stage = Stage(case.truth, case.sensors, case.drives)
    sized = size(case, stage)
    label = _label(case, stage, sized)
    place = folder / case.name
    shutil.rmtree(place, ignore_errors=True)  # a process that was killed may have left half of it
    place.mkdir()
    for record in RECORDS:
        _write_bag(case, stage, sized, record, place / record)
    write_parameters(place / NOMINAL, case.nominal, names=sorted(case.nominal.given))
    return label


def _label(case: Case, stage: Stage, sized: Sized) -> dict[str, Any]:
    truth, without = readings_of(stage, sized.features), reference(case, stage, sized)
    found: Separation | None = None
    if case.card.kind not in (NONE, RECALIBRATION):
        quantities = QUANTITIES[case.card.signals]
        own = case.card.effects[0] if len(case.card.effects) == 1 else ""
        found = separation(stage, sized.base, truth, without, quantities, own)
    return make_label(case, stage, sized, truth, without, found)


def _write_bag(case: Case, stage: Stage, sized: Sized, record: str, path: Path) -> None:
    outcome = stage.play(sized.features, record)
    world, quantities = world_of(case.truth, sized.features), QUANTITIES[case.card.signals]
    signals = measure(
        outcome, world, case.sensors, stage.channels, case.stream(record), quantities
    )
    write_record(path, signals, case.namespace, case.starts[record])
    if case.storage == "sqlite3":
        in_sqlite3(path)


def digest(folder: str | Path) -> str:
    """sha256 over the names and bytes of all files of a set."""
    total = hashlib.sha256()
    for path in sorted(p for p in Path(folder).rglob("*") if p.is_file()):
        total.update(str(path.relative_to(folder)).encode() + b"\0")
        total.update(np.uint64(path.stat().st_size).tobytes() + path.read_bytes())
    return total.hexdigest()

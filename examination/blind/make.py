"""Make a set of cases: bags, what the owners believe, and labels under seal."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import joblib

from examination.bags import in_sqlite3
from examination.blind import rigs
from examination.blind.case_files import CASES, LABELS, MANIFEST, RECALIBRATION, STAGE_OF, seal
from examination.blind.cases import NONE, OUTSIDE, QUANTITIES, Case, draw_cases, split_of
from examination.blind.rigs import RECORDS, gaps
from examination.blind.sensors import measure
from examination.blind.severity import Sized, measured, separation, size
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters import write_parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.records.bag_writer import write_record


def make_label(case: Case, sized: Sized) -> dict[str, Any]:
    """Everything that a scorer may want to know, as plain JSON."""
    card, load, quantities = case.card, load_kind(case.truth), QUANTITIES[case.card.signals]
    # Noise-free readings, and those without what is hidden: the effect, or the owners' mistakes.
    believed = None
    if case.wrong:
        twins = {n for name in case.wrong for n in (name, name.replace("_front", "_back"))}
        believed = case.truth.replace({name: case.nominal[name] for name in twins})
    truth = {r: case.read(sized.features, r) for r in RECORDS}
    without = {r: case.read(sized.base, r, parameters=believed) for r in RECORDS}
    gap = {
        r: {name: round(value, 4) for name, value in
            gaps(truth[r], without[r], case.sensors, quantities).items()}
        for r in RECORDS
    }  # fmt: skip
    severity = 0.0 if card.kind == NONE else max(max(gap[r].values()) for r in RECORDS)
    stages = [STAGE_OF.get(name) or OUTSIDE[name].stage for name in card.effects]
    if card.kind == RECALIBRATION:
        stages = sorted({rigs.numbers(load)[name].stage for name in case.wrong})
    # Of each effect: the gap that it makes beside the others.
    severities = {
        name: severity if len(card.effects) == 1
        else round(measured(case, sized.features, sized.without(name), quantities), 4)
        for name in card.effects
    }  # fmt: skip
    found: dict[str, Any] = {}
    if card.kind not in (NONE, RECALIBRATION):
        own = card.effects[0] if len(card.effects) == 1 else ""
        found = separation(case, sized.base, truth, without, quantities, own)
    # Where it shows in the record that a diagnosis sees: signal of the largest gap; phase and side
    # of most of that signal's share; stage of the largest effect; the twelve largest cells.
    place: dict[str, Any] | None = None
    if severity:
        first = RECORDS[0]
        table = rigs.where(truth[first], without[first], case, first, quantities)
        signal = max(gap[first], key=lambda name: gap[first][name])
        most = next(row for row in table if row["signal"] == signal)
        place = {
            "signal": rigs.quantity_of(signal), "channel": signal.rpartition(".")[0],
            "phase": most["phase"], "side": most["side"], "stage": stages[0],
            "table": [{**row, "gap": round(row["gap"], 4), "share": round(row["share"], 4)}
                      for row in table[:12]],
        }  # fmt: skip
    return {
        "id": case.name,
        "kind": card.kind,
        "effects": list(card.effects),
        "stages": stages,
        "signals": card.signals,
        "noise": card.noise,
        "kinetics": card.mild_kinetics,
        "severity": severity,
        "severities": severities,
        "targets": list(card.targets),
        "amounts": dict(sized.amounts),
        "gap": gap,
        "nuisance_gap": round(sized.nuisance_gap, 4),
        "kinetics_gap": round(sized.kinetics_gap, 4),
        "wrong": dict(case.wrong),
        "where": place,
        "distinguishable": found.pop("distinguishable", True),
        "separation": found or None,
        "features": dict(sorted(sized.features.items())),
        "base": dict(sorted(sized.base.items())),
        "load": load,
        "truth": rigs.true_values(case.truth),
        "sensors": asdict(case.sensors),
        "drives": {name: vars(drive) for name, drive in case.drives.items()},
        "starts": dict(case.starts),
        "version": VERSION,
    }


# --- A set in a new folder.

NOMINAL = "nominal.yaml"
LARGEST_SET = 9999
_LAYOUT = 1


def make(out: str | Path, seed: int, n: int, jobs: int = 1, load: str = "beam") -> dict[str, Any]:
    """Make n cases in a new folder, which appears when all of them are there; its manifest. The
    same seed and n give the same bytes, whatever the number of jobs. Raises InputError where the
    folder exists or cannot be made, and for a number out of range."""
    out = Path(out)
    for what, value, low, high in (
        ("seed", seed, 0, 2**31 - 1), ("number of cases", n, 1, LARGEST_SET), ("jobs", jobs, 1, 64),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(f"blind make: {what} {value}, expected {low} to {high}")
    if out.exists():
        raise InputError(f"{out}: exists already, expected a new folder")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as parent:
            folder = Path(parent) / out.name
            (folder / CASES).mkdir(parents=True)
            cases = draw_cases(seed, n, load)
            if jobs > 1:
                calls = (joblib.delayed(make_case)(case, folder / CASES) for case in cases)
                labels = joblib.Parallel(jobs)(calls)
            else:  # joblib's own way in one process now and then lets an interrupt past its caller
                labels = [make_case(case, folder / CASES) for case in cases]
            manifest = {
                "layout": _LAYOUT, "version": VERSION, "seed": seed, "n": n, "load": load,
                "split": split_of(seed), "cases": [label["id"] for label in labels],
                "sha256": seal(folder / LABELS, labels),
            }  # fmt: skip
            text = json.dumps(manifest, indent=1) + "\n"
            (folder / MANIFEST).write_text(text, encoding="utf-8")
            folder.rename(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be made: {error.strerror}") from None
    return manifest


def make_case(case: Case, folder: Path) -> dict[str, Any]:
    """Write the bags and the believed numbers of a case below `folder`; its label."""
    case = replace(case)  # what is played for it goes with it
    sized = size(case)
    label = make_label(case, sized)
    place = folder / case.name
    shutil.rmtree(place, ignore_errors=True)  # a process that was killed may have left half of it
    place.mkdir()
    world, quantities = rigs.world_of(case.truth, sized.features), QUANTITIES[case.card.signals]
    for record in RECORDS:
        outcome, random = case.play(sized.features, record), case.stream(record)
        signals = measure(outcome, world, case.sensors, case.channels, random, quantities)
        write_record(place / record, signals, case.namespace, case.starts[record])
        if case.storage == "sqlite3":
            in_sqlite3(place / record)
    write_parameters(place / NOMINAL, case.nominal, names=sorted(case.nominal.given))
    return label

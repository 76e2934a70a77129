"""Upper limits of the withheld-effect check: is a miss due to the records, the model or the search?
Synthetic.

    ./bench check ceilings SET --out DIR [--cases N] [--time-limit S]

SET must have been answered (`./bench blind run SET`). Its measures are compared with those of the
same records when the lab's parameters are true to a tenth of their stated errors (exact), and of
the same cases simulated with the model's own physics, each effect as large as the answer's fit of
it (model).

A case missed there, too, is due to the records or to the search: the true cause is fitted once
more, starting from the true parameters. If this fit has 5 nats more than the search found, the
search has failed.
"""

import shutil
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind import case_files as files
from examination.blind import examination as blind
from examination.blind.cases import QUANTITIES
from examination.blind.command import DIAGNOSE
from examination.blind.reality import Outcome, World
from examination.blind.rigs import COMMAND_PERIOD, Stage
from examination.blind.score import as_markdown, open_labels, score, side_by_side
from examination.blind.sensors import measure
from examination.check.effects import deviations_of
from examination.pieces import options_of
from sma_bench.diagnose.search import find_start, remainder, search
from sma_bench.estimation import observation
from sma_bench.estimation.solver import fit
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import simulate_finely

COLUMNS = ("as it is", "exact parameters", "the model's physics")
_SHARE = 0.1  # of the stated standard deviations: errors of "exact" parameters
_FAILURE = 5.0  # nats: more than this above the search's result is a failure of the search
_STREAM = 2_000_003
_START_NS = 1_750_000_000 * 10**9
Label = Mapping[str, Any]


def main(argv: Sequence[str] | None = None) -> int:
    options = options_of("ceilings", __doc__, argv, set=(..., "answered"), out=(Path, "new folder"),
                         cases=(int, "the first so many only"), time_limit=(600.0, "s a case"))
    if options.out is None:
        print("ceilings: no --out, expected a new folder", file=sys.stderr)
        return 2
    whole = files.read_case_set(options.set)
    labels = open_labels(whole)
    names = whole.names[: options.cases]
    options.out.mkdir(parents=True)
    # With right parameters there is no recalibration; the model has no effect outside the library.
    variants = {"as_is": (None, ""), "exact": (make_exact, "recalibration"),
                "model": (make_by_model, "outside")}
    scores = []
    for variant, (change, without) in variants.items():
        chosen = tuple(n for n in names if labels[n]["kind"] != without)
        cases = replace(whole, root=options.out / variant, names=chosen)
        for name in cases.names:
            shutil.copytree(whole.folder / name, cases.folder / name)
            if change:
                change(cases.folder / name, labels[name], whole)
            else:
                shutil.copytree(whole.answers / name, cases.answers / name)
        examinee = blind.Examinee(DIAGNOSE, options.time_limit)
        due = blind.open_cases(cases.names, cases.answers)
        blind.examine(examinee, due, cases.folder, cases.answers, jobs=2)
        scores += score(cases, labels, cases.answers)
    rows = [(m.title, *values) for m, values in side_by_side(scores)]
    print(*as_markdown(("measure", *COLUMNS), rows), sep="\n")
    print()
    found, rows = defaultdict(list), []
    for name in names:
        label = labels[name]
        if label["kind"] in ("single", "pair", "recalibration"):
            what = label["effects"][0] if label["kind"] == "single" else label["kind"]
            found[what].append(missed_by_the_search(whole.folder / name, label))
    for what, missed in sorted(found.items()):
        failures = sum(nats > _FAILURE for nats in missed)
        rows.append((what, f"{len(missed)}", f"{failures}", f"{max(0.0, *missed):.1f}"))
    head = "truth", "cases", "failures of the search", "nats missed at most"
    print(*as_markdown(head, rows), sep="\n")
    return 0


# --- The variants of a case.
def make_exact(case: Path, label: Label, _: files.CaseSet) -> None:
    nominal = read_parameters(case / blind.NOMINAL)
    stds = {n: _SHARE * s for n, s in nominal.given_uncertainty.items()}
    right = {n: label["truth"][n] for n in stds if n in label["truth"]}
    twins = {n.replace("_front", "_back"): v for n, v in right.items() if n.endswith("_front")}
    both = right | {n: v for n, v in twins.items() if n in nominal.given}
    exact = nominal.replace(both, stds)
    write_parameters(case / blind.NOMINAL, exact, names=sorted(exact.given))


def make_by_model(case: Path, label: Label, whole: files.CaseSet) -> None:
    # Numbers of the true effects, as fitted in the answer.
    answer = files.read_kept(whole.answers, label["id"]).answer
    fitted = {c.name: {name: number["value"] for name, number in c.parameters.items()}
              for c in (answer.candidates if answer else ())}
    effects = {n: v for name in label["effects"] for n, v in fitted.get(name, {}).items()}
    effects |= fitted.get(files.PAIR_SIGN.join(sorted(label["effects"])), {})
    stage = Stage.from_label(label)
    bench = stage.truth.replace(effects)
    world = World(stage.truth, {})
    for number, record in enumerate((blind.RECORD, blind.HOLD_OUT)):
        drive = stage.drives[record]
        time = drive.grid(COMMAND_PERIOD)
        found = simulate_finely(bench, time, drive.voltage(time, stage.sides))
        outcome = Outcome(time, found.voltage, found.current, found.temperature_reading,
                          found.temperature_reading, found.martensite_fraction, found.stress,
                          found.deflection_reading, np.full(len(time), 293.0))
        random = np.random.default_rng([_STREAM, int(label["id"]), number])
        signals = measure(outcome, world, stage.sensors, random, QUANTITIES[label["signals"]])
        write_record(case / record, signals, "bench", _START_NS, replace=True)


def missed_by_the_search(case: Path, label: Label) -> float:
    """Nats by which a fit of the true cause from the true parameters exceeds the search's."""
    nominal = read_parameters(case / blind.NOMINAL)
    records = [read_record(case / name) for name in (blind.RECORD, blind.HOLD_OUT)]
    found = search(observation.observe_all(records, nominal, observation.QUANTITIES), nominal)
    effects = [name for name in label["effects"] if name in found.singles]
    if len(effects) < len(label["effects"]):
        return 0.0  # no measured quantity shows the effect
    best = found.singles[effects[0]] if len(effects) == 1 else found.recalibrated
    if len(effects) > 1:
        first, second = sorted(effects, key=lambda e: found.singles[e].evidence, reverse=True)
        alone, both = found.singles[first], found.pairs.get((min(effects), max(effects)))
        if both is None:
            unknowns = found.recalibrated.unknowns.with_effects([first, second])
            start = find_start(alone, remainder(alone), unknowns)
            both = fit(found.problem, unknowns, start.x)
        best = both
    # The true parameters of the bench; products of parameters are one number.
    unknowns = best.unknowns
    values = unknowns.values(best.x).tolist()
    for k, item in enumerate(unknowns.items[: unknowns.bench]):
        if item.name in label["truth"]:
            values[k] = label["truth"][item.name]
            if item.partner:
                values[k] *= label["truth"][item.partner] / nominal[item.partner]
    true = deviations_of(unknowns, values)[: unknowns.bench]
    again = fit(best.problem, unknowns, np.concatenate([true, best.x[unknowns.bench :]]), far=True)
    return float(again.evidence - best.evidence)

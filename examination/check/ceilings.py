"""Upper limits of the withheld-effect check: is a miss due to the records, the model or the search?
Synthetic.

    ./bench check ceilings SET --out DIR [--cases N] [--time-limit S]

SET must have been answered (`./bench blind run SET`). Its measures are compared with those of the
same records when the lab's parameters are true to a tenth of their stated errors (exact), or after
every test of the paper that would narrow one (tested), and of the same cases simulated with the
model's own physics, each effect as large as the answer's fit of it (model).

A case missed there, too, is due to the records or to the search. To decide, the true cause is
fitted once more, starting from the true parameters. If this fit has 5 nats more than the search
found, the search has failed; if it gains less over the truth without its (second) effect than an
effect needs to be named, the records do not show the effect.
"""

import json
import shutil
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.blind import case_files as files
from examination.blind import examination as blind
from examination.blind.cases import QUANTITIES
from examination.blind.command import DIAGNOSE
from examination.blind.reality import Outcome, World
from examination.blind.rigs import COMMAND_PERIOD, Stage
from examination.blind.score import as_markdown, handed_in, open_labels, score, side_by_side
from examination.blind.sensors import measure
from examination.pieces import options_of
from sma_bench.diagnose.search import find_start, remainder, search
from sma_bench.estimation import observation
from sma_bench.estimation.solver import fit
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.parameters.paper_tests import least_stds
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import simulate_finely

DIAGNOSIS = "diagnosis"
COLUMNS = ("as it is", "exact parameters", "all tests done", "the model's physics")
_SHARE = 0.1  # of the stated standard deviations: errors of "exact" parameters
_FAILURE = 5.0  # nats: more than this above the search's result is a failure of the search
_STREAM = 2_000_003
_START_NS = 1_750_000_000 * 10**9
Label = Mapping[str, Any]
# Least gain in nats to name a cause: of a single effect over recalibration, of a pair over its
# better effect alone.
THRESHOLD, PAIR_THRESHOLD = 5.5, 10.7
NEEDED = {"single": THRESHOLD, "pair": PAIR_THRESHOLD, "recalibration": -np.inf}


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
                "tested": (make_tested, ""), "model": (make_by_model, "outside")}
    scores = []
    for variant, (change, without) in variants.items():
        cases = copied(options.out / variant, whole, labels,
                       [n for n in names if labels[n]["kind"] != without])
        answers = cases.answers / DIAGNOSIS
        for name in cases.names:
            if change:
                change(cases.folder / name, labels[name], whole)
            else:
                shutil.copytree(whole.answers / DIAGNOSIS / name, answers / name)
        examinee = blind.Examinee(DIAGNOSE, options.time_limit)
        due = blind.open_cases(cases.names, answers)
        blind.examine(examinee, due, cases.folder, answers, jobs=2)
        scores += score(cases, handed_in(cases, [answers]), labels)
    rows = [(m.title, *values) for m, values in side_by_side(scores)]
    print(*as_markdown(("measure", *COLUMNS), rows), sep="\n")
    print(f"\nNot in the records: the true cause gains less than {THRESHOLD} nats over "
          f"recalibration, a pair less than {PAIR_THRESHOLD} over its better effect alone.\n")
    found, rows = defaultdict(list), []
    for name in names:
        label = labels[name]
        if label["kind"] in NEEDED:
            what = label["effects"][0] if label["kind"] == "single" else label["kind"]
            found[what].append(from_the_truth(whole.folder / name, label))
    for what, each in sorted(found.items()):
        failures = sum(missed > _FAILURE for missed, _ in each)
        most = max(0.0, *(missed for missed, _ in each))
        hidden = sum(gain < NEEDED.get(what, NEEDED["single"]) for _, gain in each)
        rows.append((what, f"{len(each)}", f"{failures}", f"{most:.1f}", f"{hidden}"))
    head = "truth", "cases", "failures of the search", "nats missed at most", "not in the records"
    print(*as_markdown(head, rows), sep="\n")
    return 0


def copied(root: Path, whole: files.CaseSet, labels: Mapping[str, Label],
           names: Sequence[str]) -> files.CaseSet:
    """A copy of some of the cases, for the diagnosis to answer."""
    for name in names:
        shutil.copytree(whole.folder / name, root / files.CASES / name)
    sealed = files.seal(root / files.LABELS, [dict(labels[name]) for name in names])
    document = {"seed": whole.seed, "split": whole.split, "cases": list(names), "sha256": sealed}
    (root / files.MANIFEST).write_text(json.dumps(document))
    examination = files.Examination(DIAGNOSIS, DIAGNOSE, 600.0, sealed)
    files.write_examination(root / files.ANSWERS / DIAGNOSIS, examination)
    return files.read_case_set(root)


# --- The variants of a case.
def make_exact(case: Path, label: Label, _: files.CaseSet) -> None:
    nominal = read_parameters(case / blind.NOMINAL)
    stds = {n: _SHARE * s for n, s in nominal.given_uncertainty.items()}
    right = {n: label["truth"][n] for n in stds if n in label["truth"]}
    twins = {n.replace("_front", "_back"): v for n, v in right.items() if n.endswith("_front")}
    both = right | {n: v for n, v in twins.items() if n in nominal.given}
    exact = nominal.replace(both, stds)
    write_parameters(case / blind.NOMINAL, exact, names=sorted(exact.given))


def make_tested(case: Path, label: Label, whole: files.CaseSet) -> None:
    nominal = read_parameters(case / blind.NOMINAL)
    stated = nominal.given_uncertainty
    stds = {n: std for n, std in least_stds(nominal).items() if std < stated.get(n, 0.0)}
    asked = files.NextExperiment((), {}, stds)
    random = np.random.default_rng([_STREAM, whole.seed, int(case.name)])
    tested = blind.after_tests(label, asked, nominal, random)
    write_parameters(case / blind.NOMINAL, tested, names=sorted(tested.given))


def make_by_model(case: Path, label: Label, whole: files.CaseSet) -> None:
    # Numbers of the true effects, as fitted in the answer.
    answer = files.read_kept(whole.answers / DIAGNOSIS, label["id"]).answer
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
                          found.deflection_reading, found.bending, np.full(len(time), 293.0))
        random = np.random.default_rng([_STREAM, int(label["id"]), number])
        signals = measure(outcome, world, stage.sensors, random, QUANTITIES[label["signals"]])
        write_record(case / record, signals, "bench", _START_NS, replace=True)


def from_the_truth(case: Path, label: Label) -> tuple[float, float]:
    """Fit the true cause, starting from the truth: its gain in nats over the result of the search,
    and over the truth without its (second) effect."""
    nominal = read_parameters(case / blind.NOMINAL)
    records = [read_record(case / name) for name in (blind.RECORD, blind.HOLD_OUT)]
    found = search(observation.observe_all(records, nominal, observation.QUANTITIES), nominal)
    effects = [name for name in label["effects"] if name in found.singles]
    if len(effects) < len(label["effects"]):
        return 0.0, 0.0  # no measured quantity shows the effect
    # Evidence without the (second) effect, and with all effects.
    without, best = -np.inf, found.recalibrated
    if len(effects) == 1:
        without, best = found.recalibrated.evidence, found.singles[effects[0]]
    elif effects:
        first, second = sorted(effects, key=lambda e: found.singles[e].evidence, reverse=True)
        alone = found.singles[first]
        without, both = alone.evidence, found.pairs.get((min(effects), max(effects)))
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
    true = unknowns.x_of(values)[: unknowns.bench]
    again = fit(best.problem, unknowns, np.concatenate([true, best.x[unknowns.bench :]]), far=True)
    most = max(again.evidence, best.evidence)
    return float(again.evidence - best.evidence), float(most - without)

"""What the withheld-effect check could reach at most: is a miss the record's, the model's or the
search's?

    ./bench check ceilings SET --out DIR [--cases N] [--time-limit S]

SET has been answered (`./bench blind run SET`). Beside its measures stand those of

- exact: the same records, the lab's parameters true to a tenth of what it states;
- tested: the same records, after every test of the paper (E1 to E3, E6 to E8, DSC) that would
  narrow a parameter: what no proposal of a test can add to;
- model: the same cases made by the model's own physics, each effect as large as the answer's fit of
  it, read by the same instruments (without effects that no library has).

What is missed there too is in no record, or is the search's: what is there is fitted once more from
the true parameters. Such a fit that ends with more evidence than the search found by 5 nats is a
failure of the search; one that gains less over the truth without its effect (of a pair: its second
one) than an effect must gain to be named shows that the effect is in no record. Synthetic.
"""

import argparse
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from examination.blind.case_files import (
    ANSWERS,
    CASES,
    LABELS,
    MANIFEST,
    PAIR_SIGN,
    CaseSet,
    Examination,
    NextExperiment,
    read_case_set,
    read_kept,
    seal,
    write_examination,
)
from examination.blind.cases import QUANTITIES
from examination.blind.command import DIAGNOSE
from examination.blind.examination import (
    HOLD_OUT,
    NOMINAL,
    RECORD,
    Examinee,
    after_tests,
    examine,
    open_cases,
)
from examination.blind.measures import TARGETS
from examination.blind.page import side_by_side
from examination.blind.reality import Outcome, World
from examination.blind.rigs import CHANNELS, COMMAND_PERIOD, Drive, rig_of
from examination.blind.score import handed_in, open_labels, score
from examination.blind.sensors import Sensors, measure
from sma_bench.diagnose.decision import PAIR_THRESHOLD, THRESHOLD
from sma_bench.diagnose.drives import least_stds
from sma_bench.diagnose.search import Search, search
from sma_bench.diagnose.starts import Remainder, find_start
from sma_bench.estimation.observation import observe, shared_bin
from sma_bench.estimation.solver import Fit, fit
from sma_bench.parameters import Parameters, read_parameters, write_parameters
from sma_bench.records import read_record
from sma_bench.records.bag_writer import write_record
from sma_bench.synthetic.bench_records import simulate_finely

EXACT, TESTED, MODEL = "exact", "tested", "model"
DIAGNOSIS = "diagnosis"
_SHARE = 0.1  # of the stated standard deviations
_FAILURE = 5.0  # nats
_STREAM = 2_000_003
_START_NS = 1_750_000_000 * 10**9

Label = Mapping[str, Any]
# Nats that an effect must gain to be named, by kind of case; of recalibration there is none.
NEEDED = {"single": THRESHOLD, "pair": PAIR_THRESHOLD, "recalibration": -np.inf}
HIDDEN = (
    f"In no record: the truth gains less than {THRESHOLD} nats over recalibration, of a pair less "
    f"than {PAIR_THRESHOLD} over its better effect alone."
)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("set", metavar="SET")
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder")
    parser.add_argument("--cases", type=int, metavar="N", help="the first N only")
    parser.add_argument("--time-limit", type=float, default=600.0, metavar="S")
    args = parser.parse_args(argv)
    whole = read_case_set(args.set)
    labels = open_labels(whole)
    names = whole.names[: args.cases]
    out = Path(args.out)
    out.mkdir(parents=True)
    asis = made(out / "as_is", whole, labels, names)
    for name in names:
        shutil.copytree(whole.answers / DIAGNOSIS / name, asis.answers / DIAGNOSIS / name)
    exact = made(out / EXACT, whole, labels, [n for n in names if with_effect_or_none(labels[n])])
    for name in exact.names:
        make_exact(exact.folder / name, labels[name])
    tested = made(out / TESTED, whole, labels, names)
    for name in names:
        make_tested(tested.folder / name, labels[name], whole.seed)
    model = made(out / MODEL, whole, labels, [n for n in names if labels[n]["kind"] != "outside"])
    for name in model.names:
        make_by_model(model.folder / name, labels[name], effects_of(whole, labels[name]))
    scores = []
    for cases in (asis, exact, tested, model):
        examined(cases, args.time_limit)
        paper = handed_in(cases, [cases.answers / DIAGNOSIS])
        scores += score(cases, paper, labels)
    print("| measure | as it is | exact parameters | all tests done | the model's physics |")
    print("| --- | --- | --- | --- | --- |")
    for row in side_by_side(scores, TARGETS):
        print(f"| {' | '.join(row)} |")
    print_failures(whole, labels, names)
    return 0


def with_effect_or_none(label: Label) -> bool:
    """Nothing is left of wrong parameters once they are right."""
    return label["kind"] != "recalibration"


def made(root: Path, whole: CaseSet, labels: Mapping[str, Label], names: Sequence[str]) -> CaseSet:
    """A set of some of the cases."""
    for name in names:
        shutil.copytree(whole.folder / name, root / CASES / name)
    sealed = seal(root / LABELS, [dict(labels[name]) for name in names])
    document = {"seed": whole.seed, "split": whole.split, "cases": list(names), "sha256": sealed}
    (root / MANIFEST).write_text(json.dumps(document))
    found = read_case_set(root)
    program = DIAGNOSE
    write_examination(root / ANSWERS / DIAGNOSIS, Examination(DIAGNOSIS, program, 600.0, sealed))
    return found


def examined(cases: CaseSet, limit: float) -> None:
    answers = cases.answers / DIAGNOSIS
    examinee = Examinee(DIAGNOSE, limit)
    examine(examinee, open_cases(cases.names, answers), cases.folder, answers)


# --- The variants of a case.


def make_exact(case: Path, label: Label) -> None:
    believed = read_parameters(case / NOMINAL)
    stds = {n: _SHARE * s for n, s in believed.given_uncertainty.items()}
    right = {n: label["truth"][n] for n in stds if n in label["truth"]}
    twins = {n.replace("_front", "_back"): v for n, v in right.items() if n.endswith("_front")}
    both = right | {n: v for n, v in twins.items() if n in believed.given}
    exact = believed.replace(both, stds)
    write_parameters(case / NOMINAL, exact, names=sorted(exact.given))


def make_tested(case: Path, label: Label, seed: int) -> None:
    believed = read_parameters(case / NOMINAL)
    stated = believed.given_uncertainty
    stds = {n: std for n, std in least_stds(believed).items() if std < stated.get(n, 0.0)}
    asked = NextExperiment((), {}, stds)
    random = np.random.default_rng([_STREAM, seed, int(case.name)])
    tested = after_tests(label, asked, believed, random)
    write_parameters(case / NOMINAL, tested, names=sorted(tested.given))


def effects_of(whole: CaseSet, label: Label) -> dict[str, float]:
    """Numbers of the effects that are there, as the answer has fitted them."""
    answer = read_kept(whole.answers / DIAGNOSIS, label["id"]).answer
    if answer is None:
        return {}
    fitted = {c.name: dict(c.parameters) for c in answer.candidates}
    joint = fitted.get(PAIR_SIGN.join(sorted(label["effects"])), {})
    alone = {n: v for name in label["effects"] for n, v in fitted.get(name, {}).items()}
    return alone | joint


def make_by_model(case: Path, label: Label, effects: Mapping[str, float]) -> None:
    bench = rig_of(label).replace(dict(effects))
    sensors, world = Sensors.from_json(label["sensors"]), World(rig_of(label), {})
    for number, record in enumerate((RECORD, HOLD_OUT)):
        drive = Drive.from_json(label["drives"][record])
        time = drive.grid(COMMAND_PERIOD)
        found = simulate_finely(bench, time, drive.voltage(time))
        outcome = Outcome(
            time, found.voltage, found.current, found.temperature_reading,
            found.temperature_reading, found.martensite_fraction, found.stress,
            found.deflection_reading, found.bending, np.full(len(time), 293.0),
        )
        random = np.random.default_rng([_STREAM, int(label["id"]), number])
        signals = measure(outcome, world, sensors, CHANNELS, random, QUANTITIES[label["signals"]])
        write_record(case / record, signals, "bench", _START_NS, replace=True)


# --- Failures of the search.


class Truth(NamedTuple):
    """A fit that begins at the truth: nats by which it ends above what the search found, and those
    that it gains over the truth without its (second) effect."""

    missed: float
    gain: float


def print_failures(
    whole: CaseSet, labels: Mapping[str, Label], names: Sequence[str]
) -> None:
    found: dict[str, list[Truth]] = {}
    for name in names:
        label = labels[name]
        if label["kind"] in NEEDED:
            what = label["effects"][0] if label["kind"] == "single" else label["kind"]
            found.setdefault(what, []).append(from_the_truth(whole.folder / name, label))
    print(f"\n{HIDDEN}")
    print("\n| there is | cases | failures of the search | nats missed at most | in no record |")
    print("| --- | --- | --- | --- | --- |")
    for what, cases in sorted(found.items()):
        failures = sum(case.missed > _FAILURE for case in cases)
        most = max(0.0, *(case.missed for case in cases))
        hidden = sum(case.gain < NEEDED.get(what, NEEDED["single"]) for case in cases)
        print(f"| {what} | {len(cases)} | {failures} | {most:.1f} | {hidden} |")


def from_the_truth(case: Path, label: Label) -> Truth:
    """Fit what is there, from the true parameters."""
    believed = read_parameters(case / NOMINAL)
    records = [read_record(case / name) for name in (RECORD, HOLD_OUT)]
    shortest = shared_bin(records, believed)
    found = search([observe(r, believed, shortest) for r in records], believed)
    effects = [name for name in label["effects"] if name in found.singles]
    if len(effects) < len(label["effects"]):
        return Truth(0.0, 0.0)  # nothing that is measured shows one
    without, best = simpler_and_whole(found, effects)
    x = np.concatenate([_true_x(best, label, believed), best.x[best.unknowns.bench :]])
    again = fit(best.problem, best.unknowns, x, far=True)
    most = max(again.evidence, best.evidence)
    return Truth(float(again.evidence - best.evidence), float(most - without))


def simpler_and_whole(found: Search, effects: Sequence[str]) -> tuple[float, Fit]:
    """Evidence without the (second) effect, and the fit with all."""
    if not effects:
        return -np.inf, found.recalibrated
    if len(effects) == 1:
        return found.recalibrated.evidence, found.singles[effects[0]]
    first, second = sorted(effects, key=lambda e: found.singles[e].evidence, reverse=True)
    alone = found.singles[first]
    both = found.pairs.get((min(effects), max(effects)))
    if both is None:
        unknowns = found.recalibrated.unknowns.with_effects([first, second])
        start = find_start(Remainder(alone), unknowns, second)
        both = fit(found.problem, unknowns, start.x)
    return alone.evidence, both


def _true_x(fitted: Fit, label: Label, believed: Parameters) -> np.ndarray:
    """The bench's true parameters, a product's as a whole."""
    unknowns = fitted.unknowns
    values = dict(zip(unknowns.names, unknowns.values(fitted.x).tolist(), strict=True))
    for item in unknowns.items[: unknowns.bench]:
        if item.name in label["truth"]:
            values[item.name] = label["truth"][item.name]
            if item.partner:
                values[item.name] *= label["truth"][item.partner] / believed[item.partner]
    return unknowns.x_of(values.values())[: unknowns.bench]


if __name__ == "__main__":
    raise SystemExit(main())

"""The decision's weights from stored features: likeliest, cross-validated, with errors.

A ridge whose strength cross-validation chooses keeps weights that the cases do not tell near 0.
Forms are left out in turn (of every effect its first form, its second, its third), and rigs, every
case having its own. What the package answered when the features were stored stands next to it."""

import gzip
import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import yaml
from scipy.optimize import minimize
from scipy.special import softmax

from examination.blind import cases
from examination.blind.case_files import NO_GAP, RECALIBRATION, UNEXPLAINED, Candidate, by_effect
from examination.blind.cases import EFFECTS, FROZEN_SHARES, QUANTITIES
from examination.blind.judgement import WORTH_NAMING, Label, unseen
from examination.blind.make import Sized, make_label, size
from examination.blind.rigs import RECORDS
from examination.blind.score import as_markdown, stated_and_right
from sma_bench.arrays import Array
from sma_bench.diagnose.decision import NAMES, SIGNS, Utilities
from sma_bench.diagnose.result import JOIN
from sma_bench.diagnose.search import search
from sma_bench.diagnose.sizes import DecisionInputs, decision_inputs
from sma_bench.errors import InputError
from sma_bench.estimation.observation import observe_all
from sma_bench.parameters import Parameters
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.records import Record
from sma_bench.records.mend import mended

# --- Development cases searched once each: what the decision looks at, with the label.
#
# Cases cover all loads, one or two records and missing signals; a third of the owners state half of
# their numbers only. Half of the benches without an effect are plain: their equations are the
# baseline's, and of those where nothing is wrong half have the very numbers that are stated. Labels
# say what can be told from the records that are searched, with the numbers that are stated. What is
# found is kept under a hash of the library, one line a case.
PACKAGE = Path(__file__).resolve().parents[2] / "sma_bench"
# Those that the package's weights are learnt from, packed.
STORED = Path(__file__).with_name("features.jsonl.gz")
# What the numbers of a search depend on; the decision is fitted to them.
_LIBRARY = ("parameters", "physics", "records", "estimation", "diagnose")
_TABLES = ("parameters/effects.yaml", "estimation/priors.yaml", "diagnose/starts.yaml")
_NOT_ITS = ("decision.py", "diagnosis.py", "next_experiment.py", "result.py")
_LOADS = ("beam", "clamped", "force", "beam", "spring", "beam", "antagonist")  # in turn
_UNSTATED, _LESS_SIGNALS = 1 / 3, 0.35  # of the owners; of the benches that read all
_PLAIN, _AS_STATED = 0.5, 0.5  # of the benches without an effect; of plain ones with nothing wrong
_STATED_ALWAYS = ("bench.", "load.", "composite.", "wire.diameter", "wire.length", "wire.count")
_STREAM = 2_000_003  # apart from those that cases are made of


def library_hash() -> str:
    """Of all that a search depends on."""
    paths = sorted(p for room in _LIBRARY for p in (PACKAGE / room).rglob("*.py"))
    paths += [PACKAGE / name for name in _TABLES]
    whole = b"".join(path.read_bytes() for path in paths if path.name not in _NOT_ITS)
    return hashlib.sha256(whole).hexdigest()[:16]


def keep_features(out: Path, seed: int, n: int) -> None:
    """Add the cases to `out` that it does not hold yet, one by one: each a line of JSON. Raises
    InputError where the file is of another library, or of other cases."""
    library = library_hash()
    lines = [json.loads(line) for line in out.read_text().splitlines()] if out.is_file() else []
    for line in lines:
        if (line["library"], line["seed"], line["n"]) != (library, seed, n):
            raise InputError(f"{out}: holds features of another library, or of other cases")
    done = {line["index"] for line in lines}
    for index in (k for k in range(n) if k not in done):
        begun = time.monotonic()
        found = {"library": library, "seed": seed, "n": n, "index": index}
        found |= features_of(seed, n, index)
        with out.open("a") as file:
            file.write(json.dumps(found, separators=(",", ":")) + "\n")
        said = "+".join(found["label"]["effects"]) or found["label"]["kind"]
        print(f"{index + 1}/{n} {time.monotonic() - begun:.0f} s: {said}", flush=True)


def features_of(seed: int, n: int, index: int) -> dict[str, Any]:
    """Label, facts and today's probabilities of one case."""
    load = _LOADS[index % len(_LOADS)]
    deck = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(cases.DECK,)))
    card = cases.deal(n, deck, load)[index]
    own = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, index)))
    if card.signals == cases.ALL and own.random() < _LESS_SIGNALS:
        known = {**cases.EFFECTS, **cases.OUTSIDE}
        shown = load != cases.CLAMPED and all(known[n].in_deflection for n in card.effects)
        less = "without current", "without temperature"
        card = replace(card, signals=less[int(own.integers(2)) if shown else 0])
    plain = card.kind in (cases.NONE, RECALIBRATION) and bool(own.random() < _PLAIN)
    if plain:
        card = replace(card, noise="white")
    case = cases.draw_case(seed, index, card, f"{index:04d}", load)
    sized = Sized({}, {}, {}, {}, 0.0, 0.0) if plain else size(case)
    names = RECORDS[: int(own.integers(1, 3))]
    nominal = case.nominal
    if plain and card.kind == cases.NONE and own.random() < _AS_STATED:
        nominal = nominal.replace({n: case.truth[n] for n in nominal.given_uncertainty})
    if own.random() < _UNSTATED:  # of the wire's half is from the table, as far off as wires differ
        numbers = sorted(n for n in nominal.given if not n.startswith(_STATED_ALWAYS))
        dropped = set(own.permutation(numbers)[: len(numbers) // 2].tolist())
        stds = {n: s for n, s in nominal.given_uncertainty.items() if n not in dropped}
        nominal = Parameters({n: nominal[n] for n in nominal.given if n not in dropped}, stds)
    label = make_label(case, sized, names, nominal)
    records = []
    for name in names:
        signals = {s.name: s for s in case.signals(sized.features, name)}
        records.append(mended(Record(Path(name), case.starts[name], signals))[0])
    observations = observe_all(records, nominal, QUANTITIES[card.signals])
    inputs = decision_inputs(search(observations, nominal))
    utilities = Utilities(inputs)
    today = dict(zip(utilities.names, utilities.probabilities().round(6).tolist(), strict=True))
    wanted = ("kind", "effects", "signals", "noise", "kinetics", "severity", "severities", "wrong",
              "distinguishable", "load", "forms", "law_distance", "transformation_law",
              "loops_distance", "inner_loops", "beyond_parameters")
    return {"label": {name: label[name] for name in wanted}, "today": today, "plain": plain,
            "records": len(names), "stated": len(nominal.given), "facts": asdict(inputs)}


# --- Weights from what is stored.
# Of the fit, which weighs cases less in which the records say nothing, and as stated: the smallest
# that is as likely as any but for _AS_LIKELY.
RIDGES, LAPSES = (0.1, 0.3, 1.0, 3.0), (0.0, 0.1, 0.2)
STATED, _AS_LIKELY = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2), 0.02
FOLDS, _SEED = 6, 44
BENIGN = "benign"
COVERAGE, NAMED, CONFIDENT = 0.9, 0.6, 0.8
_LEAST = 1e-6  # of a probability
_SIDED = [SIGNS[kind][name] for kind, _, name in (n.partition(".") for n in NAMES)]
_BOUNDS = [((0.0, None), (None, None), (None, 0.0))[1 - sign] for sign in _SIDED]


class Known:
    """One case: explanations and their features (c, k), which are right, today's probabilities."""

    def __init__(self, line: dict[str, Any]) -> None:
        self.label = line["label"]
        found = msgspec.convert(line["facts"], DecisionInputs)
        own = Utilities(found)
        self.names, self.x, self.fixed = own.names, own.features()[0], own.fixed
        # A partner that does less than a tenth is a remark: the pair stands for its better half.
        small = {pair: main for pair, (main, _) in found.remarks().items()}
        right = right_names(self.label, self.names, small)
        self.right = np.array([name in right for name in self.names])
        self.today = np.array([line["today"].get(name, 0.0) for name in self.names])
        # What is hidden does most, number of its form; rigs without an effect go by turns.
        severities = self.label["severities"]
        hidden = [n for n in self.label["effects"] if n in EFFECTS]
        self.main = max(hidden, key=lambda n: severities.get(n, 0.0), default="")
        self.form = line["index"] % 3
        if self.main:
            self.form = list(EFFECTS[self.main].forms).index(self.label["forms"][self.main])
        singles = {n: f.gain for n, f in found.candidates.items() if JOIN not in n}
        self.gains_most = max(singles, key=lambda n: singles[n], default="")


def right_names(label: dict[str, Any], names: Sequence[str], small: dict[str, str]) -> set[str]:
    """Explanations that are right to put first; `small`: pairs that stand for their better half."""
    kind, effects = label["kind"], label["effects"]
    # Grains that are spread have inner loops of their own, whatever is hidden.
    loops = {"partial_transformation"} if label["inner_loops"] else set[str]()
    if kind == "none":
        return {RECALIBRATION, NO_GAP} | loops
    # What does less than the noise, or no more than other parameters do, is not worth a name: that
    # there is no gap is right as well.
    if effects and (label["severity"] < WORTH_NAMING or unseen(label["beyond_parameters"])):
        shown = {**label, "severity": np.inf, "beyond_parameters": None}
        return {RECALIBRATION, NO_GAP} | right_names(shown, names, small)
    if kind == "recalibration":
        return {RECALIBRATION}
    if kind == "outside":
        return {UNEXPLAINED}
    # Of a pair one effect alone where the other does less than a tenth, or no fit has them both.
    main = max(effects, key=lambda name: label["severities"].get(name, 0.0))
    whole = JOIN.join(sorted(effects))
    least = min(label["severities"].get(name, 0.0) for name in effects)
    if len(effects) > 1 and least < 0.1 * label["severities"].get(main, 0.0):
        return {main, whole}
    if len(effects) == 1:
        beside = {JOIN.join(sorted({main, other})) for other in loops}
        return {main} | beside | {pair for pair, half in small.items() if half == main}
    return {whole} if whole in names else set(effects)


def fit_weights(cases: Sequence[Known], ridge: float, lapse: float) -> tuple[Array, Array]:
    """The likeliest weights (k,) under a ridge, their covariance (k, k) by scores of cases."""
    edges, x = np.cumsum([0, *(len(case.names) for case in cases)]), np.vstack([c.x for c in cases])
    # Root mean square of every feature where it is there.
    there = np.maximum(np.sum(x != 0.0, axis=0), 1)
    scale = np.maximum(np.sqrt(np.sum(x**2, axis=0) / there), 1e-3)
    x = x / scale
    fixed, right = (np.concatenate([getattr(c, n) for c in cases]) for n in ("fixed", "right"))
    # How often nothing is wrong with a bench that is asked about is not known: the middle, on a
    # logarithmic scale, between these cases and the frozen set.
    group, counts = np.repeat(np.arange(len(cases)), np.diff(edges)), np.sqrt(weights_of(cases))
    by_chance = lapse * np.add.reduceat(right.astype(float), edges[:-1]) / np.diff(edges)

    def scores(w: Array) -> tuple[Array, Array]:
        """Probability of what is right, and the slopes of its log along the utilities."""
        u = x @ w + fixed
        e = np.exp(u - np.maximum.reduceat(u, edges[:-1])[group])
        p = e / np.add.reduceat(e, edges[:-1])[group]
        told = np.add.reduceat(p * right, edges[:-1])
        found = (1.0 - lapse) * told + by_chance
        return found, (1.0 - lapse) * p * (right - told[group]) / found[group]

    def loss(w: Array) -> tuple[float, Array]:
        found, slopes = scores(w)
        value = -float(counts @ np.log(np.maximum(found, 1e-300))) + 0.5 * ridge * float(w @ w)
        return value, ridge * w - x.T @ (counts[group] * slopes)

    found = minimize(loss, np.zeros(len(NAMES)), jac=True, method="L-BFGS-B", bounds=_BOUNDS,
                     options={"maxiter": 2000})
    each = np.add.reduceat(x * scores(found.x)[1][:, None], edges[:-1], axis=0)
    information = each.T @ (counts[:, None] * each) + ridge * np.eye(len(NAMES))
    return found.x / scale, np.linalg.inv(information) / np.outer(scale, scale)


def weights_of(cases: Sequence[Known]) -> Array:
    """(n,) with which cases count as often as the frozen set deals their kind."""
    kinds, shares = [case.label["kind"] for case in cases], FROZEN_SHARES
    whole = sum(shares[kind] for kind in set(kinds))
    return np.array([shares[kind] / whole * len(cases) / kinds.count(kind) for kind in kinds])


def left_out(cases: Sequence[Known], folds: Array, ridge: float, lapse: float) -> list[Array]:
    """(c,) shares by weights that have not seen a case's fold."""
    found: list[Array] = [np.zeros(0)] * len(cases)
    for fold in np.unique(folds):
        seen = [case for case, own in zip(cases, folds, strict=True) if own != fold]
        weights = fit_weights(seen, ridge, lapse)[0]
        for k in np.flatnonzero(folds == fold).tolist():
            found[k] = softmax(cases[k].x @ weights + cases[k].fixed)
    return found


def lapsed(shares: Sequence[Array], lapse: float) -> list[Array]:
    """(c,) probabilities of every case."""
    return [(1.0 - lapse) * p + lapse / len(p) for p in shares]


def log_probability(cases: Sequence[Known], answers: Sequence[Array]) -> Array:
    """(n,) of what is right."""
    return np.array([np.log(max(float(p[case.right].sum()), _LEAST))
                     for case, p in zip(cases, answers, strict=True)])


def holds(case: Known, k: int) -> bool:
    """Whether an explanation holds the main effect, or is right otherwise."""
    return bool(case.right[k]) or case.main in case.names[k].split(JOIN)


def said(case: Known, p: Array) -> tuple[str, float, list[str]]:
    """What is most probable (effect, benign, unexplained), how probable, effects in order."""
    found = by_effect([*map(Candidate, case.names, p.tolist())])
    whole = {BENIGN if NO_GAP in names else min(names): share for names, share in found.items()}
    ranked = sorted(whole, key=lambda name: -whole[name])
    effects = [name for name in ranked if name not in (BENIGN, UNEXPLAINED)]
    return ranked[0], whole[ranked[0]], effects


def truths(case: Known) -> set[str]:
    """What is right to say first."""
    right = msgspec.convert({"id": "", **case.label}, Label).names - {"transformation_law"}
    return {BENIGN if name in (RECALIBRATION, NO_GAP) else name for name in right}


def measures(cases: Sequence[Known], answers: Sequence[Array]) -> dict[str, float]:
    """All that is compared; sets reach the threshold that the other half of cases gives."""
    found = [said(case, p) for case, p in zip(cases, answers, strict=True)]
    likely = np.array([share for _, share, _ in found])
    kinds = np.array([case.label["kind"] for case in cases])
    right = np.array([first in truths(c) for (first, *_), c in zip(found, cases, strict=True)])
    effect = np.array([first not in (BENIGN, UNEXPLAINED) for first, *_ in found])
    both = np.array([set(ranked[: len(c.label["effects"])]) == set(c.label["effects"])
                     for (*_, ranked), c in zip(found, cases, strict=True)])
    plain = (kinds == "single") & np.array([bool(c.label["distinguishable"]) for c in cases])
    named, confident = effect & (likely >= NAMED), likely >= CONFIDENT
    # Of the most probable explanation that holds the main effect, or is right.
    truth = np.array([max((float(p[k]) for k in range(len(p)) if holds(c, k)), default=0.0)
                      for c, p in zip(cases, answers, strict=True)])
    halves, sizes, covered = np.arange(len(cases)) % 2, [], []
    for half in (0, 1):
        least = conformal(truth[halves != half])
        for k in np.flatnonzero(halves == half).tolist():
            chosen = credible(answers[k], least)
            sizes.append(len({n for j in chosen for n in cases[k].names[j].split(JOIN)}))
            covered.append(any(holds(cases[k], j) for j in chosen))

    def share(of: npt.ArrayLike, among: Any = slice(None)) -> float:
        own, counts = np.asarray(of)[among], weights_of(cases)[among]
        return float(np.average(own, weights=counts)) if len(own) else float("nan")

    return {"log probability of the truth": share(log_probability(cases, answers)),
            "first choice right": share(right), "of distinguishable singles": share(right, plain),
            "of these named and right": share(right & named, plain),
            "pairs: one": share(right, kinds == "pair"),
            "pairs: both": share(right & both, kinds == "pair"),
            "outside as such": share(right, kinds == "outside"),
            "wrong parameters as such": share(right, kinds == "recalibration"),
            "an effect named of clean ones": share(named, kinds == "none"),
            "confident and wrong": share(~right & confident),
            "of those an effect": share(~right & effect & confident),
            "90 % set: coverage": share(covered), "90 % set: size": share(sizes),
            "90 % set: least probability": conformal(truth)}


def conformal(truth: Array) -> float:
    """Probability that the truth had at least in 90 % of the cases, one more counted as 0."""
    place = int(np.floor((1.0 - COVERAGE) * (len(truth) + 1))) - 1
    return float(np.sort(truth)[place]) if place >= 0 else 0.0


def credible(p: Array, least: float) -> list[int]:
    """Explanations of the set: the most probable one, and all of at least that probability."""
    return sorted({int(np.argmax(p)), *np.flatnonzero(p >= least).tolist()})


def stored(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Lines of files of features, packed or not."""
    contents = ((path, path.read_bytes()) for path in paths)
    texts = (gzip.decompress(held) if path.suffix == ".gz" else held for path, held in contents)
    return [json.loads(line) for text in texts for line in text.splitlines()]


def learn(paths: Sequence[Path], out: Path | None, markdown: Path | None) -> None:
    """Weights from stored features, cross-validated: printed, written to `markdown`, `out`."""
    lines = stored(paths)
    cases = [Known(line) for line in lines]
    counts, forms = weights_of(cases), np.array([case.form for case in cases])
    rigs = np.random.default_rng(_SEED).permutation(len(cases)) % FOLDS
    # By ridge and lapse both ways to leave out; of each lapse as stated the log probability (n,).
    left, each = {}, {}
    for ridge, lapse in product(RIDGES, LAPSES):
        both = left[ridge, lapse] = [left_out(cases, f, ridge, lapse) for f in (forms, rigs)]
        each[ridge, lapse] = {
            s: np.mean([log_probability(cases, lapsed(p, s)) for p in both], axis=0)
            for s in STATED}

    def likeliest(key: tuple[float, float]) -> tuple[float, Array]:
        """The likeliest lapse as stated: the mean, and (n,) of the cases."""
        return max(((float(np.average(own, weights=counts)), own) for own in each[key].values()),
                   key=lambda both: both[0])

    ridge, lapse = max(each, key=lambda key: likeliest(key)[0])
    # The strongest ridge that is worse by no more than the error of that: it is the most careful.
    best = likeliest((ridge, lapse))[1]
    for other in RIDGES:
        loss = counts * (best - likeliest((other, lapse))[1])
        if float(np.mean(loss)) <= float(np.std(loss)) / np.sqrt(len(cases)):
            ridge = max(ridge, other)
    lapse = max(LAPSES, key=lambda own: likeliest((ridge, own))[0])  # the likeliest with that ridge
    least = likeliest((ridge, lapse))[0] - _AS_LIKELY
    last = min(stated for stated, own in each[ridge, lapse].items()
               if float(np.average(own, weights=counts)) > least)
    by_forms, by_rigs = (lapsed(shares, last) for shares in left[ridge, lapse])
    answers = {"when stored": [case.today for case in cases], "forms left out": by_forms,
               "rigs left out": by_rigs}
    columns = [measures(cases, own) for own in answers.values()]
    text = [
        f"{len(cases)} development cases (synthetic), features of library {lines[0]['library']}; "
        f"ridge {ridge:g}, lapse {lapse:g} in the fit, {last:g} as stated.", "",
        "Kinds of cases count as often as the frozen set deals them, in the fit by the root of "
        "that. `when stored`: what the "
        "package answered when the features were stored; the others: weights that have not seen "
        "the form, or the rig, of the case. `confident`: 0.8 or more.", "",
        *as_markdown(("measure", *answers), [(name, *(f"{c[name]:.3f}" for c in columns))
                                             for name in columns[0]]), ""]
    # By the number of the form, the first being the one that all seeds before 2700 have.
    rows = []
    for form in np.unique(forms).tolist():
        own = [k for k, c in enumerate(cases)
               if c.form == form and c.label["kind"] == "single" and c.label["distinguishable"]]
        if own:
            most = np.mean([cases[k].gains_most == cases[k].main for k in own])
            firsts = [np.mean([said(cases[k], p[k])[0] == cases[k].main for k in own])
                      for p in answers.values()]
            rows.append((f"{form + 1}", f"{len(own)}", *(f"{x:.2f}" for x in (most, *firsts))))
    found = [said(case, p) for case, p in zip(cases, by_rigs, strict=True)]
    stated = np.array([share for _, share, _ in found])
    right = np.array([first in truths(c) for (first, *_), c in zip(found, cases, strict=True)])
    text += ["Distinguishable singles put first, by the number of their form:", "",
             *as_markdown(("form", "cases", "gains most", *answers), rows), "",
             "What is stated of the first choice, rigs left out, and the share that is right, with "
             "intervals that hold together in 95 %:", "",
             *as_markdown(("stated", "cases", "mean", "right"),
                          stated_and_right(stated, right, counts)), ""]
    weights, covariance = fit_weights(cases, ridge, lapse)
    table = {n: [round(float(w), 4), round(float(e), 4)] for n, w, e in
             zip(NAMES, weights, np.sqrt(np.diag(covariance)), strict=True)}
    text += as_markdown(("weight", "value", "error"),
                        [(n, f"{w:.3f}", f"{e:.3f}") for n, (w, e) in table.items()])
    print("\n".join(text))
    if markdown is not None:
        head = "# What the decision has learnt", "", "`./bench blind learn --markdown FILE`"
        write_text_atomically(markdown, "\n".join([*head, "", *text, ""]))
    if out is not None:
        document = {"source": f"{len(cases)} development cases", "ridge": ridge, "fit_lapse": lapse,
                    "lapse": last, "library": lines[0]["library"],
                    "least": round(columns[2]["90 % set: least probability"], 4), "weights": table}
        said_of_it = "# Weights of the decision with their errors: ./bench blind learn writes it.\n"
        dumped = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
        write_text_atomically(out, said_of_it + dumped)

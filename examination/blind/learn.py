"""Fits the weights of the decision to stored features, by cross-validated maximum likelihood.

A ridge, whose strength cross-validation chooses, keeps weights near 0 that the cases do not
determine. Folds are forms (the first form of every effect, the second, the third), or groups of
rigs, of which every case has its own. The package's answers when the features were stored are shown
for comparison."""

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

# --- Features: every development case is searched once; the inputs of the decision are stored.
#
# Cases cover all loads, one or two records and missing signals; a third of the owners state only
# half of their numbers. Half of the benches without an effect are plain: their equations are the
# baseline's, and half of those with nothing wrong have exactly the stated numbers. Labels hold for
# the records that are searched and the numbers that are stated. Each case is a line, with a hash of
# the library.
PACKAGE = Path(__file__).resolve().parents[2] / "sma_bench"
# Features from which the package's weights are learnt, compressed.
STORED = Path(__file__).with_name("features.jsonl.gz")
# Code and tables on which the results of a search depend; the decision is fitted to these results.
_LIBRARY = ("parameters", "physics", "records", "estimation", "diagnose")
_TABLES = ("parameters/effects.yaml", "estimation/priors.yaml", "diagnose/starts.yaml")
_NOT_ITS = ("decision.py", "diagnosis.py", "next_experiment.py", "result.py")
_LOADS = ("beam", "clamped", "force", "beam", "spring", "beam", "antagonist")  # in turn
_UNSTATED = 1 / 3  # of the owners state only half of their numbers
_LESS_SIGNALS = 0.35  # of the benches that read all signals lose one
_PLAIN = 0.5  # of the benches without an effect
_AS_STATED = 0.5  # of the plain ones with nothing wrong
_STATED_ALWAYS = ("bench.", "load.", "composite.", "wire.diameter", "wire.length", "wire.count")
_STREAM = 2_000_003  # of random numbers, apart from those of the cases


def library_hash() -> str:
    """Hash of all code and tables that a search depends on."""
    paths = sorted(p for room in _LIBRARY for p in (PACKAGE / room).rglob("*.py"))
    paths += [PACKAGE / name for name in _TABLES]
    whole = b"".join(path.read_bytes() for path in paths if path.name not in _NOT_ITS)
    return hashlib.sha256(whole).hexdigest()[:16]


def keep_features(out: Path, seed: int, n: int) -> None:
    """Append the cases that `out` does not have yet, each as a line of JSON. Raises InputError if
    the file is of another library, or of other cases."""
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
        hidden = "+".join(found["label"]["effects"]) or found["label"]["kind"]
        print(f"{index + 1}/{n} {time.monotonic() - begun:.0f} s: {hidden}", flush=True)


def features_of(seed: int, n: int, index: int) -> dict[str, Any]:
    """Label, inputs of the decision and its present probabilities for one case."""
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
    if own.random() < _UNSTATED:  # half of the wire's are the table's defaults, with their spread
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


# --- Weights from stored features.
# A lapse is the probability of an answer by chance. In the fit it gives less weight to cases whose
# records show nothing; the one in stated probabilities is the smallest whose mean log probability
# is within _AS_LIKELY of the best.
RIDGES, LAPSES = (0.1, 0.3, 1.0, 3.0), (0.0, 0.1, 0.2)
STATED, _AS_LIKELY = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2), 0.02
FOLDS, _SEED = 6, 44
BENIGN = "benign"
COVERAGE, NAMED, CONFIDENT = 0.9, 0.6, 0.8
_LEAST = 1e-6  # of a probability
_SIDED = [SIGNS[kind][name] for kind, _, name in (n.partition(".") for n in NAMES)]
_BOUNDS = [((0.0, None), (None, None), (None, 0.0))[1 - sign] for sign in _SIDED]


class Known:
    """One case: candidates with features (c, k), which are right, probabilities when stored."""

    def __init__(self, line: dict[str, Any]) -> None:
        self.label = line["label"]
        found = msgspec.convert(line["facts"], DecisionInputs)
        own = Utilities(found)
        self.names, self.x, self.fixed = own.names, own.features()[0], own.fixed
        # A partner with less than a tenth of the gap is a remark: the pair counts as the other one.
        small = {pair: main for pair, (main, _) in found.remarks().items()}
        right = right_names(self.label, self.names, small)
        self.right = np.array([name in right for name in self.names])
        self.today = np.array([line["today"].get(name, 0.0) for name in self.names])
        # Hidden effect with the largest gap, number of its form; cases without one take turns.
        severities = self.label["severities"]
        hidden = [n for n in self.label["effects"] if n in EFFECTS]
        self.main = max(hidden, key=lambda n: severities.get(n, 0.0), default="")
        self.form = line["index"] % 3
        if self.main:
            self.form = list(EFFECTS[self.main].forms).index(self.label["forms"][self.main])
        singles = {n: f.gain for n, f in found.candidates.items() if JOIN not in n}
        self.gains_most = max(singles, key=lambda n: singles[n], default="")


def right_names(label: dict[str, Any], names: Sequence[str], small: dict[str, str]) -> set[str]:
    """Candidates that are right as first choice; `small`: pairs that count as their main effect."""
    kind, effects = label["kind"], label["effects"]
    # Spread grains have inner loops of their own, whatever is hidden.
    loops = {"partial_transformation"} if label["inner_loops"] else set[str]()
    if kind == "none":
        return {RECALIBRATION, NO_GAP} | loops
    # An effect below the noise, or one that other parameters would explain, need not be named:
    # no_gap and recalibration are right, too.
    if effects and (label["severity"] < WORTH_NAMING or unseen(label["beyond_parameters"])):
        shown = {**label, "severity": np.inf, "beyond_parameters": None}
        return {RECALIBRATION, NO_GAP} | right_names(shown, names, small)
    if kind == "recalibration":
        return {RECALIBRATION}
    if kind == "outside":
        return {UNEXPLAINED}
    # Of a pair one effect alone is right if the other has less than a tenth of its gap, or if no
    # fit has both.
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
    """Most likely weights (k,) with a ridge, and their covariance (k, k) by scores of cases."""
    edges, x = np.cumsum([0, *(len(case.names) for case in cases)]), np.vstack([c.x for c in cases])
    # Root mean square of every feature where it is not 0.
    there = np.maximum(np.sum(x != 0.0, axis=0), 1)
    scale = np.maximum(np.sqrt(np.sum(x**2, axis=0) / there), 1e-3)
    x = x / scale
    fixed, right = (np.concatenate([getattr(c, n) for c in cases]) for n in ("fixed", "right"))
    # The share of benches with nothing wrong is unknown in practice: half way, on a logarithmic
    # scale, between these cases and the frozen set.
    group, counts = np.repeat(np.arange(len(cases)), np.diff(edges)), np.sqrt(weights_of(cases))
    by_chance = lapse * np.add.reduceat(right.astype(float), edges[:-1]) / np.diff(edges)

    def scores(w: Array) -> tuple[Array, Array]:
        """Probability of the right candidates, and d of its log by the utilities."""
        u = x @ w + fixed
        e = np.exp(u - np.maximum.reduceat(u, edges[:-1])[group])
        p = e / np.add.reduceat(e, edges[:-1])[group]
        of_right = np.add.reduceat(p * right, edges[:-1])
        found = (1.0 - lapse) * of_right + by_chance
        return found, (1.0 - lapse) * p * (right - of_right[group]) / found[group]

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
    """(n,) with which each kind of case counts as often as in the frozen set."""
    kinds, shares = [case.label["kind"] for case in cases], FROZEN_SHARES
    whole = sum(shares[kind] for kind in set(kinds))
    return np.array([shares[kind] / whole * len(cases) / kinds.count(kind) for kind in kinds])


def left_out(cases: Sequence[Known], folds: Array, ridge: float, lapse: float) -> list[Array]:
    """(c,) probabilities of every case by weights that were fitted without its fold."""
    found: list[Array] = [np.zeros(0)] * len(cases)
    for fold in np.unique(folds):
        seen = [case for case, own in zip(cases, folds, strict=True) if own != fold]
        weights = fit_weights(seen, ridge, lapse)[0]
        for k in np.flatnonzero(folds == fold).tolist():
            found[k] = softmax(cases[k].x @ weights + cases[k].fixed)
    return found


def lapsed(shares: Sequence[Array], lapse: float) -> list[Array]:
    """(c,) probabilities of every case, with this probability of an answer by chance."""
    return [(1.0 - lapse) * p + lapse / len(p) for p in shares]


def log_probability(cases: Sequence[Known], answers: Sequence[Array]) -> Array:
    """(n,) of the right candidates."""
    return np.array([np.log(max(float(p[case.right].sum()), _LEAST))
                     for case, p in zip(cases, answers, strict=True)])


def holds(case: Known, k: int) -> bool:
    """True if candidate k contains the main effect, or is right otherwise."""
    return bool(case.right[k]) or case.main in case.names[k].split(JOIN)


def first_choice(case: Known, p: Array) -> tuple[str, float, list[str]]:
    """First choice (an effect, benign, unexplained), its probability, effects in order."""
    found = by_effect([*map(Candidate, case.names, p.tolist())])
    whole = {BENIGN if NO_GAP in names else min(names): share for names, share in found.items()}
    ranked = sorted(whole, key=lambda name: -whole[name])
    effects = [name for name in ranked if name not in (BENIGN, UNEXPLAINED)]
    return ranked[0], whole[ranked[0]], effects


def truths(case: Known) -> set[str]:
    """Right first choices."""
    right = msgspec.convert({"id": "", **case.label}, Label).names - {"transformation_law"}
    return {BENIGN if name in (RECALIBRATION, NO_GAP) else name for name in right}


def measures(cases: Sequence[Known], answers: Sequence[Array]) -> dict[str, float]:
    """All measures; credible sets use the threshold found on the other half of the cases."""
    found = [first_choice(case, p) for case, p in zip(cases, answers, strict=True)]
    likely = np.array([share for _, share, _ in found])
    kinds = np.array([case.label["kind"] for case in cases])
    right = np.array([first in truths(c) for (first, *_), c in zip(found, cases, strict=True)])
    effect = np.array([first not in (BENIGN, UNEXPLAINED) for first, *_ in found])
    both = np.array([set(ranked[: len(c.label["effects"])]) == set(c.label["effects"])
                     for (*_, ranked), c in zip(found, cases, strict=True)])
    plain = (kinds == "single") & np.array([bool(c.label["distinguishable"]) for c in cases])
    named, confident = effect & (likely >= NAMED), likely >= CONFIDENT
    # Probability of the best candidate that contains the main effect, or is right.
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
    """Probability that right candidates reach in 90 % of the cases and one more case with 0."""
    place = int(np.floor((1.0 - COVERAGE) * (len(truth) + 1))) - 1
    return float(np.sort(truth)[place]) if place >= 0 else 0.0


def credible(p: Array, least: float) -> list[int]:
    """Candidates of the set: the most probable one, and all of at least that probability."""
    return sorted({int(np.argmax(p)), *np.flatnonzero(p >= least).tolist()})


def stored(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Lines of files of features, compressed or not."""
    contents = ((path, path.read_bytes()) for path in paths)
    texts = (gzip.decompress(held) if path.suffix == ".gz" else held for path, held in contents)
    return [json.loads(line) for text in texts for line in text.splitlines()]


def learn(paths: Sequence[Path], out: Path | None, markdown: Path | None) -> None:
    """Weights from stored features, cross-validated: printed, written to `markdown`, `out`."""
    lines = stored(paths)
    cases = [Known(line) for line in lines]
    counts, forms = weights_of(cases), np.array([case.form for case in cases])
    rigs = np.random.default_rng(_SEED).permutation(len(cases)) % FOLDS
    # By ridge and lapse: probabilities with forms and with rigs left out; their log probability
    # (n,) by stated lapse.
    left, each = {}, {}
    for ridge, lapse in product(RIDGES, LAPSES):
        both = left[ridge, lapse] = [left_out(cases, f, ridge, lapse) for f in (forms, rigs)]
        each[ridge, lapse] = {
            s: np.mean([log_probability(cases, lapsed(p, s)) for p in both], axis=0)
            for s in STATED}

    def likeliest(key: tuple[float, float]) -> tuple[float, Array]:
        """Log probability with the best stated lapse: mean, and (n,) of the cases."""
        return max(((float(np.average(own, weights=counts)), own) for own in each[key].values()),
                   key=lambda both: both[0])

    ridge, lapse = max(each, key=lambda key: likeliest(key)[0])
    # The strongest ridge that is worse by no more than the standard error: the most careful one.
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
        "Kinds of cases count as often as in the frozen set, in the fit by the root of that. "
        "`when stored`: answers of the package when the features were stored; the others: weights "
        "fitted without the form, or the rig, of the case. `confident`: 0.8 or more.", "",
        *as_markdown(("measure", *answers), [(name, *(f"{c[name]:.3f}" for c in columns))
                                             for name in columns[0]]), ""]
    # By the number of the form; the first is the one of all seeds before 2700.
    rows = []
    for form in np.unique(forms).tolist():
        own = [k for k, c in enumerate(cases)
               if c.form == form and c.label["kind"] == "single" and c.label["distinguishable"]]
        if own:
            most = np.mean([cases[k].gains_most == cases[k].main for k in own])
            firsts = [np.mean([first_choice(cases[k], p[k])[0] == cases[k].main for k in own])
                      for p in answers.values()]
            rows.append((f"{form + 1}", f"{len(own)}", *(f"{x:.2f}" for x in (most, *firsts))))
    found = [first_choice(case, p) for case, p in zip(cases, by_rigs, strict=True)]
    stated = np.array([share for _, share, _ in found])
    right = np.array([first in truths(c) for (first, *_), c in zip(found, cases, strict=True)])
    text += ["Distinguishable singles as first choice, by the number of their form:", "",
             *as_markdown(("form", "cases", "gains most", *answers), rows), "",
             "Stated probability of the first choice, rigs left out, and the share that is right, "
             "with joint 95 % intervals:", "",
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
        heading = "# Weights of the decision with their errors: ./bench blind learn writes it.\n"
        dumped = yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
        write_text_atomically(out, heading + dumped)

"""The decision's weights from stored features: likeliest, cross-validated, with errors.

A ridge whose strength cross-validation chooses keeps weights that the cases do not tell near 0.
Forms are left out in turn (of every effect its first form, its second, its third), and rigs, every
case having its own. Today's rules answer the same left-out cases.
"""

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
import yaml
from scipy.optimize import minimize
from scipy.special import softmax

from examination.blind.case_files import NO_GAP, RECALIBRATION, UNEXPLAINED
from examination.blind.cases import EFFECTS
from examination.pieces import print_table
from sma_bench.diagnose.facts import Weighed
from sma_bench.diagnose.result import JOIN
from sma_bench.diagnose.utilities import NAMES, SIGNS, Utilities
from sma_bench.parameters.yaml_file import write_text_atomically

Array = npt.NDArray[np.float64]

RIDGES, LAPSES = (0.1, 0.3, 1.0, 3.0), (0.0, 0.1, 0.2, 0.3, 0.4)
FOLDS = 6
NO_EFFECT, BENIGN = (NO_GAP, RECALIBRATION, UNEXPLAINED), "benign"
COVERAGE, NAMED, CONFIDENT, WORTH_NAMING = 0.9, 0.6, 0.8, 1.0
# Shares that the kinds have among the benches that are asked about, as the frozen set deals them.
SHARES = {"none": 0.37, "recalibration": 0.11, "outside": 0.11, "single": 0.30, "pair": 0.11}
_LEAST = 1e-6  # of a probability
_SEED = 44
_SIDED = [SIGNS[kind][name] for kind, _, name in (n.partition(".") for n in NAMES)]
_BOUNDS = [((0.0, None), (None, None), (None, 0.0))[1 - sign] for sign in _SIDED]


class Known:
    """One case: explanations and their features (c, k), which are right, today's probabilities."""

    def __init__(self, line: dict[str, Any]) -> None:
        self.label, self.index = line["label"], line["index"]
        own = Utilities(msgspec.convert(line["facts"], Weighed))
        self.names, self.x, self.fixed = own.names, own.features()[0], own.fixed
        facts = line["facts"]["candidates"]
        # A partner that does less than a tenth is a remark: the pair stands for its better half.
        small = {
            n: max(n.split(JOIN), key=lambda e: facts[e]["gain"])
            for n, f in facts.items() if JOIN in n and f["partner"] < 0.1 * f["gap"]
        }  # fmt: skip
        right = right_names(self.label, self.names, small)
        self.right = np.array([name in right for name in self.names])
        self.today = np.array([line["today"].get(name, 0.0) for name in self.names])
        # What is hidden does most, number of its form; rigs without an effect go by turns.
        hidden = [n for n in self.label["effects"] if n in EFFECTS]
        severities = self.label["severities"]
        self.main = max(hidden, key=lambda n: severities.get(n, 0.0)) if hidden else ""
        self.form = self.index % 3
        if self.main:
            self.form = list(EFFECTS[self.main].forms).index(self.label["forms"][self.main])
        singles = {n: f["gain"] for n, f in facts.items() if JOIN not in n}
        self.gains_most = max(singles, key=lambda n: singles[n], default="")


def right_names(
    label: dict[str, Any], names: Sequence[str], small: dict[str, str]
) -> set[str]:
    """Explanations that are right to put first; `small`: pairs that stand for their better half."""
    kind, effects = label["kind"], label["effects"]
    if kind == "none":
        return {RECALIBRATION, NO_GAP}
    # What does less than the noise is not worth a name: that there is no gap is right as well.
    if effects and label["severity"] < WORTH_NAMING:
        return {RECALIBRATION, NO_GAP} | right_names({**label, "severity": np.inf}, names, small)
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
        return {main} | {pair for pair, half in small.items() if half == main}
    return {whole} if whole in names else set(effects)


def fit_weights(cases: Sequence[Known], ridge: float, lapse: float) -> tuple[Array, Array]:
    """The likeliest weights (k,) under a ridge, and their covariance (k, k) by the scores of the
    cases."""
    scale = scales(cases)
    edges = np.cumsum([0, *(len(case.names) for case in cases)])
    x = np.vstack([case.x for case in cases]) / scale
    fixed, right = (np.concatenate([getattr(c, n) for c in cases]) for n in ("fixed", "right"))
    group = np.repeat(np.arange(len(cases)), np.diff(edges))
    kinds = [case.label["kind"] for case in cases]
    counts = np.array([SHARES[kind] * len(cases) / kinds.count(kind) for kind in kinds])
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
                     options={"maxiter": 2000})  # fmt: skip
    each = np.add.reduceat(x * scores(found.x)[1][:, None], edges[:-1], axis=0)
    information = each.T @ (counts[:, None] * each) + ridge * np.eye(len(NAMES))
    return found.x / scale, np.linalg.inv(information) / np.outer(scale, scale)


def scales(cases: Sequence[Known]) -> Array:
    """(k,) root mean square of every feature where it is there."""
    x = np.vstack([case.x for case in cases])
    there = np.maximum(np.sum(x != 0.0, axis=0), 1)
    return np.maximum(np.sqrt(np.sum(x**2, axis=0) / there), 1e-3)


def answer(case: Known, weights: Array, lapse: float) -> Array:
    """(c,) probabilities."""
    return (1.0 - lapse) * softmax(case.x @ weights + case.fixed) + lapse / len(case.names)


def left_out(cases: Sequence[Known], folds: Array, ridge: float, lapse: float) -> list[Array]:
    """What weights that have not seen its fold answer to every case."""
    found: list[Array] = [np.zeros(0)] * len(cases)
    for fold in np.unique(folds):
        seen = [case for case, own in zip(cases, folds, strict=True) if own != fold]
        weights = fit_weights(seen, ridge, lapse)[0]
        for k in np.flatnonzero(folds == fold).tolist():
            found[k] = answer(cases[k], weights, lapse)
    return found


def log_probability(cases: Sequence[Known], answers: Sequence[Array]) -> Array:
    """(n,) of what is right."""
    return np.array([
        np.log(max(float(p[case.right].sum()), _LEAST))
        for case, p in zip(cases, answers, strict=True)
    ])  # fmt: skip


def mass_needed(case: Known, p: Array) -> float:
    """Mass of the smallest set of the most probable explanations that holds the main effect."""
    total = 0.0
    for k in np.argsort(-p, kind="stable").tolist():
        total += float(p[k])
        if holds(case, k):
            return total
    return 1.0


def holds(case: Known, k: int) -> bool:
    """Whether an explanation holds the main effect, or is right otherwise."""
    if case.right[k]:
        return True
    return case.main in case.names[k].split(JOIN)


def said(case: Known, p: Array) -> tuple[str, float, list[str]]:
    """What an answer comes to: the effect at work, "benign" or unexplained, whichever is the most
    probable, that probability, and the effects by theirs."""
    shares = dict(zip(case.names, p.tolist(), strict=True))
    effects: dict[str, float] = {}
    for name, share in shares.items():
        for effect in name.split(JOIN) if name not in NO_EFFECT else ():
            effects[effect] = effects.get(effect, 0.0) + share
    whole = {**effects, BENIGN: shares[RECALIBRATION] + shares[NO_GAP],
             UNEXPLAINED: shares[UNEXPLAINED]}  # fmt: skip
    first = max(whole, key=lambda name: whole[name])
    return first, whole[first], sorted(effects, key=lambda name: -effects[name])


def measures(cases: Sequence[Known], answers: Sequence[Array]) -> dict[str, float]:
    """Everything that is compared. Sets: the smallest that reach the conformal threshold, which the
    other half of the cases gives."""
    found = [said(case, p) for case, p in zip(cases, answers, strict=True)]
    likely = np.array([share for _, share, _ in found])
    kinds = np.array([case.label["kind"] for case in cases])
    truths = [
        {"none": {BENIGN}, "recalibration": {BENIGN}, "outside": {UNEXPLAINED}}.get(
            case.label["kind"], set(case.label["effects"])
        )
        for case in cases
    ]  # fmt: skip
    for truth, label in zip(truths, (case.label for case in cases), strict=True):
        truth |= {BENIGN} if label["effects"] and label["severity"] < WORTH_NAMING else set()
    right = np.array([first in truth for (first, *_), truth in zip(found, truths, strict=True)])
    effect = np.array([first not in (BENIGN, UNEXPLAINED) for first, *_ in found])
    both = np.array([
        set(ranked[: len(truth)]) == truth
        for (*_, ranked), truth in zip(found, truths, strict=True)
    ])
    plain = (kinds == "single") & np.array([bool(c.label["distinguishable"]) for c in cases])
    named, confident = effect & (likely >= NAMED), likely >= CONFIDENT
    needed = np.array([mass_needed(c, p) for c, p in zip(cases, answers, strict=True)])
    halves, sizes, covered = np.arange(len(cases)) % 2, [], []
    for half in (0, 1):
        mass = conformal(needed[halves != half])
        for k in np.flatnonzero(halves == half).tolist():
            order = np.argsort(-answers[k], kind="stable")
            count = int(np.searchsorted(np.cumsum(answers[k][order]), mass - 1e-9)) + 1
            chosen = order[:count].tolist()
            sizes.append(len({n for j in chosen for n in cases[k].names[j].split(JOIN)}))
            covered.append(any(holds(cases[k], j) for j in chosen))

    def share(of: npt.NDArray[np.bool_], among: npt.NDArray[np.bool_] | None = None) -> float:
        of = of if among is None else of[among]
        return float(np.mean(of)) if len(of) else float("nan")

    return {
        "log probability of the truth": float(np.mean(log_probability(cases, answers))),
        "first choice right": share(right),
        "of distinguishable singles": share(right, plain),
        "of these named and right": share(right & named, plain),
        "pairs: one": share(right, kinds == "pair"),
        "pairs: both": share(right & both, kinds == "pair"),
        "outside as such": share(right, kinds == "outside"),
        "wrong parameters as such": share(right, kinds == "recalibration"),
        "an effect named of clean ones": share(named, kinds == "none"),
        "confident and wrong": share(~right & confident),
        "of those an effect": share(~right & effect & confident),
        "90 % set: coverage": float(np.mean(covered)),
        "90 % set: size": float(np.mean(sizes)),
        "90 % set: mass": conformal(needed),
    }  # fmt: skip


def conformal(needed: Array) -> float:
    """Mass that was enough in 90 % of the cases, one more reckoned as having needed all."""
    place = int(np.ceil(COVERAGE * (len(needed) + 1))) - 1
    return float(np.sort(needed)[min(place, len(needed) - 1)])


def learn(paths: Sequence[Path], out: Path | None) -> None:
    """Print today's rules beside the logit on the same left-out cases, then weights and errors;
    write the table to `out`."""
    lines = [json.loads(line) for path in paths for line in path.read_text().splitlines()]
    cases = [Known(line) for line in lines]
    today = [case.today for case in cases]
    forms = np.array([case.form for case in cases])
    rigs = np.random.default_rng(_SEED).permutation(len(cases)) % FOLDS
    print(f"{len(cases)} cases; log probability with forms and with rigs left out:")
    scored = {}
    for ridge, lapse in product(RIDGES, LAPSES):
        both = [left_out(cases, folds, ridge, lapse) for folds in (forms, rigs)]
        values = [float(np.mean(log_probability(cases, answers))) for answers in both]
        scored[ridge, lapse] = sum(values), both
        print(f"  ridge {ridge:4.1f}, lapse {lapse:.1f}: {values[0]:.3f}  {values[1]:.3f}")
    best = max(scored, key=lambda key: scored[key][0])
    by_forms, by_rigs = scored[best][1]
    columns = [measures(cases, answers) for answers in (today, by_forms, by_rigs)]
    head = ("measure", ">today", ">forms left out", ">rigs left out")
    print_table(head, [(name, *(f"{c[name]:.3f}" for c in columns)) for name in columns[0]])
    for name, answers in (("forms", by_forms), ("rigs", by_rigs)):
        gain = log_probability(cases, answers) - log_probability(cases, today)
        error = np.std(gain) / np.sqrt(len(cases))
        print(f"log probability over today's, {name} left out: {np.mean(gain):+.3f} +- {error:.3f}")
    # By the number of the form, the first being the one that all seeds before 2700 have.
    rows = []
    for form in np.unique(forms).tolist():
        own = [
            k for k, c in enumerate(cases)
            if c.form == form and c.label["kind"] == "single" and c.label["distinguishable"]
        ]
        if own:
            most = np.mean([cases[k].gains_most == cases[k].main for k in own])
            firsts = [np.mean([said(cases[k], answers[k])[0] == cases[k].main for k in own])
                      for answers in (today, by_forms, by_rigs)]  # fmt: skip
            rows.append((form + 1, len(own), *(f"{share:.2f}" for share in (most, *firsts))))
    print("distinguishable singles put first, by the number of their form:")
    print_table(("form", ">n", ">gains most", ">today", ">forms left out", ">rigs left out"), rows)
    weights, covariance = fit_weights(cases, *best)
    errors = np.sqrt(np.diag(covariance))
    print_table(
        ("weight", ">value", ">error"),
        [(n, f"{w:.3f}", f"{e:.3f}") for n, w, e in zip(NAMES, weights, errors, strict=True)],
    )
    if out is not None:
        document = {
            "source": f"{len(cases)} development cases, ridge {best[0]:g}",
            "lapse": best[1],
            "library": lines[0]["library"],
            "set_mass": round(columns[1]["90 % set: mass"], 4),
            "weights": {n: [round(float(w), 4), round(float(e), 4)]
                        for n, w, e in zip(NAMES, weights, errors, strict=True)},
        }  # fmt: skip
        text = "# Weights of the decision with their errors: ./bench blind learn writes them.\n"
        text += yaml.safe_dump(document, sort_keys=False, default_flow_style=None)
        write_text_atomically(out, text)

"""Nothing that a bag shows besides its signals' values tells what the case hides."""

from functools import cache

import numpy as np
import pytest

from examination.blind.cases import EFFECTS, OUTSIDE, draw_cases
from examination.blind.rigs import BELIEVED, CHANNELS, RECORDS
from examination.blind.sensors import clocks

N, FOLDS, SHUFFLES, RIDGE = 360, 6, 99, 0.3
CHANCE = 0.02


def metadata(case):
    """Everything about a case's folder but the values of its signals."""
    paper = case.card.signals == "paper"
    row = [float(paper), float(case.storage == "mcap"), len(case.namespace), case.namespace < "l"]
    for record in RECORDS:
        ticks = clocks(case.drives[record].duration, case.sensors, CHANNELS, case.stream(record))
        shown = {t: c for t, c in ticks.items() if not (paper and t.endswith("temperature"))}
        stamps = [c.time[c.arrived] for t, c in shown.items() if "temperature" not in t]
        counts = [len(s) for s in stamps]
        delays = [np.median(c.received - c.time) for c in shown.values()]
        steps = np.diff(stamps[0])
        start = case.starts[record]
        row += [*counts, stamps[0][0], stamps[-1][0], stamps[-1][-1], steps.mean(), steps.std()]
        row += [start / 1e18, (start // 10**9) % 86400, (start // 10**9) // 86400 % 7]
        row += [start % 10**9, case.drives[record].duration, np.mean(delays), np.std(delays)]
    row.append((case.starts["hold_out"] - case.starts["record"]) / 1e9)
    row += [case.nominal[name] for name in BELIEVED]
    row += [case.nominal.std(name) / case.nominal[name] for name in BELIEVED]
    return row


@cache
def deck():
    cases = draw_cases(4242, N)
    table = np.array([metadata(case) for case in cases], dtype=float)
    spread = table.std(axis=0)
    kept = spread > 1e-9 * np.abs(table).max(axis=0)
    table = (table - table.mean(axis=0))[:, kept] / spread[kept]
    # Squares find what is told by being extreme.
    return cases, np.hstack([table, table**2 - 1.0])


def predictor(table):
    """(n, n) matrix from labels to the scores that fits on the other folds give each row."""
    n = len(table)
    fold = np.arange(n) % FOLDS
    matrix = np.zeros((n, n))
    for k in range(FOLDS):
        train, test = fold != k, fold == k
        gram = table[train].T @ table[train] + RIDGE * n * np.eye(table.shape[1])
        weights = table[test] @ np.linalg.solve(gram, table[train].T)
        # Labels count from the mean of the rows that a fit has seen.
        matrix[np.ix_(test, train)] = weights - weights.mean(axis=1, keepdims=True)
    return matrix


def separability(scores, wanted):
    """Mean area under the curve of one class against the rest."""
    ranks = scores.argsort(axis=0).argsort(axis=0) + 1.0
    positive = wanted.sum(axis=0)
    area = (ranks * wanted).sum(axis=0) - positive * (positive + 1.0) / 2.0
    return float(np.mean(area / (positive * (len(wanted) - positive))))


def chance_of(table, labels):
    """Share of shuffled labels that are told as well as the true ones."""
    rng = np.random.default_rng(1)
    matrix = predictor(table)
    wanted = np.array([labels == name for name in sorted(set(labels))], dtype=float).T
    reached = [separability(matrix @ wanted, wanted)]
    for _ in range(SHUFFLES):
        shuffled = wanted[rng.permutation(len(wanted))]
        reached.append(separability(matrix @ shuffled, shuffled))
    return sum(other >= reached[0] for other in reached) / len(reached)


def stage_of(card):
    return {**EFFECTS, **OUTSIDE}[card.effects[0]].stage


LABELS = {
    "kind": (lambda card: True, lambda card: card.kind),
    "anything": (lambda card: True, lambda card: str(card.kind == "none")),
    "noise": (lambda card: True, lambda card: card.noise),
    "severity": (
        lambda card: card.kind == "single" and card.targets[0] is not None,
        lambda card: str(card.targets[0] > 4.0),
    ),
    # What the deflection cannot show is never hidden where there is nothing else.
    "stage": (
        lambda card: card.kind == "single" and EFFECTS[card.effects[0]].in_deflection,
        stage_of,
    ),
    "kinetics": (lambda card: card.kind == "none", lambda card: str(card.mild_kinetics)),
}


@pytest.mark.parametrize("name", LABELS)
def test_classifier_on_metadata_is_at_chance(name):
    cases, table = deck()
    chosen, label = LABELS[name]
    rows = [k for k, case in enumerate(cases) if chosen(case.card)]
    labels = np.array([label(cases[k].card) for k in rows])
    assert chance_of(table[rows], labels) > CHANCE


@pytest.mark.parametrize("leak", ["message counts", "beliefs of one kind off by half a sigma"])
def test_classifier_finds_a_leak_that_is_there(leak):
    cases, table = deck()
    labels = np.array([case.card.kind for case in cases])
    leaking = table.copy()
    hidden = labels == ("outside" if leak == "message counts" else "single")
    leaking[hidden, 4 if leak == "message counts" else -1] += 1.2
    assert chance_of(leaking, labels) <= CHANCE

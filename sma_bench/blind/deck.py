"""Which case hides what: kinds, effects, severities and signals dealt in balance."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.blind.noise import COLOURS
from sma_bench.blind.symptoms import EFFECTS, OUTSIDE

SINGLE, NONE, RECALIBRATION, PAIR, OUTSIDE_KIND = (
    "single",
    "none",
    "recalibration",
    "pair",
    "outside",
)
SHARES = {SINGLE: 0.50, NONE: 0.16, RECALIBRATION: 0.08, PAIR: 0.13, OUTSIDE_KIND: 0.13}
# Gap over noise that an effect is sized for; None takes a size of the literature as it comes.
SEVERITIES = (1.0, 2.0, 4.0, 8.0, 16.0, None)
# Both of a pair must be there to be seen.
PAIR_SEVERITIES = (3.0, 6.0, 12.0, 24.0)
MILD_KINETICS_SHARE = 0.25
ALL, PAPER = "all", "paper"
SIGNALS = (ALL, PAPER)
# What a case shows besides the voltages.
QUANTITIES = {ALL: ("current", "temperature", "deflection"), PAPER: ("deflection",)}


@dataclass(frozen=True)
class Card:
    """What one case is to be.

    Attributes:
        kind: single, none, recalibration, pair or outside.
        effects: names of symptoms.EFFECTS or OUTSIDE.
        targets: gap over noise to size each effect for; None for a size as it comes.
        signals: "all", or "paper" (voltages and deflection only).
        colour: of the noise.
        mild_kinetics: the transformation is a little smoother than the model's, and that is all.
    """

    kind: str
    effects: tuple[str, ...]
    targets: tuple[float | None, ...]
    signals: str
    colour: str
    mild_kinetics: bool = False


def deal(n: int, rng: np.random.Generator) -> list[Card]:
    """n cards in random order, every share kept as nearly as n allows.

    Signals and noise colours are dealt within each kind, so that neither tells the kind.
    """
    cards: list[Card] = []
    for kind, count in _counts(n, rng).items():
        hidden = _HIDDEN[kind](count, rng)
        colours = _in_turns(tuple(COLOURS), count, rng)
        signals = _signals([effects for effects, _ in hidden], rng)
        mild = _mild(kind, colours, rng)
        cards += [
            Card(kind, effects, targets, signal, colour, flag)
            for (effects, targets), signal, colour, flag in zip(
                hidden, signals, colours, mild, strict=True
            )
        ]
    return [cards[k] for k in rng.permutation(len(cards))]


def _counts(n: int, rng: np.random.Generator) -> dict[str, int]:
    """Largest remainders; which kinds get the last cases is drawn where they are equal."""
    exact = {kind: share * n for kind, share in SHARES.items()}
    counts = {kind: int(value) for kind, value in exact.items()}
    order = sorted(exact, key=lambda kind: (counts[kind] - exact[kind], rng.random()))
    for kind in order[: n - sum(counts.values())]:
        counts[kind] += 1
    return counts


def _in_turns(names: Sequence, n: int, rng: np.random.Generator) -> list:
    """n names, each as often as any other give or take one, shuffled round by round."""
    rounds = -(-n // len(names))
    dealt = [names[k] for _ in range(rounds) for k in rng.permutation(len(names))]
    return dealt[:n]


_Hidden = tuple[tuple[str, ...], tuple[float | None, ...]]


def _one_of(
    names: Sequence[str], n: int, rng: np.random.Generator
) -> list[_Hidden]:
    """Each name in turn, and each name's severities in turn."""
    levels = {name: _in_turns(SEVERITIES, n, rng) for name in names}
    seen: Counter[str] = Counter()
    hidden: list[_Hidden] = []
    for name in _in_turns(names, n, rng):
        hidden.append(((name,), (levels[name][seen[name]],)))
        seen[name] += 1
    return hidden


def _singles(n: int, rng: np.random.Generator) -> list[_Hidden]:
    return _one_of(tuple(EFFECTS), n, rng)


def _outsiders(n: int, rng: np.random.Generator) -> list[_Hidden]:
    return _one_of(tuple(OUTSIDE), n, rng)


def _pairs(n: int, rng: np.random.Generator) -> list[_Hidden]:
    names = _in_turns(tuple(EFFECTS), 2 * n, rng)
    levels = _in_turns(PAIR_SEVERITIES, 2 * n, rng)
    hidden: list[_Hidden] = []
    for k in range(n):
        first, second = names[2 * k], names[2 * k + 1]
        while second == first:
            second = str(rng.choice(tuple(EFFECTS)))
        hidden.append(((first, second), (levels[2 * k], levels[2 * k + 1])))
    return hidden


def _nothing(n: int, rng: np.random.Generator) -> list[_Hidden]:
    return [((), ())] * n


_HIDDEN = {
    SINGLE: _singles,
    NONE: _nothing,
    RECALIBRATION: _nothing,
    PAIR: _pairs,
    OUTSIDE_KIND: _outsiders,
}


def _signals(hidden: list[tuple[str, ...]], rng: np.random.Generator) -> list[str]:
    """Half of each kind shows all signals, those that show in no other way among them."""
    symptoms = {**EFFECTS, **OUTSIDE}
    free = np.array(
        [all(symptoms[name].in_deflection for name in names) for names in hidden], dtype=bool
    )
    if not free.any():
        return [ALL] * len(hidden)
    # Every effect's own cases change sides in turn: systematic sampling along sorted names.
    share = min(0.5 * len(hidden) / free.sum(), 1.0)
    order = sorted(np.flatnonzero(free), key=lambda k: (hidden[k], rng.random()))
    steps = np.floor(share * np.arange(len(order) + 1) + rng.random())
    paper = {int(k) for k, taken in zip(order, np.diff(steps), strict=True) if taken}
    return [PAPER if k in paper else ALL for k in range(len(hidden))]


def _mild(kind: str, colours: list[str], rng: np.random.Generator) -> list[bool]:
    if kind != NONE:
        return [False] * len(colours)
    number = round(MILD_KINETICS_SHARE * len(colours))
    chosen = set(rng.permutation(len(colours))[:number].tolist())
    return [k in chosen for k in range(len(colours))]

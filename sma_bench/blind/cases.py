"""Which case hides what: kinds, effects, severities and signals dealt in balance."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sma_bench.blind.drives import Drive, draw_drives
from sma_bench.blind.rigs import draw_nominal, draw_truth, draw_wrong
from sma_bench.blind.sensors import COLOURS, Noise, Sensors
from sma_bench.blind.stage import RECORDS
from sma_bench.blind.symptoms import EFFECTS, OUTSIDE
from sma_bench.parameters import Parameters

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


# --- A case: what is dealt to it, and everything about it that is drawn without knowing that.

SPLITS = {"development": range(1000, 2000), "frozen-test": range(2000, 3000)}
OPEN = "open"

# Purposes of a case's own random numbers; each has its own stream, so that nothing drawn for one
# depends on how much another one drew.
_STREAMS = ("rig", "beliefs", "drives", "sensors", "nuisances", "effect", "bag", *RECORDS)
_DECK = 2**31 - 1

_STORAGES = ("mcap", "sqlite3")
_NAMESPACES = ("bench", "lab/bench", "rig_2/bench", "composite/bench")
_FIRST_DAY, _DAYS = 1_704_067_200, 540  # 2024-01-01, and the days of a campaign
_WORKING_HOURS = (8 * 3600, 18 * 3600)
_PAUSE = (200.0, 3000.0)  # s between the starts of a case's two records

# Middle of the noise of each quantity; it varies by a factor from rig to rig.
_NOISE = {"voltage": 0.004, "current": 0.008, "temperature": 0.25, "deflection": 40e-6}
_NOISE_FACTOR = (0.7, 1.4)
_JITTER = (0.0005, 0.0014)
_DROPOUT = (0.004, 0.02)
_CAMERA_CLOCK = (-0.004, 0.012)

# What every rig has a little of, at the size that `nuisance_scale` = 1 gives it.
_NUISANCES = {
    "grain_spread": (0.0, 0.4),
    "convection_by_correlation": (0.0, 0.02),
    "deflection_drift": (-15e-6, 15e-6),
}
# Gap over noise of all nuisances together.
NUISANCE_GAP = (0.05, 0.25)
NUISANCE_LIMIT = 0.3
# Of a transformation that is a little smoother than the model's.
MILD_GAP = (1.0, 6.0)


@dataclass(frozen=True)
class Case:
    """One case before anything is simulated.

    Attributes:
        name: of its folder.
        card: what it hides.
        truth, nominal: the rig, and what its owners believe.
        wrong: parameter -> error in stated standard deviations, where the owners are mistaken.
        sensors, drives: the instruments, and the voltages by record.
        nuisances: features that every rig has a little of; nuisance_gap: their wanted gap.
        mild_gap: wanted gap of mildly different kinetics.
        storage, namespace: of the bags; starts: by record, ns since the epoch.
    """

    seed: int
    index: int
    name: str
    card: Card
    truth: Parameters
    nominal: Parameters
    wrong: Mapping[str, float]
    sensors: Sensors
    drives: Mapping[str, Drive]
    nuisances: Mapping[str, float]
    nuisance_gap: float
    mild_gap: float
    storage: str
    namespace: str
    starts: Mapping[str, int]

    def stream(self, purpose: str) -> np.random.Generator:
        """Random numbers of this case for one purpose, from their beginning."""
        return _stream(self.seed, self.index, purpose)


def split_of(seed: int) -> str:
    """The set that cases of this seed belong to."""
    return next((name for name, seeds in SPLITS.items() if seed in seeds), OPEN)


def draw_cases(seed: int, n: int) -> list[Case]:
    """The n cases of a seed, nothing simulated."""
    cards = deal(n, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DECK,))))
    width = max(4, len(str(n)))
    return [draw_case(seed, k, card, f"{k + 1:0{width}d}") for k, card in enumerate(cards)]


def draw_case(seed: int, index: int, card: Card, name: str) -> Case:
    """One case; its card decides about the noise's colour and the owners' mistakes, no more."""

    def stream(purpose: str) -> np.random.Generator:
        return _stream(seed, index, purpose)

    truth = draw_truth(stream("rig"))
    beliefs = stream("beliefs")
    mistakes = draw_wrong(beliefs)
    wrong = mistakes if card.kind == RECALIBRATION else {}
    little = stream("nuisances")
    nuisances = {n: float(little.uniform(*limits)) for n, limits in _NUISANCES.items()}
    bag = stream("bag")
    return Case(
        seed,
        index,
        name,
        card,
        truth,
        draw_nominal(truth, beliefs, wrong),
        wrong,
        _draw_sensors(card.colour, stream("sensors")),
        draw_drives(truth, stream("drives")),
        nuisances,
        nuisance_gap=float(little.uniform(*NUISANCE_GAP)),
        mild_gap=float(np.exp(little.uniform(*np.log(MILD_GAP)))),
        storage=str(bag.choice(_STORAGES)),
        namespace=str(bag.choice(_NAMESPACES)),
        starts=_draw_starts(bag),
    )


def _stream(seed: int, index: int, purpose: str) -> np.random.Generator:
    key = (index, _STREAMS.index(purpose))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _draw_sensors(colour: str, rng: np.random.Generator) -> Sensors:
    noise = {}
    for quantity, middle in _NOISE.items():
        std = middle * float(np.exp(rng.uniform(*np.log(_NOISE_FACTOR))))
        noise[quantity] = Noise.of_colour("white" if quantity == "voltage" else colour, std, rng)
    return Sensors(
        noise,
        jitter=float(rng.uniform(*_JITTER)),
        dropout=float(rng.uniform(*_DROPOUT)),
        camera_clock=float(rng.uniform(*_CAMERA_CLOCK)),
        seed=int(rng.integers(2**31)),
    )


def _draw_starts(rng: np.random.Generator) -> dict[str, int]:
    """ns since the epoch: some working day, the second record after the first."""
    day = _FIRST_DAY + 86400 * int(rng.integers(_DAYS))
    first = day + float(rng.uniform(*_WORKING_HOURS))
    times = (first, first + float(rng.uniform(*_PAUSE)))
    return {name: int(t * 1e9) for name, t in zip(RECORDS, times, strict=True)}

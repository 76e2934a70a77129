"""Cases: features of every effect, which case hides which, and everything else that is drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import yaml

from examination.blind import rigs
from examination.blind.case_files import RECALIBRATION
from examination.blind.reality import BY_NAME
from examination.blind.rigs import RECORDS, Stage
from examination.blind.sensors import NOISE_MODELS, Noise, Sensors, measure
from sma_bench.parameters import Parameters
from sma_bench.records import Signal

# --- Every effect as features of the reality: symptoms.yaml.
MOVING = ("beam", "force", "spring", "antagonist")
CLAMPED, LOADS, ALL_LOADS = "clamped", ("clamped", *MOVING), "all"


@dataclass(frozen=True)
class Move:
    """An effect's amount a adds a times a `weight` to a feature, or is a factor exp of that."""

    weight: tuple[float, float] = (1.0, 1.0)
    factor: bool = False

    def moved(self, name: str, features: Mapping[str, float], amount: float) -> float:
        feature = BY_NAME[name]
        before = features.get(name, feature.off)
        value = before * float(np.exp(amount)) if self.factor else before + amount
        return float(np.clip(value, feature.low, feature.high))


@dataclass(frozen=True)
class Setting:
    """A feature that shapes the effect whatever its amount; `spread` even or log."""

    low: float
    high: float
    spread: str = "even"


@dataclass(frozen=True)
class Form:
    """One form of an effect: moves and natural amounts instead of the effect's own, further
    settings, and loads under which it differs from the effect's first form (from seed 2800 on)."""

    moves: dict[str, Move] | None = None
    natural: tuple[float, float] | None = None
    settings: dict[str, Setting] = field(default_factory=dict)
    loads: tuple[str, ...] = LOADS


@dataclass(frozen=True)
class Symptom:
    """One effect; the fields are explained in symptoms.yaml."""

    moves: dict[str, Move]
    natural: tuple[float, float]
    forms: dict[str, Form] = field(default_factory=dict)
    stage: str = ""
    signs: tuple[int, ...] = (1,)
    settings: dict[str, Setting] = field(default_factory=dict)
    in_deflection: bool = True
    of_peak_current: bool = False
    loads: tuple[str, ...] = MOVING

    def in_form(self, name: str) -> "Symptom":
        """The effect in one of its forms; unchanged for ""."""
        form = self.forms[name] if name else Form()
        return replace(self, moves=form.moves or self.moves, natural=form.natural or self.natural,
                       settings={**self.settings, **form.settings})


_HERE = Path(__file__)
_DEALT = yaml.safe_load(_HERE.with_suffix(".yaml").read_text())
_TABLE = msgspec.convert(yaml.safe_load(_HERE.with_name("symptoms.yaml").read_text()),
                         dict[str, dict[str, Symptom]])
# The contract's effects, and effects outside the library.
EFFECTS, OUTSIDE = _TABLE["effects"], _TABLE["outside"]
# Effects of which every rig has a little; forms of what every rig has, with their features.
OF_ALL_RIGS = ("temperature_dependent_convection", "deflection_drift", "temperature_lag")
_ALWAYS: dict[str, dict[str, dict[str, float]]] = _DEALT["always"]
# Largest and smallest amount for a target, in times the largest natural one.
STRETCH, _SMALLEST = 1.5, 1e-4
_TRIALS, _CLOSE, _STALLED = 6, 0.12, 1e-3  # log gap over target; step of the log amount


@dataclass(frozen=True)
class Draw:
    """An effect as drawn for one rig: everything except its amount."""

    symptom: Symptom
    sign: int
    weights: tuple[float, ...]
    settings: Mapping[str, float]
    peak_current: float

    def features(self, base: Mapping[str, float], amount: float) -> dict[str, float]:
        changed = {**base, **self.settings}
        for (name, move), weight in zip(self.symptom.moves.items(), self.weights, strict=True):
            by = self.sign * amount * weight
            if self.symptom.of_peak_current:  # a current limit, which is off at 0
                by = self.peak_current * (1.0 - amount)
            changed[name] = move.moved(name, base, by)
        return changed

    def natural(self, rng: np.random.Generator) -> float:
        """A realistic amount, uniform in its logarithm."""
        return float(np.exp(rng.uniform(*np.log(self.symptom.natural))))


def draw(symptom: Symptom, rng: np.random.Generator, peak_current: float) -> Draw:
    """Direction, weights and settings of one occurrence; the largest current [A] of the records."""
    sign = int(rng.choice(symptom.signs))
    weights = tuple(float(rng.uniform(*move.weight)) for move in symptom.moves.values())
    return Draw(symptom, sign, weights, draw_settings(symptom.settings, rng), peak_current)


def draw_settings(settings: Mapping[str, Setting], rng: np.random.Generator) -> dict[str, float]:
    return {name: float(np.exp(rng.uniform(np.log(s.low), np.log(s.high))) if s.spread == "log"
                        else rng.uniform(s.low, s.high))
            for name, s in settings.items()}


def amount_for(drawn: Draw, target: float, gap: Callable[[float], float], start: float) -> float:
    """Amount whose gap is `target`, or the nearest that the effect's bounds allow: steps in
    proportion from `start` until the target is bracketed, then interpolation on logarithms."""
    high = drawn.symptom.natural[1]
    smallest, largest = np.log(high * _SMALLEST), np.log(high * STRETCH)
    at = float(np.log(start))
    tried: list[tuple[float, float]] = []  # log amount, log gap over target
    for _ in range(_TRIALS):
        tried.append((at, float(np.log(max(gap(float(np.exp(at))), 1e-9) / target))))
        below, above = ([t for t in tried if (t[1] < 0) == small] for small in (True, False))
        if below and above:
            (x0, y0), (x1, y1) = max(below), min(above)
            crossing = x0 - y0 * (x1 - x0) / (y1 - y0)
        else:
            crossing = at - tried[-1][1]
        following = float(np.clip(crossing, smallest, largest))
        if abs(tried[-1][1]) < _CLOSE or abs(following - at) < _STALLED:
            break
        at = following
    return float(np.exp(min(tried, key=lambda trial: abs(trial[1]))[0]))


# --- Which case hides what: kinds, effects, severities and signals dealt in balance.
SINGLE, NONE, PAIR, OUTSIDE_KIND = "single", "none", "pair", "outside"
ALL, PAPER = "all", "paper"
# Signals of a case in addition to the voltages.
QUANTITIES = {ALL: ("current", "temperature", "deflection"), PAPER: ("deflection",),
              "without current": ("temperature", "deflection"),
              "without temperature": ("current", "deflection")}


@dataclass(frozen=True)
class Card:
    """The plan of one case: its kind, effects of EFFECTS or OUTSIDE, the gap over noise for which
    each is sized (None: a natural amount), signals of QUANTITIES, noise of NOISE_MODELS; with
    `mild_kinetics` the transformation is a little smoother than the model's."""

    kind: str
    effects: tuple[str, ...]
    targets: tuple[float | None, ...]
    signals: str
    noise: str
    mild_kinetics: bool = False


def possible(symptoms: Mapping[str, Symptom], load: str) -> tuple[str, ...]:
    return tuple(name for name, symptom in symptoms.items() if load in symptom.loads)


def deal(n: int, rng: np.random.Generator, load: str = "beam",
         shares: str = "shares") -> list[Card]:
    """n cards in random order, every share kept as nearly as n allows. Signals and noise models are
    dealt within each kind, so that neither reveals the kind."""
    # Largest remainders; ties for the last cases are drawn.
    exact = {kind: share * n for kind, share in _DEALT[shares].items()}
    counts = {kind: int(value) for kind, value in exact.items()}
    order = sorted(exact, key=lambda kind: (counts[kind] - exact[kind], rng.random()))
    for kind in order[: n - sum(counts.values())]:
        counts[kind] += 1
    cards: list[Card] = []
    for kind, count in counts.items():
        hidden = _hidden(kind, count, rng, load)
        noises = _in_turns(tuple(NOISE_MODELS), count, rng)
        signals = _signals([effects for effects, _ in hidden], rng, load)
        mild: set[int] = set()
        if kind == NONE:
            few = round(_DEALT["mild_kinetics_share"] * count)
            mild = set(rng.permutation(count)[:few].tolist())
        cards += [Card(kind, *hidden[k], signals[k], noises[k], k in mild) for k in range(count)]
    return [cards[k] for k in rng.permutation(len(cards))]


def _in_turns(names: Sequence, n: int, rng: np.random.Generator) -> list:
    """n names, all equally often to within one, shuffled in every round."""
    rounds = -(-n // len(names))
    dealt = [names[k] for _ in range(rounds) for k in rng.permutation(len(names))]
    return dealt[:n]


def _hidden(kind: str, n: int, rng: np.random.Generator,
            load: str) -> list[tuple[tuple[str, ...], tuple[float | None, ...]]]:
    """Effects and their severities: each name in turn, and each name's severities in turn."""
    if kind in (SINGLE, OUTSIDE_KIND):
        names = possible(EFFECTS if kind == SINGLE else OUTSIDE, load)
        levels = {name: iter(_in_turns(_DEALT["severities"], n, rng)) for name in names}
        return [((name,), (next(levels[name]),)) for name in _in_turns(names, n, rng)]
    if kind != PAIR:
        return [((), ())] * n
    every = possible(EFFECTS, load)
    dealt = _in_turns(every, 2 * n, rng)
    both = _in_turns(_DEALT["pair_severities"], 2 * n, rng)
    for k in range(0, 2 * n, 2):
        while dealt[k + 1] == dealt[k]:
            dealt[k + 1] = str(rng.choice(every))
    return [(tuple(dealt[k : k + 2]), tuple(both[k : k + 2])) for k in range(0, 2 * n, 2)]


def _signals(hidden: list[tuple[str, ...]], rng: np.random.Generator, load: str) -> list[str]:
    """Half of each kind shows all signals, among them effects that need them; the others fewer."""
    symptoms = {**EFFECTS, **OUTSIDE}
    less = "without current" if load == CLAMPED else PAPER
    free = [k for k, names in enumerate(hidden)
            if load == CLAMPED or all(symptoms[n].in_deflection for n in names)]
    if not free:
        return [ALL] * len(hidden)
    # Cases of each effect alternate: systematic sampling along sorted names.
    share = min(0.5 * len(hidden) / len(free), 1.0)
    order = sorted(free, key=lambda k: (hidden[k], rng.random()))
    steps = np.floor(share * np.arange(len(order) + 1) + rng.random())
    paper = {k for k, taken in zip(order, np.diff(steps), strict=True) if taken}
    return [less if k in paper else ALL for k in range(len(hidden))]


# --- A case: its card, and everything that is drawn independently of the card.
SPLITS = {range(1000, 2000): "development", range(2000, 3000): "frozen-test",
          range(3000, 4000): "development"}
OPEN = "open"
# Seeds from 2700 on: effects, and what every rig has, come in forms, drawn for every case; 2800:
# sets of all loads have clamped wires, and forms suit the load; 2900: labels say where the inner
# loops of spread grains show; 2950: labels refit zeros, do not linearise benches, and have rivals
# in every form; 2960: benches are in a slightly different state in the second record.
IN_FORMS, WITH_CLAMPED, WITH_LOOPS, WITH_REFITS, WITH_STATES = (
    range(first, 4000) for first in (2700, 2800, 2900, 2950, 2960))
# Shares of the kinds of cases from seed 2700 on.
FROZEN_SHARES: dict[str, float] = _DEALT["shares_of_forms"]
# Purposes of a case's random numbers; each has a stream of its own, so that draws for one do not
# depend on those for another.
_STREAMS = ("rig", "beliefs", "drives", "sensors", "nuisances", "effect", "bag", *RECORDS, "forms",
            "states")
DECK = 2**31 - 1
NUISANCE_LIMIT = 0.3  # gap over noise that all nuisances together stay below


@dataclass(frozen=True, kw_only=True)
class Case(Stage):
    """One case before anything is simulated; rig, drives and instruments are those of `Stage`."""

    seed: int
    index: int
    name: str
    card: Card  # what it hides
    nominal: Parameters  # as stated by the owners
    wrong: Mapping[str, float]  # errors of wrong parameters, in stated standard deviations
    nuisances: Mapping[str, float]  # features that every rig has a little of, before scaling
    nuisance_gap: float  # wanted gap over noise of these
    mild_gap: float  # wanted gap over noise of mild kinetics
    storage: str  # of the bags
    namespace: str
    starts: Mapping[str, int]  # ns since the epoch, by record
    forms: Mapping[str, str] = field(default_factory=dict)  # of effects, and of what every rig has
    fixed: Mapping[str, float] = field(default_factory=dict)  # features by forms of the latter
    # true numbers that are different in the run of the second record
    second_run: Mapping[str, float] = field(default_factory=dict)

    def signals(self, features: Mapping[str, float], record: str) -> list[Signal]:
        """Recorded signals, with the bench in the state of that record's run."""
        is_other = self.second_run and record != RECORDS[0]
        now = self.truth.replace(dict(self.second_run)) if is_other else None
        outcome = self.play(features, record, parameters=now)
        return measure(outcome, rigs.world_of(self.truth, features), self.sensors,
                       self.stream(record), QUANTITIES[self.card.signals])

    def stream(self, purpose: str) -> np.random.Generator:
        return _stream(self.seed, self.index, purpose)


def split_of(seed: int) -> str:
    return next((name for seeds, name in SPLITS.items() if seed in seeds), OPEN)


def draw_cases(seed: int, n: int, load: str = "beam") -> list[Case]:
    """n cases of a load, or of all of them."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(DECK,)))
    width, shares = max(4, len(str(n))), "shares"
    if seed in IN_FORMS and split_of(seed) == "frozen-test":
        shares = "shares_of_forms"
    if load != ALL_LOADS:
        cards = [(load, card) for card in deal(n, rng, load, shares)]
    else:
        parts = _DEALT["with_clamped" if seed in WITH_CLAMPED else "all_loads"]
        counts = {one: int(part * n + 1e-9) for one, part in parts.items()}
        counts["beam"] += n - sum(counts.values())
        cards = [(one, card)
                 for one, count in counts.items() for card in deal(count, rng, one, shares)]
        cards = [cards[k] for k in rng.permutation(n)]
    return [draw_case(seed, k, card, f"{k + 1:0{width}d}", one)
            for k, (one, card) in enumerate(cards)]


def draw_case(seed: int, index: int, card: Card, name: str, load: str = "beam") -> Case:
    """One case; only its noise model and the owners' mistakes depend on its card."""
    stream = partial(_stream, seed, index)
    truth = rigs.draw_truth(stream("rig"), load)
    beliefs, little, bag = map(stream, ("beliefs", "nuisances", "bag"))
    mistakes = rigs.draw_wrong(beliefs, load)
    wrong = mistakes if card.kind == RECALIBRATION else {}
    nuisances = {n: float(little.uniform(*limits)) for n, limits in _DEALT["nuisances"].items()}
    forms, fixed = {}, {}
    if seed in IN_FORMS:
        own = stream("forms")
        forms, fixed = _draw_forms(own, load if seed in WITH_CLAMPED else "")
        nuisances |= {n: float(own.uniform(*ends)) for n, ends in _DEALT["further"].items()}
        mild = bool(own.random() < _DEALT["other_law_share"])
        card = replace(card, mild_kinetics=mild and load != CLAMPED)  # where it does not show
    state = stream("states")
    away = state.standard_normal(len(_DEALT["states"]))
    second_run = {
        n: truth[n] + std * z if n.endswith("temperature") else truth[n] * float(np.exp(std * z))
        for (n, std), z in zip(_DEALT["states"].items(), away.tolist(), strict=True)
        if seed in WITH_STATES} if state.random() < _DEALT["states_share"] else {}
    storage, namespace = (str(bag.choice(_DEALT[k])) for k in ("storages", "namespaces"))
    # Some working day, the second record after the first.
    day = _DEALT["first_day"] + 86400 * int(bag.integers(_DEALT["days"]))
    first = day + float(bag.uniform(*_DEALT["working_hours"]))
    starts = (first, first + float(bag.uniform(*_DEALT["pause"])))
    rng, noise = stream("sensors"), {}
    for quantity, middle in _DEALT["noise"].items():
        std = middle * float(np.exp(rng.uniform(*np.log(_DEALT["noise_factor"]))))
        noise_model = "white" if quantity == "voltage" else card.noise
        noise[quantity] = Noise.of_model(noise_model, std, rng)
    clock = {n: float(rng.uniform(*_DEALT[n])) for n in ("jitter", "dropout", "camera_clock")}
    sensors = Sensors(noise, **clock, seed=int(rng.integers(2**31)))
    random = stream("drives")
    families = random.choice(rigs.FAMILIES, size=2, replace=False).tolist()
    drives = {r: rigs.draw_drive(f, truth, random) for r, f in zip(RECORDS, families, strict=True)}
    return Case(truth, sensors, drives, seed=seed, index=index, name=name, card=card, wrong=wrong,
                nuisances=nuisances, nominal=rigs.draw_nominal(truth, beliefs, wrong),
                nuisance_gap=float(little.uniform(*_DEALT["nuisance_gap"])),
                mild_gap=float(np.exp(little.uniform(*np.log(_DEALT["mild_gap"])))),
                storage=storage, namespace=namespace,
                starts={name: int(t * 1e9) for name, t in zip(RECORDS, starts, strict=True)},
                forms=forms, fixed=fixed, second_run=second_run)


def _draw_forms(rng: np.random.Generator, load: str) -> tuple[dict[str, str], dict[str, float]]:
    """A form of every effect and of what every rig has, by name, and the features of the latter; a
    small share of an effect that every rig has is in the form of the effect. Forms that do not
    differ from the first one under the `load` (if named) are replaced by the first."""
    forms = {name: str(rng.choice(list(symptom.forms))) for name, symptom in EFFECTS.items()}
    for name, form in forms.items() if load else ():
        if load not in EFFECTS[name].forms[form].loads:
            forms[name] = next(iter(EFFECTS[name].forms))
    fixed = {}
    for name in OF_ALL_RIGS:
        fixed |= draw_settings(EFFECTS[name].forms[forms[name]].settings, rng)
    for name, known in _ALWAYS.items():
        forms[name] = str(rng.choice(list(known)))
        fixed |= known[forms[name]]
    return forms, fixed


def _stream(seed: int, index: int, purpose: str) -> np.random.Generator:
    key = (index, _STREAMS.index(purpose))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

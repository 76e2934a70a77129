"""Candidates: recalibration alone, every effect with it, and pairs around the best ones."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.compiled import in_threads
from sma_bench.diagnose.left_over import Flexible, Left, flexible_residual, left_over, process_noise
from sma_bench.estimation.laws import nearest_starts, starts
from sma_bench.estimation.nuisances import STATE, TICK
from sma_bench.estimation.observation import MOVED, Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, by_evidence, fit, recalibrate
from sma_bench.estimation.unknowns import (
    IF_STATED,
    LAW_EFFECT,
    Unknowns,
    is_stated,
    number_of_effect,
    stated_effects,
    unknowns_of,
    unknowns_of_records,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.residual_strain import CARRIED_OVER

# Of the best gain in evidence, and nats: what lies this near is fitted carefully.
_CLOSE, _NEAR = 0.35, 15.0
_MOST_REFINED, _MOST_FROM_BELIEF, _MOST_PAIRED, _PARTNERS = 4, 3, 3, 3
_HOPELESS = 0.5  # of the best single's gain: with a partner, less than that is no rival of it
_STANDS_STILL = 0.05  # of the motion that is read
_DRAWN, _STARTED = 60, 2  # benches that are tried where the believed one stands still
_LOST = 5.0  # nats below recalibration: the fit may have gone astray
_FIRST = 2  # effects, the most promising
_MOST_FORMS = 4  # beyond the usual ones that are fitted
# Where the lead is beyond ten promises and this many nats more, an effect gets no fit.
_PROMISES, _BEYOND = 10.0, 30.0
_WORTH_A_FORM = 2.0  # nats that a start promises
_STUCK = 5.0  # nats that show a fit had not arrived
_MOST_PASSES, _MOVING = 4, 1.0  # nats that are worth another
_SURPRISING = 2.5  # prior deviations of a recalibrated parameter
_WORTH_PAIRING = 8.0  # nats of a single
# What an effect adds to 1/C beside C itself: its fit can stay on the way from one to the other.
_MOVED = 0.3  # prior deviations that are worth another fit
_INSTEAD = {"stress_dependent_transition": {
    f"effect.stress_dependent_transition.{phase}": f"wire.stress_influence_{phase}"
    for phase in ("austenite", "martensite")}}

_TRIED = read_yaml(Path(__file__).with_name("starts.yaml"))
_STRETCH = (0.3, 2.0)  # of a tried size that is still believed

Progress = Callable[[str], None]


class Start(NamedTuple):
    """Where to begin, and the gain in log posterior that a straight line from there promises."""

    x: Array
    gain: float


@dataclass(frozen=True, eq=False)
class Search:
    """Every candidate, fitted to all records."""

    problem: Problem
    nominal: Fit  # the parameters as believed, only the sensors' noise and zeros fitted
    recalibrated: Fit  # the same model, parameters moved under their priors
    singles: dict[str, Fit]  # by effect
    pairs: dict[tuple[str, str], Fit]  # by two effects, those that were worth a fit
    best: Fit  # of all these, the one with the largest evidence
    flexible: Flexible  # of what recalibration leaves
    beyond: Flexible  # of what the best candidate leaves
    left: Left  # whether what recalibration leaves depends on what the bench does
    left_by_best: Left  # of the best
    # what a smooth input to each stage explains of it, the best stage first
    inputs: dict[str, Flexible]
    inputs_by_best: dict[str, Flexible]

    def gain(self, name: str) -> float:
        """Evidence of an effect over recalibration [nats]."""
        if name == LAW_EFFECT:  # which recalibration has too
            return 0.0
        return self.singles[name].evidence - self.recalibrated.evidence

    @property
    def ranked(self) -> list[str]:
        return sorted(self.singles, key=self.gain, reverse=True)


def search(observations: Sequence[Observation], parameters: Parameters,
           progress: Progress = lambda text: None, doubted: Collection[str] = ()) -> Search:
    """Fit everything to all records, those held out as well (their shares are parted later).
    `doubted`: quantities whose readings are under suspicion, for which effects are `held_back`."""
    quantities = tuple(dict.fromkeys(q for obs in observations for q in obs.quantities))
    baseline = unknowns_of_records(parameters, quantities, other_laws=True)
    progress("recalibration")
    fresh = Problem.of(observations, later=1.0)
    tries, here = starts(baseline, 0), fresh.predict(parameters)
    # Where the bench believed in stands still, no small step shows a motion, and all of it would
    # pass for drift: believable benches that move as the records do.
    if any(np.ptp(here[b.rows]) <= _STANDS_STILL * np.ptp(b.signal.value)
           for b in fresh.blocks if b.signal.quantity in MOVED):
        tries += nearest_starts(fresh, baseline, _DRAWN)[:_STARTED]
    recalibrated, _ = recalibrate(fresh, parameters, baseline, tries)
    where = recalibrated.problem
    problem = replace(fresh, observations=where.observations, nuisances=where.nuisances)
    # As believed: every parameter exact.
    nominal = fit(problem, unknowns_of(parameters, (), shapes={}), np.zeros(0), rounds=2)
    names = [n for n in possible_effects(parameters, quantities) if n not in held_back(doubted)]
    kinds = [baseline.with_effects([n], {n: f}) for n in names for f in _forms(n, observations)]
    singles = _singles(kinds, recalibrated, progress)

    def keep(fits: Iterable[Fit]) -> None:
        for found in fits:
            (name,) = found.unknowns.effects
            singles[name] = max(singles[name], found, key=by_evidence)

    recalibrated, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("recalibration was stuck: once more")
        singles = _singles(kinds, recalibrated, progress)
    if _surprises(recalibrated):
        # The way back to believed parameters can be winding: the most promising begin at these.
        progress("effects instead of surprising parameters")
        away, alike = problem.of_kind(STATE), problem
        if away.any():
            alike = problem.about(parameters, np.where(away, 0.0, recalibrated.z))
        read = replace(alike, noise=recalibrated.problem.noise)
        begun = _starts(kinds, fit(read, baseline, baseline.start(), rounds=0))[:_MOST_FROM_BELIEF]
        keep(in_threads(lambda kind, start: fit(alike, kind, start.x, far=True), begun))

    progress("the best again, carefully")
    ranked = sorted(singles.values(), key=by_evidence, reverse=True)
    gains = [found.evidence - recalibrated.evidence for found in ranked] or [0.0]
    limit = gains[0] - max(_NEAR, _CLOSE * gains[0])
    worth = [(found,) for found, gain in zip(ranked[:_MOST_REFINED], gains, strict=False)
             if gain >= limit]
    instead = [_handed_over(found) for name, found in singles.items() if name in _INSTEAD]
    keep([*in_threads(_refined, worth), *instead])
    better, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("recalibration was stuck: once more")
        keep(_singles(kinds, better, progress).values())
    recalibrated = max(better, _refined(better), key=by_evidence) if _is_bent(better) else better
    progress("pairs")
    pairs = _pairs(baseline, singles, recalibrated)

    best = max([recalibrated, *singles.values(), *pairs.values()], key=by_evidence)
    progress("what is left")
    fits = list(dict.fromkeys([recalibrated, best]))
    looks = flexible_residual, left_over, process_noise
    done = in_threads(lambda look, fitted: look(fitted), [(k, f) for k in looks for f in fits])
    # Of each look that at recalibration, and that at the best.
    both = [done[n] for k in range(len(looks)) for n in (k * len(fits), (k + 1) * len(fits) - 1)]
    return Search(problem, nominal, recalibrated, singles, pairs, best, *both)


def held_back(doubted: Collection[str]) -> list[str]:
    """Effects that a doubted signal may feign: of its sensor; of voltage or current all."""
    everything = bool({"voltage", "current"} & set(doubted))
    return [name for name, effect in EFFECTS.items()
            if everything or (effect.stage == "sensor" and set(effect.acts_on) & set(doubted))]


def possible_effects(parameters: Parameters, quantities: Sequence[str]) -> list[str]:
    """Effects that this load and law can have and these signals show, not yet believed in."""
    stated, load, law = stated_effects(parameters), load_kind(parameters), parameters["wire.law"]
    known = {e.name for e in EFFECTS.values() if any(p.name in stated for p in e.parameters)}
    # Where the motion is imposed, the force shows what else shows in the motion.
    quantities = [*quantities, *(["deflection"] if "force" in quantities else [])]
    known |= {"slack"} if any(is_stated(parameters, n) for n in IF_STATED) else set()  # refused
    known.add(LAW_EFFECT)  # in every candidate
    return [name for name, effect in EFFECTS.items()
            if name not in known and load in effect.loads and law in effect.laws
            and set(effect.acts_on) & set(quantities)]


def _forms(name: str, observations: Sequence[Observation]) -> list[str]:
    """Of an effect, the usual one first; one that hands over to the next record needs a next."""
    others = list(EFFECTS[name].forms or ())[1:]
    follows = any(observation.before is not None for observation in observations)
    return ["", *(form for form in others if form != CARRIED_OVER or follows)]


def _surprises(fitted: Fit) -> bool:
    """Whether a number of the bench, or the state of a run, went further than anyone believes."""
    far = np.abs([*fitted.x[: fitted.unknowns.bench], *fitted.z[fitted.problem.of_kind(STATE)]])
    return bool(np.max(far, initial=0.0) > _SURPRISING)


def _starts(kinds: Sequence[Unknowns], fitted: Fit) -> list[tuple[Unknowns, Start]]:
    """Of every effect and form, added to a fit of the baseline; the most promising first."""
    gains_of = remainder(fitted)
    begun = in_threads(find_start, [(fitted, gains_of, kind) for kind in kinds])
    return sorted(zip(kinds, begun, strict=True), key=lambda both: -both[1].gain)


def _singles(kinds: Sequence[Unknowns], recalibrated: Fit, progress: Progress) -> dict[str, Fit]:
    """Every effect, begun where recalibration ended: the most promising first, beside which others
    may be hopeless. Of the forms that are not the usual one the most promising few are fitted."""
    if not kinds:
        return {}
    progress(kinds[0].effects[0])
    begun = _starts(kinds, recalibrated)

    def fit_from(kind: Unknowns, x: Array, rounds: int = 2, predicted: Array | None = None) -> Fit:
        return fit(recalibrated.problem, kind, x, rounds=rounds, frozen=recalibrated.derivatives,
                   predicted=predicted)

    def off(kind: Unknowns) -> Fit:
        return fit_from(kind, start_off(recalibrated, kind), 0, recalibrated.predicted)

    def single(kind: Unknowns, start: Start) -> Fit:
        progress(kind.effects[0])
        found = fit_from(kind, start.x)
        if found.evidence >= recalibrated.evidence - _LOST or kind.forms[0]:
            return found
        without = off(kind)
        if found.evidence < without.evidence:
            found = max(without, fit_from(kind, without.x), key=by_evidence)
        return found

    worth = [both for both in begun if both[0].forms[0] and both[1].gain > _WORTH_A_FORM]
    worth = [both for both in begun if not both[0].forms[0] or both in worth[:_MOST_FORMS]]
    # Where numbers went further than anyone believes, a straight line from there says little.
    beyond = _BEYOND if not _surprises(recalibrated) else np.inf
    found = in_threads(single, worth[:_FIRST])
    least = max(f.evidence - recalibrated.evidence for f in found) - beyond
    others = [(*both, _PROMISES * both[1].gain >= least) for both in worth[_FIRST:]]
    found += in_threads(lambda kind, start, hope: single(kind, start) if hope else off(kind),
                        [one for one in others if one[2] or not one[0].forms[0]])
    fits: dict[str, Fit] = {}
    for one in found:
        (name,) = one.unknowns.effects
        # Of forms that are alike, as the wires opposite are of a wire alone, the usual one counts.
        fits[name] = max(fits.get(name, one), one,
                         key=lambda f: (round(f.evidence, 1), not f.unknowns.forms[0]))
    return {name: fits[name] for name in dict.fromkeys(k.effects[0] for k in kinds)}


def _again(baseline: Unknowns, recalibrated: Fit, singles: dict[str, Fit]) -> tuple[Fit, bool]:
    """Recalibration from where the best effect has taken the parameters, if that is better; and
    whether it is so much better that effects are to be looked for from there."""
    if not singles:
        return recalibrated, False
    best = max(singles.values(), key=by_evidence)
    better = fit(recalibrated.problem, baseline, best.x[: baseline.baseline], far=True)
    gained = better.evidence - recalibrated.evidence
    return (better if gained > 0.0 else recalibrated), gained > _STUCK


def _is_bent(fitted: Fit) -> bool:
    return bool((fitted.problem.of_kind(STATE) | fitted.problem.of_kind(TICK)).any())


def _refined(found: Fit) -> Fit:
    """The same model once more, with what its own jumps and delays do, not recalibration's; until
    that gains nothing where a run's state or a slow logger's jumps are taken along."""
    bent = _is_bent(found)
    for _ in range(_MOST_PASSES if bent else 1):
        problem, gone = found.problem.about(found.parameters, found.z), found.evidence
        known = None if bent else found.predicted
        found = fit(problem, found.unknowns, found.x, rounds=2, predicted=known)
        if found.evidence - gone < _MOVING:
            break
    return found


def _handed_over(found: Fit) -> Fit:
    """The same sum of both, all of it the effect's: the parameters as believed."""
    (effect,) = found.unknowns.effects
    names, items, x = found.unknowns.names, found.unknowns.items, found.x.copy()
    for number, parameter in _INSTEAD[effect].items():
        if not {number, parameter} <= {*names}:
            continue
        k, c = names.index(number), names.index(parameter)
        added = 1.0 / items[c].value(x[c]) - 1.0 / items[c].value(0.0)
        x[k] = items[k].x_of(items[k].value(x[k]) + added)
        x[c] = 0.0
    if np.max(np.abs(x - found.x)) < _MOVED:
        return found
    return fit(found.problem, found.unknowns, x, rounds=2)


def _pairs(baseline: Unknowns, singles: dict[str, Fit],
           recalibrated: Fit) -> dict[tuple[str, str], Fit]:
    """The best singles with the partners that promise most; the best pair once more, refined."""
    ranked = sorted(singles.values(), key=by_evidence, reverse=True)
    gains = [found.evidence - recalibrated.evidence for found in ranked]
    pairs: dict[tuple[str, str], Fit] = {}

    def keep(found: Fit) -> None:
        one, other = sorted(found.unknowns.effects)
        pairs[one, other] = max(pairs.get((one, other), found), found, key=by_evidence)

    for alone, gain in zip(ranked[:_MOST_PAIRED], gains, strict=False):
        if gain < max(_WORTH_PAIRING, _HOPELESS * gains[0]):
            continue
        (name,), (own,) = alone.unknowns.effects, alone.unknowns.forms
        kinds = [baseline.with_effects([name, one], {name: own, one: form}) for one in singles
                 if one != name for form in _forms(one, alone.problem.observations)]
        promising: dict[str, tuple[Unknowns, Array]] = {}
        for kind, start in _starts(kinds, alone):
            promising.setdefault(kind.effects[-1], (kind, start.x))
        with_partner = partial(fit, alone.problem, rounds=2,
                               frozen=alone.derivatives[:, : baseline.baseline])
        for found in in_threads(with_partner, list(promising.values())[:_PARTNERS]):
            keep(found)
    if pairs:
        keep(_refined(max(pairs.values(), key=by_evidence)))
    return pairs


# --- Where the fit of an effect begins: sizes tried against what recalibration leaves. Slopes at
# zero are blind to numbers that act only together with another, so whole differences are tried.


Gains = Callable[[Sequence[Parameters]], tuple[Array, Array]]


def remainder(fitted: Fit) -> Gains:
    """Of p benches the gains (p,) of adding a multiple of what each changes, and these multiples
    (p,): of what recalibration leaves, all directions that it can still go taken out."""
    problem = fitted.problem
    rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
    normal = cho_factor(rows.T @ rows + np.eye(rows.shape[1]))
    residual = problem.whiten(problem.measured - fitted.predicted)
    # The priors pull back what they had to let go: an effect may relieve them of it.
    moved = np.concatenate([fitted.x, np.zeros(rows.shape[1] - len(fitted.x))])
    left = residual - rows @ cho_solve(normal, rows.T @ residual - moved)
    before = problem.coarse.predict(fitted.parameters)[:, np.newaxis]

    def gains(benches: Sequence[Parameters]) -> tuple[Array, Array]:
        found = problem.coarse.predict_many(benches) - before
        changes = problem.whiten(np.where(np.isfinite(found).all(axis=0), found, 0.0))
        seen, pull = rows.T @ changes, changes.T @ left
        power = np.sum(changes**2, axis=0) - np.sum(seen * cho_solve(normal, seen), axis=0)
        share = np.clip(pull / np.where(power > 0.0, power, np.inf), *_STRETCH)
        return np.where(power > 0.0, share * pull - 0.5 * share**2 * power, 0.0), share

    return gains


def find_start(fitted: Fit, gains_of: Gains, unknowns: Unknowns) -> Start:
    """Best of the tried sizes of the last effect, added to a fit, by what its `remainder` gains."""
    bounds, effect = unknowns.bounds(), EFFECTS[unknowns.effects[-1]]
    own = effect.numbers(unknowns.forms[-1])
    first = len(unknowns.names) - len(own)
    switches = [first + k for k, p in enumerate(own) if p in effect.switches]
    # One switch at a time, every shape.
    numbers, off = [number_of_effect(p) for p in own], start_off(fitted, unknowns)
    seen, bench = fitted.problem.observations, fitted.parameters
    longest = max(float(np.ptp(obs.grid)) for obs in seen)
    volts = max(float(np.max(obs.voltage)) for obs in seen)
    amperes = volts * bench["wire.count"] / bench["wire.resistance"]
    known = dict(_TRIED["shapes"])
    for key, whole in (("of_duration", longest), ("of_current", amperes)):
        known |= {name: [whole * share for share in own] for name, own in _TRIED[key].items()}
    shapes = [[off[first + k]] if first + k in switches
              else [number.x_of(value) for value in known.get(number.name, (number.mean,))]
              for k, number in enumerate(numbers)]
    trials, sizes = [], _TRIED["sizes_of_forms" if unknowns.forms[-1] else "sizes"]
    for k in switches:
        signs = (1.0, -1.0) if numbers[k - first].low < 0.0 else (1.0,)
        for shape, size, sign in product(product(*shapes), sizes, signs):
            x = np.concatenate([fitted.x, shape])
            x[k] += sign * size
            trials.append(np.clip(x, *bounds))

    gains, shares = gains_of([unknowns.parameters(x) for x in trials])
    best = int(np.argmax(gains))
    if gains[best] <= 0.0:
        return Start(off, 0.0)
    there = trials[best].copy()
    there[switches] = off[switches] + shares[best] * (trials[best] - off)[switches]
    return Start(np.clip(there, *bounds), float(gains[best]))


def start_off(fitted: Fit, unknowns: Unknowns) -> Array:
    """Where a fit without the last effect ended, that one off, or what kinetics have of it."""
    items = unknowns.items[len(fitted.x) :]
    off = [item.x_of(fitted.parameters[item.name]) for item in items]
    return np.clip(np.concatenate([fitted.x, off]), *unknowns.bounds())

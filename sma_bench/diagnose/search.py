"""Candidates: recalibration alone, every effect with it, and pairs around the best ones."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sma_bench.arrays import Array
from sma_bench.border import read_yaml
from sma_bench.compiled import in_threads
from sma_bench.diagnose import left_over
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
from sma_bench.physics.effects.temperature_underfill import ACROSS

_CLOSE = 0.35  # of the best gain in evidence: singles that gain at most so much less are refined
_NEAR = 15.0  # nats, the same; the larger limit counts
_MOST_REFINED = 4  # singles
_MOST_FROM_STATED = 5  # singles that are fitted from the stated parameters as well
_MOST_PAIRED, _PARTNERS = 3, 3  # singles that get partners, and how many each
_HOPELESS = 0.5  # of the best single's gain: a single that gains less gets no partners
_STANDS_STILL = 0.05  # of the measured motion: a simulated one that is smaller is none
_DRAWN, _STARTED = 60, 2  # benches drawn if the stated one does not move, and starts among them
_LOST = 5.0  # nats below recalibration, where the fit has probably failed and is repeated
_FIRST = 2  # most promising effects, fitted before the others
_MOST_FORMS = 4  # that are fitted in addition to the usual ones
_PROMISES = 10.0  # factor by which a fit may gain more than its start promises
_BEYOND = 30.0  # nats: effects that even so would gain so much less than the best are not fitted
_WORTH_A_FORM = 2.0  # nats that its start must promise
_STUCK = 5.0  # nats of a better start that show that recalibration had not converged
_MOST_PASSES, _MOVING = 4, 1.0  # passes of a refinement; nats of change that need another
_SURPRISING = 2.5  # prior deviations of a recalibrated parameter
_WORTH_PAIRING = 8.0  # nats that a single must gain
# The numbers that an effect adds to 1/C, and C: a fit can end with the change divided among both.
_MOVED = 0.3  # prior deviations by which reassigning it must change the fit to repeat it
_INSTEAD = {"stress_dependent_transition": {
    f"effect.stress_dependent_transition.{phase}": f"wire.stress_influence_{phase}"
    for phase in ("austenite", "martensite")}}

_TRIED = read_yaml(Path(__file__).with_name("starts.yaml"))
_STRETCH = (0.3, 2.0)  # factors of a tried size within which linearisation is trusted

Progress = Callable[[str], None]


class Start(NamedTuple):
    """Where a fit starts, and the gain in log posterior that a linearisation there promises."""

    x: Array
    gain: float


@dataclass(frozen=True, eq=False)
class Search:
    """Every candidate, fitted to all records."""

    problem: Problem
    nominal: Fit  # the parameters as stated, only the sensors' noise and zeros fitted
    recalibrated: Fit  # the same model, parameters moved under their priors
    singles: dict[str, Fit]  # by effect
    pairs: dict[tuple[str, str], Fit]  # by two effects, those that were worth a fit
    best: Fit  # of all these, the one with the largest evidence
    flexible: left_over.SmoothResponse  # for the residual of recalibration
    beyond: left_over.SmoothResponse  # for the residual of the best candidate
    left: left_over.ResidualTest  # whether recalibration's residual depends on what the bench does
    left_by_best: left_over.ResidualTest  # the same of the best
    # a smooth input to each stage that explains the residual, the best stage first
    inputs: dict[str, left_over.SmoothResponse]
    inputs_by_best: dict[str, left_over.SmoothResponse]

    @cached_property
    def curve(self) -> float:
        """Nats that recalibration gains with a bent curve of the motion's sensor."""
        return left_over.sensor_curve(self.recalibrated)

    def gain(self, name: str) -> float:
        """Evidence of an effect over recalibration [nats]."""
        if name == LAW_EFFECT:  # part of recalibration too
            return 0.0
        return self.singles[name].evidence - self.recalibrated.evidence

    @property
    def ranked(self) -> list[str]:
        return sorted(self.singles, key=self.gain, reverse=True)


def search(observations: Sequence[Observation], parameters: Parameters,
           progress: Progress = lambda text: None, doubted: Collection[str] = ()) -> Search:
    """Fit all candidates to all records, including those held out (the shrinkage has fits without
    them). `doubted`: quantities with doubtful readings, which exclude effects."""
    quantities = tuple(dict.fromkeys(q for obs in observations for q in obs.quantities))
    baseline = unknowns_of_records(parameters, quantities, other_laws=True)
    progress("recalibration")
    fresh = Problem.of(observations, later=1.0)
    tries, here = starts(baseline, 0), fresh.predict(parameters)
    # If the stated bench does not move, derivatives show no motion, and the measured one would
    # pass for drift: start also from benches within the priors that move as the records do.
    if any(np.ptp(here[b.rows]) <= _STANDS_STILL * np.ptp(b.signal.value)
           for b in fresh.blocks if b.signal.quantity in MOVED):
        tries += nearest_starts(fresh, baseline, _DRAWN)[:_STARTED]
    recalibrated, _ = recalibrate(fresh, parameters, baseline, tries)
    where = recalibrated.problem
    problem = replace(fresh, observations=where.observations, nuisances=where.nuisances)
    # As stated: every parameter exact.
    nominal = fit(problem, unknowns_of(parameters, (), shapes={}), np.zeros(0), rounds=2)
    excluded = excluded_effects(doubted)
    names = [n for n in possible_effects(parameters, quantities) if n not in excluded]
    kinds = [baseline.with_effects([n], {n: f}) for n in names for f in _forms(n, observations)]
    singles = _singles(kinds, recalibrated, progress)

    def keep(fits: Iterable[Fit]) -> None:
        for found in fits:
            (name,) = found.unknowns.effects
            singles[name] = max(singles[name], found, key=by_evidence)

    recalibrated, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("effects again, as recalibration was stuck")
        singles = _singles(kinds, recalibrated, progress)
    replaced = list[tuple[Fit]]()
    if singles and _surprises(recalibrated):
        # A fit may not find its way back to the stated parameters: start the best effects there.
        progress("effects from the stated parameters")
        away, alike = problem.of_kind(STATE), problem
        if away.any():
            alike = problem.about(parameters, np.where(away, 0.0, recalibrated.z))
        read = replace(alike, noise=recalibrated.problem.noise)
        begun = _starts(kinds, fit(read, baseline, baseline.start(), rounds=0))
        # So far away promises mean little: the best effect so far comes first, in all its forms.
        (first,) = max(singles.values(), key=by_evidence).unknowns.effects
        begun = sorted(begun, key=lambda both: both[0].effects[0] != first)[:_MOST_FROM_STATED]
        earlier = singles[first]
        keep(in_threads(lambda kind, start: fit(alike, kind, start.x, far=True), begun))
        replaced = [(earlier,)] if singles[first] is not earlier else []  # refined, it may be best

    progress("refining the best effects")
    ranked = sorted(singles.values(), key=by_evidence, reverse=True)
    gains = [found.evidence - recalibrated.evidence for found in ranked] or [0.0]
    limit = gains[0] - max(_NEAR, _CLOSE * gains[0])
    worth = [(found,) for found, gain in zip(ranked[:_MOST_REFINED], gains, strict=False)
             if gain >= limit]
    instead = [_due_to_effect(found) for name, found in singles.items() if name in _INSTEAD]
    keep([*in_threads(_refined, worth + replaced), *instead])
    recalibrated, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("effects again, as recalibration was stuck")
        keep(_singles(kinds, recalibrated, progress).values())
    progress("pairs of effects")
    pairs = _pairs(baseline, singles, recalibrated)

    best = max([recalibrated, *singles.values(), *pairs.values()], key=by_evidence)
    progress("residuals")
    fits = list(dict.fromkeys([recalibrated, best]))
    looks = left_over.free_response, left_over.residual_test, left_over.process_noise
    done = in_threads(lambda look, fitted: look(fitted), [(k, f) for k in looks for f in fits])
    # Each look at recalibration, and at the best, which may be the same fit.
    both = [done[n] for k in range(len(looks)) for n in (k * len(fits), (k + 1) * len(fits) - 1)]
    return Search(problem, nominal, recalibrated, singles, pairs, best, *both)


def excluded_effects(doubted: Collection[str]) -> list[str]:
    """Effects that a doubtful signal may imitate: its sensor's; all if voltage or current."""
    everything = bool({"voltage", "current"} & set(doubted))
    return [name for name, effect in EFFECTS.items()
            if everything or (effect.stage == "sensor" and set(effect.acts_on) & set(doubted))]


def possible_effects(parameters: Parameters, quantities: Sequence[str]) -> list[str]:
    """Effects that this load and law can have and these signals show, and that are not stated."""
    stated, load, law = stated_effects(parameters), load_kind(parameters), parameters["wire.law"]
    known = {e.name for e in EFFECTS.values() if any(p.name in stated for p in e.parameters)}
    # With imposed motion the force shows the effects that otherwise show in the deflection.
    quantities = [*quantities, *(["deflection"] if "force" in quantities else [])]
    known |= {"slack"} if any(is_stated(parameters, n) for n in IF_STATED) else set()  # excluded
    known.add(LAW_EFFECT)  # in every candidate
    return [name for name, effect in EFFECTS.items()
            if name not in known and load in effect.loads and law in effect.laws
            and set(effect.acts_on) & set(quantities)]


def _forms(name: str, observations: Sequence[Observation]) -> list[str]:
    """Forms of an effect, the usual one ("") first; CARRIED_OVER needs a record after another,
    ACROSS wires on two sides."""
    possible = {CARRIED_OVER: any(one.before is not None for one in observations),
                ACROSS: len({*observations[0].sides}) > 1}
    return ["", *(form for form in list(EFFECTS[name].forms or ())[1:] if possible.get(form, True))]


def _surprises(fitted: Fit) -> bool:
    """True if a parameter, or the state of a run (STATES), moved beyond _SURPRISING."""
    far = np.abs([*fitted.x[: fitted.unknowns.bench], *fitted.z[fitted.problem.of_kind(STATE)]])
    return bool(np.max(far, initial=0.0) > _SURPRISING)


def _starts(kinds: Sequence[Unknowns], fitted: Fit) -> list[tuple[Unknowns, Start]]:
    """Starts of every effect and form added to a fit, the most promising first."""
    gains_of = remainder(fitted)
    begun = in_threads(find_start, [(fitted, gains_of, kind) for kind in kinds])
    return sorted(zip(kinds, begun, strict=True), key=lambda both: -both[1].gain)


def _singles(kinds: Sequence[Unknowns], recalibrated: Fit, progress: Progress) -> dict[str, Fit]:
    """Every effect, fitted from recalibration: the most promising first, which may show that others
    are hopeless. Of the forms other than the usual one, the most promising few are fitted."""
    if not kinds:
        return {}
    progress(kinds[0].effects[0])
    begun = _starts(kinds, recalibrated)

    def fit_from(kind: Unknowns, x: Array, rounds: int = 2, predicted: Array | None = None) -> Fit:
        return fit(recalibrated.problem, kind, x, rounds=rounds, frozen=recalibrated.derivatives,
                   predicted=predicted)

    def off(kind: Unknowns) -> Fit:
        x = np.pad(recalibrated.x, (0, len(kind.items) - len(recalibrated.x)))
        return fit_from(kind, x, 0, recalibrated.predicted)

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
    # If parameters moved too far, promises by linearisation are not trusted.
    beyond = _BEYOND if not _surprises(recalibrated) else np.inf
    found = in_threads(single, worth[:_FIRST])
    least = max(f.evidence - recalibrated.evidence for f in found) - beyond
    others = [(*both, _PROMISES * both[1].gain >= least) for both in worth[_FIRST:]]
    found += in_threads(lambda kind, start, hope: single(kind, start) if hope else off(kind),
                        [one for one in others if one[2] or not one[0].forms[0]])
    fits: dict[str, Fit] = {}
    for one in found:
        (name,) = one.unknowns.effects
        # Of forms with equal evidence the usual one is taken.
        fits[name] = max(fits.get(name, one), one,
                         key=lambda f: (round(f.evidence, 1), not f.unknowns.forms[0]))
    return {name: fits[name] for name in dict.fromkeys(k.effects[0] for k in kinds)}


def _again(baseline: Unknowns, recalibrated: Fit, singles: dict[str, Fit]) -> tuple[Fit, bool]:
    """Recalibration started from the parameters of the best single, if that is better, and refined;
    True if it is so much better that the singles must be fitted again from there."""
    if not singles:
        return recalibrated, False
    best = max(singles.values(), key=by_evidence)
    better = fit(recalibrated.problem, baseline, best.x[: baseline.baseline], far=True)
    if better.evidence <= recalibrated.evidence:
        return recalibrated, False
    if _nonlinear(better):
        better = max(better, _refined(better), key=by_evidence)
    return better, better.evidence - recalibrated.evidence > _STUCK


def _nonlinear(fitted: Fit) -> bool:
    return bool((fitted.problem.of_kind(STATE) | fitted.problem.of_kind(TICK)).any())


def _refined(found: Fit) -> Fit:
    """The same model fitted again with nuisances linearised about itself, not about recalibration;
    repeated until it changes nothing if states of runs or jumps of a slow logger are among them."""
    nonlinear = _nonlinear(found)
    for _ in range(_MOST_PASSES if nonlinear else 1):
        problem, gone = found.problem.about(found.parameters, found.z), found.evidence
        known = None if nonlinear else found.predicted
        found = fit(problem, found.unknowns, found.x, rounds=2, predicted=known)
        if abs(found.evidence - gone) < _MOVING:
            break
    return found


def _due_to_effect(found: Fit) -> Fit:
    """A fit from the same shifts by stress, due to the effect alone, with C as stated."""
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
    """The best singles with their most promising partners; the best pair is refined."""
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


# --- Starts of the fit of an effect: sizes tried against the residual of another fit, as finite
# changes: derivatives at zero vanish for numbers that act only together with another.

Gains = Callable[[Sequence[Parameters]], tuple[Array, Array]]


def remainder(fitted: Fit) -> Gains:
    """A function of p benches: the gains (p,) of adding a multiple of the change that each makes,
    and these multiples (p,), for the part of a residual that the fit itself cannot take up."""
    problem = fitted.problem
    rows = np.hstack([problem.whiten(fitted.derivatives), problem.white_nuisances])
    normal = cho_factor(rows.T @ rows + np.eye(rows.shape[1]))
    residual = problem.whiten(problem.measured - fitted.predicted)
    # Parameters moved against their priors count, too: an effect may bring them back.
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
    """Best of the tried sizes of the last effect, added to a fit with these gains."""
    bounds, effect = unknowns.bounds(), EFFECTS[unknowns.effects[-1]]
    own = effect.numbers(unknowns.forms[-1])
    first = len(unknowns.names) - len(own)
    switches = [first + k for k, p in enumerate(own) if p in effect.switches]
    # One switch at a time, every shape.
    numbers, off = [number_of_effect(p) for p in own], np.pad(fitted.x, (0, len(own)))
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

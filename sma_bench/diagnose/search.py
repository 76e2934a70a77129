"""Candidates: recalibration alone, every effect with it, and pairs around the best ones."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.flexible import Flexible, flexible_residual
from sma_bench.diagnose.left_over import Left, left_over
from sma_bench.diagnose.starts import Remainder, find_start, start_off
from sma_bench.diagnose.tails import gain_of_tails, with_tails
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.side_by_side import in_threads
from sma_bench.estimation.solver import Fit, fit, recalibrate
from sma_bench.estimation.unknowns import (
    Unknowns,
    stated_effects,
    unknowns_of,
    unknowns_of_records,
)
from sma_bench.parameters import Parameters
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.effects import EFFECTS

Array = NDArray[np.float64]

_CLOSE = 0.35  # of the best gain in evidence: what lies this near is fitted carefully
_NEAR = 15.0  # nats
_MOST_REFINED = 4
_MOST_FROM_BELIEF = 3
_MOST_PAIRED, _PARTNERS = 3, 3
_HOPELESS = 0.5  # of the best single's gain: with a partner, less than that is no rival of it
_SPREADS = (0.3, 3.0)  # prior deviations: sharp kinetics can trap a fit that smooth ones let go
_LOST = 5.0  # nats below recalibration: the fit may have gone astray
_FIRST = 2  # effects, the most promising
# What a start promises is off by factors of three; where the lead is beyond ten promises and this
# many nats more, an effect gets no fit.
_PROMISES, _BEYOND = 10.0, 30.0
_STUCK = 5.0  # nats that show a fit had not arrived
_SURPRISING = 2.5  # prior deviations of a recalibrated parameter
_WORTH_PAIRING = 8.0  # nats of a single
# What an effect adds to 1/C beside C itself: its fit can stay on the way from one to the other.
_MOVED = 0.3  # prior deviations that are worth another fit
_INSTEAD = {
    "stress_dependent_transition": {
        f"effect.stress_dependent_transition.{phase}": f"wire.stress_influence_{phase}"
        for phase in ("austenite", "martensite")
    }
}

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Search:
    """Every candidate, fitted to all records.

    Attributes:
        nominal: the parameters as believed, only the sensors' noise and zeros fitted.
        recalibrated: the same model, parameters moved under their priors.
        singles: by effect; pairs: by two effects, those that were worth a fit.
        best: of all these, the one with the largest evidence.
        flexible: of what recalibration leaves; beyond: of what the best candidate leaves.
        left, left_by_best: whether that still depends on what the bench does.
        off: parameters that recalibration needs farther off than was stated.
    """

    problem: Problem
    nominal: Fit
    recalibrated: Fit
    singles: dict[str, Fit]
    pairs: dict[tuple[str, str], Fit]
    best: Fit
    flexible: Flexible
    beyond: Flexible
    left: Left
    left_by_best: Left
    off: tuple[str, ...] = ()

    def gain(self, name: str) -> float:
        """Evidence of an effect over recalibration [nats]."""
        return self.singles[name].evidence - self.recalibrated.evidence

    @property
    def ranked(self) -> list[str]:
        """Effects, the most probable first."""
        return sorted(self.singles, key=self.gain, reverse=True)


def search(
    observations: Sequence[Observation], parameters: Parameters,
    progress: Progress = lambda text: None, doubted: Collection[str] = (),
) -> Search:
    """Fit everything.

    Args:
        observations: of all records, those held out as well (their shares are told apart later).
        parameters: as believed, with uncertainties.
        doubted: quantities whose readings are under suspicion; effects of their sensors, or all
            effects where the drive's are, are held back.
    """
    quantities = tuple(dict.fromkeys(q for obs in observations for q in obs.quantities))
    baseline = unknowns_of_records(parameters, quantities)
    progress("recalibration")
    fresh = Problem.of(observations)
    starts = [baseline.start(spread) for spread in _SPREADS]
    recalibrated, _ = recalibrate(fresh, parameters, baseline, starts)
    problem = replace(fresh, nuisances=recalibrated.problem.nuisances)
    # As believed: every parameter exact.
    nominal = fit(problem, unknowns_of(parameters, (), shapes={}), np.zeros(0), rounds=2)
    held = held_back(doubted)
    possible = [name for name in _possible(parameters, quantities) if name not in held]
    singles = _singles(baseline, recalibrated, possible, progress)
    recalibrated, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("recalibration was stuck: once more")
        singles = _singles(baseline, recalibrated, possible, progress)
    if np.max(np.abs(recalibrated.x[: baseline.bench])) > _SURPRISING:
        progress("effects instead of surprising parameters")
        for name, found in _from_belief(problem, baseline, recalibrated, list(singles)).items():
            singles[name] = max(singles[name], found, key=lambda f: f.evidence)
    progress("the best again, carefully")
    worth = [(singles[name],) for name in _worth_refining(singles, recalibrated)]
    again = in_threads(_refined, worth)
    again += [_handed_over(found) for name, found in singles.items() if name in _INSTEAD]
    for found in again:
        (name,) = found.unknowns.effects
        singles[name] = max(singles[name], found, key=lambda f: f.evidence)
    better, stuck = _again(baseline, recalibrated, singles)
    if stuck:
        progress("recalibration was stuck: once more")
        for name, found in _singles(baseline, better, possible, progress).items():
            singles[name] = max(singles[name], found, key=lambda f: f.evidence)
    recalibrated = better
    progress("pairs")
    pairs = _pairs(baseline, singles, recalibrated)
    progress("parameters that may be far off")
    narrow = recalibrated.evidence
    recalibrated, off = with_tails(recalibrated)
    most = recalibrated.evidence - narrow
    singles = {name: _tailed(found, most) for name, found in singles.items()}
    pairs = {names: _tailed(found, most) for names, found in pairs.items()}
    best = max([recalibrated, *singles.values(), *pairs.values()], key=lambda f: f.evidence)
    progress("what is left")
    fits = list(dict.fromkeys([recalibrated, best]))
    works = [(work, fitted) for work in (flexible_residual, left_over) for fitted in fits]
    done = in_threads(lambda work, fitted: work(fitted), works)
    flexible, left = done[: len(fits)], done[len(fits) :]
    return Search(
        problem, nominal, recalibrated, singles, pairs, best, flexible[0], flexible[-1],
        left[0], left[-1], off,
    )


def _tailed(found: Fit, most: float) -> Fit:
    """With the evidence that tails add to it: `most` that recalibration has gained by them."""
    return replace(found, evidence=found.evidence + min(gain_of_tails(found)[0], most))


def _singles(
    baseline: Unknowns, recalibrated: Fit, names: Sequence[str], progress: Progress
) -> dict[str, Fit]:
    """Every effect, begun where recalibration ended: the most promising first, beside which others
    may be hopeless."""
    remainder = Remainder(recalibrated)
    models = {name: baseline.with_effects([name]) for name in names}

    def off(name: str) -> Fit:
        x = start_off(recalibrated, models[name], name)
        return _fit_from(recalibrated, models[name], x, rounds=0)

    def single(name: str) -> Fit:
        progress(name)
        found = _fit_from(recalibrated, models[name], starts[name].x)
        if found.evidence >= recalibrated.evidence - _LOST:
            return found
        without = off(name)
        if found.evidence >= without.evidence:
            return found
        again = _fit_from(recalibrated, models[name], without.x)
        return max(found, without, again, key=lambda f: f.evidence)

    if not names:
        return {}
    progress(names[0])
    found = in_threads(
        lambda name: find_start(remainder, models[name], name), [(name,) for name in names]
    )
    starts = dict(zip(names, found, strict=True))
    ranked = sorted(names, key=lambda name: starts[name].gain, reverse=True)
    first = ranked[:_FIRST]
    begun = in_threads(single, [(name,) for name in first])
    fits = dict(zip(first, begun, strict=True))
    lead = max((f.evidence - recalibrated.evidence for f in fits.values()), default=0.0)
    hopeless = {n for n in ranked[_FIRST:] if _PROMISES * starts[n].gain < lead - _BEYOND}
    others = ranked[_FIRST:]
    rest = in_threads(
        lambda name: (off if name in hopeless else single)(name), [(name,) for name in others]
    )
    fits |= zip(others, rest, strict=True)
    return {name: fits[name] for name in names}


def _fit_from(recalibrated: Fit, unknowns: Unknowns, x: Array, rounds: int = 2) -> Fit:
    return fit(recalibrated.problem, unknowns, x, rounds=rounds, frozen=recalibrated.derivatives)


def _again(baseline: Unknowns, recalibrated: Fit, singles: dict[str, Fit]) -> tuple[Fit, bool]:
    """Recalibration from where the best effect has taken the parameters, if that is better; and
    whether it is so much better that effects are to be looked for from there."""
    if not singles:
        return recalibrated, False
    best = max(singles.values(), key=lambda f: f.evidence)
    better = fit(recalibrated.problem, baseline, best.x[: baseline.baseline], far=True)
    gained = better.evidence - recalibrated.evidence
    return (better if gained > 0.0 else recalibrated), gained > _STUCK


def _from_belief(
    problem: Problem, baseline: Unknowns, recalibrated: Fit, names: Sequence[str]
) -> dict[str, Fit]:
    """The most promising effects, fitted from the parameters as believed: from surprising ones the
    way back to them can be long and winding."""
    believed = fit(recalibrated.problem, baseline, baseline.start(), rounds=0)
    remainder = Remainder(believed)
    starts = in_threads(
        lambda name: find_start(remainder, baseline.with_effects([name]), name),
        [(name,) for name in names],
    )
    ranked = sorted(zip(names, starts, strict=True), key=lambda s: s[1].gain, reverse=True)
    best = ranked[:_MOST_FROM_BELIEF]
    fits = in_threads(
        lambda name, start: fit(problem, baseline.with_effects([name]), start.x, far=True), best
    )
    return {name: found for (name, _), found in zip(best, fits, strict=True)}


def held_back(doubted: Collection[str]) -> list[str]:
    """Effects that a doubted signal may feign: those of its sensor, and all where the voltage or
    the current itself is doubted."""
    everything = bool({"voltage", "current"} & set(doubted))
    return [
        name for name, effect in EFFECTS.items()
        if everything or (effect.stage == "sensor" and set(effect.acts_on) & set(doubted))
    ]


def _possible(parameters: Parameters, quantities: Sequence[str]) -> list[str]:
    """Effects that this load can have, that show in these signals and are not believed in yet."""
    stated, load = stated_effects(parameters), load_kind(parameters)
    known = {e.name for e in EFFECTS.values() if any(p.name in stated for p in e.parameters)}
    return [
        name for name, effect in EFFECTS.items()
        if name not in known and load in effect.loads and set(effect.acts_on) & set(quantities)
    ]


def _worth_refining(singles: dict[str, Fit], recalibrated: Fit) -> list[str]:
    gains = {name: f.evidence - recalibrated.evidence for name, f in singles.items()}
    ranked = sorted(gains, key=lambda name: gains[name], reverse=True)
    best = gains[ranked[0]] if ranked else 0.0
    limit = best - max(_NEAR, _CLOSE * best)
    return [name for name in ranked[:_MOST_REFINED] if gains[name] >= limit]


def _refined(found: Fit) -> Fit:
    """The same model once more, with what its own jumps and delays do, not recalibration's."""
    problem = found.problem.with_nuisances(found.parameters)
    return fit(problem, found.unknowns, found.x, rounds=2)


def _handed_over(found: Fit) -> Fit:
    """The same sum of both, all of it the effect's: the parameters as believed."""
    (effect,) = found.unknowns.effects
    names, items, x = found.unknowns.names, found.unknowns.items, found.x.copy()
    for number, parameter in _INSTEAD[effect].items():
        if parameter not in names:
            continue
        k, c = names.index(number), names.index(parameter)
        added = 1.0 / items[c].value(x[c]) - 1.0 / items[c].value(0.0)
        x[k] = items[k].x_of(items[k].value(x[k]) + added)
        x[c] = 0.0
    if np.max(np.abs(x - found.x)) < _MOVED:
        return found
    return fit(found.problem, found.unknowns, x, rounds=2)


def _pairs(
    baseline: Unknowns, singles: dict[str, Fit], recalibrated: Fit
) -> dict[tuple[str, str], Fit]:
    """The best singles, each with the partners that promise most; the best pair again with its own
    nuisances, as the best singles."""
    ranked = sorted(singles, key=lambda name: singles[name].evidence, reverse=True)
    gains = {name: singles[name].evidence - recalibrated.evidence for name in ranked}
    pairs: dict[tuple[str, str], Fit] = {}

    def keep(found: Fit) -> None:
        one, other = sorted(found.unknowns.effects)
        if (one, other) not in pairs or found.evidence > pairs[one, other].evidence:
            pairs[one, other] = found

    for name in ranked[:_MOST_PAIRED]:
        if gains[name] < max(_WORTH_PAIRING, _HOPELESS * gains[ranked[0]]):
            break
        for found in _pairs_with(name, baseline, singles):
            keep(found)
    if pairs:
        keep(_refined(max(pairs.values(), key=lambda f: f.evidence)))
    return pairs


def _pairs_with(name: str, baseline: Unknowns, singles: dict[str, Fit]) -> list[Fit]:
    """One effect with each of the partners that promise most beside it."""
    remainder = Remainder(singles[name])
    frozen = singles[name].derivatives[:, : baseline.baseline]

    def promise(partner: str) -> float:
        unknowns = baseline.with_effects([name, partner])
        return find_start(remainder, unknowns, partner, quick=True).gain

    def pair(partner: str) -> Fit:
        unknowns = baseline.with_effects([name, partner])
        start = find_start(remainder, unknowns, partner)
        return fit(singles[name].problem, unknowns, start.x, rounds=2, frozen=frozen)

    partners = [partner for partner in singles if partner != name]
    promises = in_threads(promise, [(partner,) for partner in partners])
    order = np.argsort(promises, kind="stable")[::-1][:_PARTNERS]
    return in_threads(pair, [(partners[k],) for k in order])

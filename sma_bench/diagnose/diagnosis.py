"""The whole diagnosis: is there a gap, where, which cause, how far it shrinks, what to do next."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc

from sma_bench.diagnose import decision
from sma_bench.diagnose.decision import Candidate, Utilities, learnt
from sma_bench.diagnose.left_over import missed
from sma_bench.diagnose.next_experiment import next_experiment
from sma_bench.diagnose.result import (
    NO_GAP,
    RECALIBRATION,
    UNEXPLAINED,
    DiagnosisResult,
    Difference,
    Drift,
    LeftOver,
    Moved,
    Verdict,
    Where,
)
from sma_bench.diagnose.search import Progress, Search, excluded_effects, search
from sma_bench.diagnose.sizes import contribution, decision_inputs, locate, sensors_noise, shrinkage
from sma_bench.drawn import Reported
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES, Observation, observe_all
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit
from sma_bench.estimation.unknowns import HEAT, SHAPES, TEMPERATURES, Unknowns
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters
from sma_bench.parameters.audit import audit
from sma_bench.parameters.parameter import BY_NAME
from sma_bench.parameters.parameters import load_kind
from sma_bench.physics.effects import EFFECTS
from sma_bench.physics.effects.residual_strain import FRESH_START
from sma_bench.records.mend import prepare
from sma_bench.records.record import Record, require_distinct, with_stated_lag

SURPRISING = 2.0  # prior deviations from which a parameter is reported as moved
_FIT_SHARE = 0.6  # of each record that is fitted if none is held out
_STAGES = {
    "wire.resistance": "electrical",
    **dict.fromkeys(HEAT[1:], "thermal"),
    **dict.fromkeys((*TEMPERATURES, "wire.stress_influence_austenite",
                     "wire.stress_influence_martensite"), "transformation")}
# Limits beyond which a residual is not noise:
_FREE_FORM = 30.0  # nats that a smooth response gains
_IN_MOTION = 5.5  # standard deviations by which it scatters more in motion than at rest
_EVENT = 8.0  # standard deviations of a single sample
_CLEARLY_MORE, _VISIBLE = 2.0, 5.0  # times the drift with the best model; times the white noise
_CHANCE = 0.05  # probability that the parameters of some stage move this far by chance


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(DiagnosisResult, Reported):
    """The result with the fits behind it; `to_json` follows the contract."""

    writer = ("reports", "write_diagnosis_report")

    candidates: tuple[Candidate, ...]  # with their fits
    parameters: Parameters  # as stated
    search: Search  # all fits
    model: Fit  # the fit with the improved parameters
    improved: Parameters
    observations: tuple[Observation, ...]  # all records
    fitted: tuple[Observation, ...]  # records, or parts, in the fit for the shrinkage
    held_out: tuple[Observation, ...]  # those not in it


def diagnose(records: Sequence[Record], parameters: Parameters, hold_out: Sequence[Record] = (),
             progress: Progress = lambda text: None,
             quantities: Sequence[str] = QUANTITIES) -> Diagnosis:
    """Diagnose the gap between a bench's records and its model, with the parameters as stated and
    their `uncertainty.` as priors. Candidates are compared on all records together; shrinkage is
    measured on the held-out ones (the last part of every record if none is held out), with a model
    fitted without them. `progress` is called with the name of each step. Raises InputError: no
    records, one that cannot be compared, or one both fitted and held out."""
    if not records:
        raise InputError("diagnose: no record, expected at least one")
    require_distinct(records, hold_out)
    # Clocks are repaired; doubtful signals are reported and exclude effects.
    progress("records")
    ready = prepare((*records, *hold_out), parameters, quantities)
    parameters, lines = with_stated_lag(parameters), ready.remarks
    if out := excluded_effects(ready.doubted):
        named = ", ".join(out[:3]) + ", ..." * (len(out) > 3)
        lines.append(f"excluded because of doubtful readings: {len(out)} effects, {named}")
    # The verdict, and the most probable model that can be simulated.
    observed = observe_all(ready.records, parameters, quantities)
    found = search(observed, parameters, progress, ready.doubted)
    utilities = Utilities(decision_inputs(found))
    decided = decision.decide(found, utilities)
    candidates = decision.with_law(decided)
    verdict = decision.verdict_of(candidates)
    cause = decision.named(candidates, utilities) if verdict == "effect" else ()
    model = next(c.fit for c in candidates if c.fit is not None and set(cause) <= set(c.effects))
    recalibrated, no_gap = found.recalibrated, verdict == NO_GAP
    # Parameters of the model with their new uncertainties, on top of the stated ones.
    values, stds = model.parameters, dict(zip(model.unknowns.names, model.errors, strict=True))
    stds |= {twin: stds[name] for twin, name in model.unknowns.tied.items()}
    names = [n for n in stds if n not in SHAPES or values[n] != BY_NAME[n].default]
    improved = parameters if no_gap else parameters.replace(
        {name: values[name] for name in names},
        {name: float(stds[name]) for name in names if stds[name] > 0.0})

    progress("shrinkage on held-out data")
    errors = np.sqrt(np.diag(model.joint))[len(model.x) :]
    observations = model.problem.in_states(model.z, errors)
    lines += [text for one in observations for text in one.remarks]
    seen, unseen = observations[: len(records)], observations[len(records) :]
    fitted, unfitted = (seen, unseen) if unseen else _split(seen)
    moved = _fitted_to(fitted, recalibrated)
    blind = moved if model is recalibrated else _fitted_to(fitted, model)
    shrinks = shrinkage(
        unfitted, parameters, moved.parameters, parameters if no_gap else blind.parameters,
        sensors_noise(model, [recalibrated, *found.singles.values(), *found.pairs.values()]))
    # If the bench's limits refuse all proposals, the diagnosis is still returned.
    following, remarks = None, []
    if not no_gap and decision.verdict_of(decided) != UNEXPLAINED:
        progress("the next experiment")
        try:
            following = next_experiment(decided, found, utilities, observations, parameters)
            if following:  # names of causes after `with_law`
                renamed = {c.name: new.name for c, new in zip(decided, candidates, strict=False)}
                causes = tuple(renamed[name] for name in following.separates)
                following = replace(following, separates=causes)
            if verdict == "ambiguous" and not (following and following.settles):
                text = "no experiment possible on this bench settles the tie"
                if following:
                    text += f": the best names the cause with {following.chance:.0%} probability"
                remarks = [Finding("info", "next experiment", text)]
        except InputError as error:
            remarks = [Finding("warning", "next experiment", f"none is proposed: {error}")]
    if (rival := utilities.found.curve) > max([_FREE_FORM, *utilities.gains]):
        what = ("a sensor of the motion that is not linear: compare it with gauge blocks"
                if rival == found.curve else "a mount that gives: look at crimps and clamps")
        text = f"more than by any effect, the gap is explained by {what}"
        remarks.append(Finding("warning", "deflection", text))
    # Where the gap lies: contribution of effects, unexplained residual, or stated against fitted.
    stages = {} if no_gap else stages_of(candidates, found)
    stage, smooth_input = next(iter(found.inputs.items()))
    if verdict == UNEXPLAINED:
        missing = found.flexible if found.flexible.gain > _FREE_FORM else smooth_input
        unexplained = missing.response if missing.gain > 0.0 else recalibrated.residual
        cells = locate(model.problem, unexplained)
    elif acting := cause or model.unknowns.effects:
        cells = locate(model.problem, contribution(model, acting))
    else:
        cells = locate(model.problem, recalibrated.predicted - found.nominal.predicted)
    top = cells[0]
    measured = {quantity for obs in observations for quantity in obs.quantities}
    moves = load_kind(parameters) not in ("clamped", "displacement")
    return Diagnosis(
        verdict=verdict, cause=cause, candidates=candidates,
        where=Where(top.signal, top.phase, top.side, next(iter(stages), ""), stages, tuple(cells)),
        shrinkage=shrinks, least_credible=learnt().least,
        missed=missed(recalibrated, stage, smooth_input) if verdict == UNEXPLAINED else None,
        **_facts(verdict, candidates, found, model),
        not_compared=tuple(q for q in QUANTITIES
                           if q not in measured and (moves or q != "deflection")),
        record=tuple(dict.fromkeys(lines)),
        next_experiment=following if following and following.settles else None,
        findings=(*ready.response, *audit(parameters, papers_own=False),
                  *about_unstated(recalibrated.unknowns, parameters), *remarks),
        parameters=parameters, search=found, model=model, improved=improved,
        observations=tuple(observations), fitted=tuple(fitted), held_out=tuple(unfitted))


def _split(observations: Sequence[Observation]) -> tuple[list[Observation], list[Observation]]:
    parts: tuple[list[Observation], list[Observation]] = [], []
    for obs in observations:
        border = float(obs.grid[0] + _FIT_SHARE * (obs.grid[-1] - obs.grid[0]))
        if not obs.between(-np.inf, border).signals:  # the readings began late
            border = float(np.quantile(np.concatenate([s.time for s in obs.signals]), _FIT_SHARE))
        for some, ends in zip(parts, ((-np.inf, border), (border, np.inf)), strict=True):
            own = obs.between(*ends)
            some += [own] if own.signals else []
    if not all(parts):
        raise InputError("diagnose: too few readings to fit a model to some and try it on the rest")
    return parts


def _fitted_to(observations: Sequence[Observation], model: Fit) -> Fit:
    """The same model fitted to other records; FRESH_START, not the bench's, stays as it is."""
    problem = replace(Problem.of(observations, later=1.0), noise=model.problem.noise)
    problem = problem.with_nuisances(model.parameters)
    return fit(problem, *model.unknowns.holding(FRESH_START, model.x), rounds=1, keep_noise=True)


def stages_of(candidates: Sequence[Candidate], found: Search) -> dict[str, float]:
    """Probability of each stage of the model in which a gap may arise, the most probable first.

    An effect counts for its stage, a pair for that of the effect with the larger gain alone.
    Recalibration counts for the stage whose parameters moved further than by chance (chi squared),
    if any did. `unexplained` is divided among the stages at which a smooth unknown input gains,
    by gain; if none does, it counts as recalibration, else for the stage of the best effect."""
    # How likely a stage's parameters move so far: squared prior deviations are chi squared.
    moved = defaultdict[str, list[float]](list)
    names = found.recalibrated.unknowns.bench_names
    for name, x in zip(names, found.recalibrated.x.tolist(), strict=False):
        moved[_STAGES.get(name, "mechanical")].append(x)
    chances = {stage: float(chdtrc(len(xs), np.sum(np.square(xs)))) for stage, xs in moved.items()}
    least = min(chances, key=chances.__getitem__)
    beyond_prior = least if chances[least] * len(moved) < _CHANCE else ""
    shares = defaultdict[str, float](float)
    for candidate in candidates:
        share, stage = candidate.probability, ""
        if candidate.effects:
            stage = EFFECTS[max(candidate.effects, key=found.gain)].stage
        elif candidate.name == RECALIBRATION:
            stage = beyond_prior
        elif candidate.name == UNEXPLAINED:
            stage = beyond_prior or (EFFECTS[found.ranked[0]].stage if found.ranked else "")
            # Gains are weighted as those of effects.
            exponent = learnt().weights["effect.gain"][0]
            weights = {one: (1.0 + own.gain / 4.0) ** exponent
                       for one, own in found.inputs.items() if own.gain > 0.0}
            for one, weight in weights.items():
                shares[one] += share * weight / sum(weights.values())
            stage = "" if weights else stage
        if stage:
            shares[stage] += share
    return dict(sorted(shares.items(), key=lambda item: -item[1])) or {least: 0.0}


def about_unstated(unknowns: Unknowns, parameters: Parameters) -> list[Finding]:
    """A finding about the bench's unknowns that are not stated."""
    names = [n for item in unknowns.items[: unknowns.bench] for n in (item.name, item.partner)
             if n and n not in parameters.given and BY_NAME[n].spread is not None]
    text = (f"not stated: {', '.join(names)}: each may differ from its default as much as such "
            "wires and benches vary; identify it, or state a value")
    return [Finding("info", "parameters", text, {"unstated": float(len(names))})] if names else []


def _facts(verdict: Verdict, candidates: Sequence[Candidate], found: Search,
           model: Fit) -> dict[str, Any]:
    """Arguments for and against the verdict, as fields of the result."""
    # Parameters far from their stated values, the farthest first.
    unknowns = model.unknowns
    values, deviations = unknowns.values(model.x).tolist(), unknowns.deviations(model.x).tolist()
    numbers = zip(unknowns.items[: unknowns.bench], values, deviations, strict=False)
    moved = [Moved(item.name, value - item.mean, BY_NAME[item.name].unit, deviation)
             for item, value, deviation in numbers if abs(deviation) > SURPRISING]
    # Where the two most probable models differ most; one that adds to the first is no rival.
    models = [(c, c.fit) for c in candidates if c.fit is not None and c.name != NO_GAP]
    differ = None
    if len(models) > 1 and verdict not in (NO_GAP, UNEXPLAINED):
        (first, one), *others = models
        own = set(first.effects)
        rivals = [(c, fit) for c, fit in others if not (own and own <= set(c.effects))]
        rival, other = (rivals or others)[0]
        cell = locate(one.problem, one.predicted - other.predicted)[0]
        differ = Difference((first.name, rival.name), cell)
    # Slow drifts of sensors without an effect, if visible, and more than with one.
    drifts, best = [], _drifts(model)
    for name, rms in _drifts(found.recalibrated).items():
        visible = _VISIBLE * found.recalibrated.problem.noise[name].white
        if rms > visible and (not unknowns.effects or rms > _CLEARLY_MORE * best[name]):
            drifts.append(Drift(name, rms, best[name]))
    # The residual of the best model; ratio and outlier are 0 where they may be noise.
    left, gain, by = found.left, found.flexible.gain, RECALIBRATION
    if unknowns.effects:
        left, gain, by = found.left_by_best, found.beyond.gain, "the best model"
    ratio, outlier = (size if size > least else 0.0
                      for size, least in ((left.ratio, _IN_MOTION), (left.outlier, _EVENT)))
    return {"moved": tuple(sorted(moved, key=lambda one: -abs(one.deviations))),
            "difference": differ, "drifts": tuple(drifts),
            "left": LeftOver(by, gain, left.signal, ratio, outlier, gain > _FREE_FORM)}


def _drifts(fitted: Fit) -> dict[str, float]:
    """By signal, the most probable slow drift of the sensor in the residual (rms, of the worst
    record)."""
    found = defaultdict[str, float](float)
    for block in fitted.problem.blocks:
        drift = fitted.problem.noise[block.signal.name].drift_in(fitted.residual[block.rows])
        rms = float(np.sqrt(np.mean(drift**2)))
        found[block.signal.name] = max(found[block.signal.name], rms)
    return found

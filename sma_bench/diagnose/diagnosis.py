"""The whole argument: is there a gap, where, which cause, how far it shrinks, what to do next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sma_bench.diagnose.chain import break_chain
from sma_bench.diagnose.decision import NO_GAP, UNEXPLAINED, Decision, Weights, decide, weigh
from sma_bench.diagnose.facts import (
    difference,
    explanation,
    left_behind,
    moved_parameters,
    smoother_kinetics,
    unexplained_sign,
)
from sma_bench.diagnose.next_experiment import NextExperiment, next_experiment
from sma_bench.diagnose.result import DiagnosisResult, Where
from sma_bench.diagnose.search import Progress, Search, held_back, search
from sma_bench.diagnose.shrinkage import sensors_noise, shrinkage, unknown_share
from sma_bench.diagnose.sizes import Cell, contribution, locate
from sma_bench.diagnose.stages import missing_term, stages_of
from sma_bench.diagnose.tails import widened
from sma_bench.drawn import Reported
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES, Observation, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit
from sma_bench.estimation.unknowns import SHAPES, Unknowns
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters, audit
from sma_bench.parameters.parameters import load_kind
from sma_bench.parameters.table import BY_NAME
from sma_bench.records.check import check_response
from sma_bench.records.record import Record, fingerprint
from sma_bench.records.trust import mended, under_suspicion

Array = NDArray[np.float64]

_OF_ONE_KIND = 0.05  # of the held-out time in states that no fitted record has shown
_FIT_SHARE = 0.6  # of a single record without another to hold out


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(DiagnosisResult, Reported):
    """The result with the fits behind it; `to_json` is the contract's.

    Attributes:
        parameters: as believed; decision: candidates and verdict; search: all fits behind them.
        model: the fit that the improved parameters are of; improved: these parameters.
        observations: all records; fitted, held_out: those, or the parts of them, that the fit of
            the shrinkage has seen and has not.
    """

    writer = ("diagnosis_report", "write_diagnosis_report")

    parameters: Parameters
    decision: Decision
    search: Search
    model: Fit
    improved: Parameters
    observations: tuple[Observation, ...]
    fitted: tuple[Observation, ...]
    held_out: tuple[Observation, ...]


def diagnose(
    records: Sequence[Record], parameters: Parameters, hold_out: Sequence[Record] = (),
    progress: Progress = lambda text: None, quantities: Sequence[str] = QUANTITIES,
) -> Diagnosis:
    """Diagnose the gap between a bench's records and its model.

    Candidates are weighed on all records together; the shrinkage is measured on the held-out ones
    (on the last part of the records where none is held out), with a model that has not seen them.

    Args:
        records: bags of one bench; parameters: as believed, `uncertainty.` as priors.
        hold_out: further bags of the same bench.
        progress: called with what is being done.
        quantities: that are compared, of current, temperature and deflection.

    Raises:
        InputError: no records, one that cannot be compared with the model, or one that is both
            fitted and held out.
    """
    if not records:
        raise InputError("diagnose: no record, expected at least one")
    # A record that is fitted shows nothing of what a model predicts.
    paths = {fingerprint(record): record.path for record in records}
    for record in hold_out:
        path = paths.get(fingerprint(record))
        if path is not None:
            same = "is" if path == record.path else f"holds the samples of {path}, which is"
            raise InputError(
                f"{record.path}: {same} fitted too; a hold-out must be of a run that no fit sees"
            )
    progress("records")
    # What is known of the records: clocks are mended, signals under suspicion are named.
    whole = [mended(record) for record in (*records, *hold_out)]
    known = [(record, finding) for record, found in whole for finding in found]
    known += [(r, f) for r, _ in whole for f in r.findings if "repeated" in f.numbers]
    doubts = [
        (r, f) for r, _ in whole for f in under_suspicion(r)
        if f.subject.rpartition(".")[2] in ("voltage", "range", *quantities)
    ]
    lines = [f"{record.path.name}: {f.subject}: {f.text}" for record, f in (*known, *doubts)]
    doubted = {finding.subject.rpartition(".")[2] for _, finding in doubts}
    if held := held_back(doubted):
        lines.append(f"held back for that: {len(held)} effects, {', '.join(held[:3])}, ..."
                     if len(held) > 3 else f"held back for that: {', '.join(held)}")
    sound = [record for record, _ in whole]
    records, hold_out = sound[: len(records)], sound[len(records) :]
    unrelated = [
        replace(f, subject=f"{record.path}, {f.subject}")
        for record in (*records, *hold_out) for f in check_response(record)
    ]
    if load_kind(parameters) == "force":  # the weight is the model's; a load cell holds it as it is
        records, hold_out = (list(map(_without_force, some)) for some in (records, hold_out))
    shortest = shared_bin([*records, *hold_out], parameters)
    seen = [observe(record, parameters, shortest, quantities) for record in records]
    unseen = [observe(record, parameters, shortest, quantities) for record in hold_out]
    found = search([*seen, *unseen], parameters, progress, doubted)
    weights = weigh(found)
    decision = decide(found, weights)
    model = _model(decision, found)
    improved = _improved(model, decision, parameters)
    progress("shrinkage on data that no fit saw")
    fitted, unfitted = (seen, unseen) if unseen else _split(seen)
    moved = _fitted_to(fitted, found.recalibrated, found.off)
    blind = moved if model is found.recalibrated else _fitted_to(fitted, model)
    following, remarks = _next(decision, found, weights, [*seen, *unseen], parameters, progress)
    cells = _where(found, model, decision.verdict)
    stages = stages_of(decision, found, locate(found.recalibrated.problem, missing_term(found)))
    top = cells[0]
    return Diagnosis(
        verdict=decision.verdict,
        cause=decision.cause,
        candidates=tuple(map(explanation, decision.candidates)),
        where=Where(
            top.signal, top.phase, top.side, next(iter(stages), ""), stages, tuple(cells),
            tuple(break_chain(found.recalibrated)),
        ),
        shrinkage=shrinkage(
            unfitted, parameters, moved.parameters, _believable(blind, decision, parameters),
            sensors_noise(
                model, [found.recalibrated, *found.singles.values(), *found.pairs.values()]
            ),
        ),
        moved=moved_parameters(model),
        smoother=smoother_kinetics(model),
        difference=difference(decision),
        left=left_behind(found, model),
        unexplained_sign=unexplained_sign(decision, found),
        not_compared=_not_compared([*seen, *unseen], parameters),
        record=tuple(dict.fromkeys(lines)),
        next_experiment=following if following and following.settles else None,
        findings=(
            *unrelated, *audit(parameters, papers_own=False),
            *about_unstated(found.recalibrated.unknowns, parameters),
            _of_another_kind(fitted, unfitted, improved), *remarks,
        ),
        parameters=parameters, decision=decision, search=found, model=model, improved=improved,
        observations=(*seen, *unseen), fitted=tuple(fitted), held_out=tuple(unfitted),
    )


def _without_force(record: Record) -> Record:
    return replace(record, signals={n: s for n, s in record.signals.items() if n != "force"})


def _next(
    decision: Decision, found: Search, weights: Weights, observations: Sequence[Observation],
    parameters: Parameters, progress: Progress,
) -> tuple[NextExperiment | None, list[Finding]]:
    """The proposal and what there is to say of it; one that is refused costs no diagnosis."""
    if decision.verdict == NO_GAP:
        return None, []
    progress("the next experiment")
    try:
        following = next_experiment(decision, found, weights, observations, parameters)
    except InputError as error:
        return None, [Finding("warning", "next experiment", f"none is proposed: {error}")]
    return following, _inseparable(following) if decision.verdict == "ambiguous" else []


def about_unstated(unknowns: Unknowns, parameters: Parameters) -> list[Finding]:
    """What of the bench's unknowns nobody stated."""
    items = unknowns.items[: unknowns.bench]
    names = [
        n for item in items for n in (item.name, item.partner)
        if n and n not in parameters.given and BY_NAME[n].spread is not None
    ]
    text = (
        f"nobody stated {', '.join(names)}: each may be as far from its default as such wires and "
        "benches differ; identify it, or state what is known"
    )
    return [Finding("info", "parameters", text, {"unstated": float(len(names))})] if names else []


def _inseparable(following: NextExperiment | None) -> list[Finding]:
    if following is not None and following.settles:
        return []
    text = "no experiment that can be simulated settles a tie with what no effect explains" if (
        following is None
    ) else (
        f"nothing that the bench can do settles whether it is {' or '.join(following.separates)}: "
        f"after the best of it ({following.why}) the true cause would be named with a probability "
        f"of {100.0 * following.chance:.0f} % only"
    )
    return [Finding("info", "next experiment", text)]


def _model(decision: Decision, found: Search) -> Fit:
    """The most probable model that can be simulated."""
    for candidate in decision.candidates:
        if candidate.name == UNEXPLAINED:
            continue
        return candidate.fit or found.recalibrated
    return found.recalibrated


def _believable(fitted: Fit, decision: Decision, parameters: Parameters) -> Parameters:
    return parameters if decision.verdict == NO_GAP else fitted.parameters


def _improved(model: Fit, decision: Decision, parameters: Parameters) -> Parameters:
    """Parameters of the model with their new uncertainties, on top of what was given."""
    if decision.verdict == NO_GAP:
        return parameters
    values = model.parameters
    names = [n for n in model.unknowns.names if n not in SHAPES or values[n] != BY_NAME[n].default]
    stds = dict(zip(model.unknowns.names, model.errors.tolist(), strict=True))
    for twin, name in model.unknowns.tied.items():
        names.append(twin)
        stds[twin] = stds[name]
    return parameters.replace(
        {name: values[name] for name in names},
        {name: stds[name] for name in names if stds[name] > 0.0},
    )


def _fitted_to(
    observations: Sequence[Observation], model: Fit, off: Sequence[str] = ()
) -> Fit:
    """The same model fitted to some of the records, or parts of them; `off`: parameters of which
    more is unknown than was stated."""
    if not model.unknowns.items:
        return model
    problem = Problem(tuple(observations), model.problem.noise, ()).with_nuisances(model.parameters)
    unknowns, far = widened(model.unknowns, off)
    return fit(problem, unknowns, model.x / far, rounds=1, keep_noise=True)


def _where(found: Search, model: Fit, verdict: str) -> list[Cell]:
    """Where the gap lies: what the effects do, what no candidate explains, or what separates
    belief and recalibration."""
    problem = model.problem
    if verdict == UNEXPLAINED:
        return locate(problem, missing_term(found))
    if model.unknowns.effects:
        return locate(problem, contribution(model, model.unknowns.effects))
    return locate(problem, found.recalibrated.predicted - found.nominal.predicted)


def _split(observations: Sequence[Observation]) -> tuple[list[Observation], list[Observation]]:
    """Early and late part of every record."""
    early, late = [], []
    for obs in observations:
        start, stop = float(obs.grid[0]), float(obs.grid[-1])
        border = start + _FIT_SHARE * (stop - start)
        if not obs.between(-np.inf, border).signals:  # the readings began late
            border = float(np.quantile(np.concatenate([s.time for s in obs.signals]), _FIT_SHARE))
        early.append(obs.between(-np.inf, border))
        late.append(obs.between(border, np.inf))
    early, late = ([obs for obs in some if obs.signals] for some in (early, late))
    if not early or not late:
        raise InputError("diagnose: too few readings to fit a model to some and try it on the rest")
    return early, late


def _of_another_kind(
    fitted: Sequence[Observation], held_out: Sequence[Observation], parameters: Parameters
) -> Finding:
    """How far the held-out data try what the fitted ones have not shown."""
    share = unknown_share(fitted, held_out, parameters)
    text = (
        f"for {100.0 * share:.0f} % of its time some wire is where no fitted record has had one "
        "(temperature, its rate, martensite, the other side's temperature)"
    )
    if share < _OF_ONE_KIND:
        text += ": how far the gap shrinks under drives of another kind was not tried"
    return Finding("info", "held-out data", text)


def _not_compared(
    observations: Sequence[Observation], parameters: Parameters
) -> tuple[str, ...]:
    """Quantities that no record holds, though the bench has them."""
    held = {quantity for obs in observations for quantity in obs.quantities}
    moves = load_kind(parameters) != "clamped"  # of a clamped wire there is no motion to miss
    wanted = [q for q in QUANTITIES if moves or q != "deflection"]
    return tuple(quantity for quantity in wanted if quantity not in held)

"""The whole argument: is there a gap, where, which cause, how far it shrinks, what to do next."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.cards import card_html, card_text
from sma_bench.diagnose.argument import why
from sma_bench.diagnose.chain import Link, break_chain
from sma_bench.diagnose.decision import (
    NO_GAP,
    UNEXPLAINED,
    Candidate,
    Decision,
    Weights,
    decide,
    weigh,
)
from sma_bench.diagnose.next_experiment import NextExperiment, next_experiment
from sma_bench.diagnose.search import Progress, Search, search
from sma_bench.diagnose.shrinkage import Shrinkage, sensors_noise, shrinkage, unknown_share
from sma_bench.diagnose.sizes import Cell, contribution, locate
from sma_bench.diagnose.stages import missing_term, stages_of
from sma_bench.diagnose.tails import widened
from sma_bench.drawn import Reported
from sma_bench.errors import InputError
from sma_bench.estimation.observation import QUANTITIES, Observation, observe, shared_bin
from sma_bench.estimation.residual import Problem
from sma_bench.estimation.solver import Fit, fit
from sma_bench.estimation.unknowns import SHAPES
from sma_bench.findings import Finding
from sma_bench.parameters import Parameters, audit
from sma_bench.parameters.parameters import load_kind
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.records.check import check_response
from sma_bench.records.record import Record, fingerprint
from sma_bench.results import NOT_COMPARED, DiagnoseResult, diagnosis_from, json_text

Array = NDArray[np.float64]

_OF_ONE_KIND = 0.05  # of the held-out time in states that no fitted record has shown
_FIT_SHARE = 0.6  # of a single record without another to hold out
_WOULD_ADD = {
    "current": "heat and resistance could not be told apart by the current",
    "temperature": "thermal and mechanical causes could not be told apart by the temperature",
    "deflection": "nothing mechanical could be seen",
}


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Reported):
    """The result; `to_json` is the contract's.

    Attributes:
        decision: candidates and verdict; search: all fits behind them.
        model: the fit that the improved parameters are of; improved: these parameters.
        where: cells of the gap, the largest share first; stages: of the chain, with their
            probabilities, the most probable first; chain: its blocks, each driven by what was
            measured before it.
        shrinkage: by quantity.
        observations: all records; fitted, held_out: those, or the parts of them, that the fit of
            the shrinkage has seen and has not.
        why: what speaks for the verdict and against it, in sentences.
        findings: of the records and parameters, and what a missing sensor would have added.
    """

    writer = ("diagnosis_report", "write_diagnosis_report")

    parameters: Parameters
    decision: Decision
    search: Search
    model: Fit
    improved: Parameters
    where: tuple[Cell, ...]
    stages: dict[str, float]
    chain: tuple[Link, ...]
    shrinkage: dict[str, Shrinkage]
    observations: tuple[Observation, ...]
    fitted: tuple[Observation, ...]
    held_out: tuple[Observation, ...]
    why: tuple[str, ...]
    findings: tuple[Finding, ...]
    next_experiment: NextExperiment | None

    @property
    def stage(self) -> str:
        """The most probable one; "" without a gap."""
        return next(iter(self.stages), "")

    def to_json(self) -> dict[str, Any]:
        """The diagnosis result of contract section 5."""
        top = self.where[0]
        return {
            "verdict": self.decision.verdict,
            "cause": list(self.decision.cause),
            "candidates": [self._candidate(c) for c in self.decision.candidates],
            "where": {
                "signal": top.signal, "phase": top.phase, "side": top.side, "stage": self.stage,
                "stages": dict(self.stages),
                "table": [asdict(cell) for cell in self.where],
                "chain": [{**asdict(link), "ci90": list(link.ci90)} for link in self.chain],
            },
            "shrinkage": {
                name: {**asdict(s), "ci90": list(s.ci90)} for name, s in self.shrinkage.items()
            },
            "why": list(self.why),
            "size": self._sizes(),
            "next_experiment": self.next_experiment.to_json() if self.next_experiment else None,
            "findings": [f"{f.severity}: {f.subject}: {f.text}" for f in self.findings],
        }

    def _sizes(self) -> dict[str, Any]:
        """Numbers of the cause's effects: by effect, by number."""
        numbers = self._candidate(self.decision.candidates[0])["parameters"]
        return {
            effect: {p.name: numbers[p.name] for p in EFFECTS[effect].parameters}
            for effect in self.decision.cause
        }

    def __str__(self) -> str:
        """The verdict card."""
        return card_text(self.shown)

    def _repr_html_(self) -> str:
        """The verdict card in a notebook."""
        return card_html(self.shown)

    @cached_property
    def shown(self) -> DiagnoseResult:
        """As its result file would be read back."""
        return diagnosis_from(Path("diagnosis"), json.loads(json_text(self.to_json())))

    def _candidate(self, candidate: Candidate) -> dict[str, Any]:
        found: dict[str, Any] = {
            "name": candidate.name,
            "stage": "+".join(dict.fromkeys(EFFECTS[n].stage for n in candidate.effects)),
            "probability": candidate.probability,
            "parameters": {},
            "gap_over_noise": candidate.gap,
            "log_evidence": candidate.gain,
        }
        if candidate.fit is not None and candidate.effects:
            unknowns = candidate.fit.unknowns
            values, stds = unknowns.values(candidate.fit.x), candidate.fit.errors
            for k in range(unknowns.baseline, len(values)):
                name = unknowns.names[k]
                found["parameters"][name] = {
                    "value": float(values[k]), "std": float(stds[k]), "unit": BY_NAME[name].unit,
                }
        return found


def diagnose(
    records: Sequence[Record],
    parameters: Parameters,
    hold_out: Sequence[Record] = (),
    progress: Progress = lambda text: None,
    quantities: Sequence[str] = QUANTITIES,
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
    _refuse_fitted(records, hold_out)
    progress("records")
    unrelated = [
        replace(f, subject=f"{record.path}, {f.subject}")
        for record in (*records, *hold_out) for f in check_response(record)
    ]
    if load_kind(parameters) == "force":  # the weight is the model's; a load cell holds it as it is
        records, hold_out = (list(map(_without_force, some)) for some in (records, hold_out))
    shortest = shared_bin([*records, *hold_out], parameters)
    seen = [observe(record, parameters, shortest, quantities) for record in records]
    unseen = [observe(record, parameters, shortest, quantities) for record in hold_out]
    found = search([*seen, *unseen], parameters, progress)
    weights = weigh(found)
    decision = decide(found, weights)
    model = _model(decision, found)
    improved = _improved(model, decision, parameters)
    progress("shrinkage on data that no fit saw")
    fitted, unfitted = (seen, unseen) if unseen else _split(seen)
    moved = _fitted_to(fitted, found.recalibrated, found.off)
    blind = moved if model is found.recalibrated else _fitted_to(fitted, model)
    following, remarks = _next(decision, found, weights, [*seen, *unseen], parameters, progress)
    return Diagnosis(
        parameters, decision, found, model, improved,
        tuple(_where(found, model, decision.verdict)),
        stages_of(decision, found, locate(found.recalibrated.problem, missing_term(found))),
        tuple(break_chain(found.recalibrated)),
        shrinkage(
            unfitted, parameters, moved.parameters, _believable(blind, decision, parameters),
            sensors_noise(
                model, [found.recalibrated, *found.singles.values(), *found.pairs.values()]
            ),
        ),
        (*seen, *unseen), tuple(fitted), tuple(unfitted), tuple(why(decision, found, model)),
        (
            *unrelated, *audit(parameters, papers_own=False),
            *_missing([*seen, *unseen], parameters),
            _of_another_kind(fitted, unfitted, improved), *remarks,
        ),
        following if following and following.settles else None,
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


def _refuse_fitted(records: Sequence[Record], hold_out: Sequence[Record]) -> None:
    """A record that is fitted shows nothing of what a model predicts."""
    seen = {fingerprint(record): record.path for record in records}
    for record in hold_out:
        fitted = seen.get(fingerprint(record))
        if fitted is not None:
            same = "is" if fitted == record.path else f"holds the samples of {fitted}, which is"
            raise InputError(
                f"{record.path}: {same} fitted too; a hold-out must be of a run that no fit sees"
            )


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


def _missing(observations: Sequence[Observation], parameters: Parameters) -> list[Finding]:
    held = {q for obs in observations for q in obs.quantities}
    moves = load_kind(parameters) != "clamped"
    wanted = [q for q in _WOULD_ADD if moves or q != "deflection"]
    return [
        Finding("info", quantity, f"{NOT_COMPARED}: {_WOULD_ADD[quantity]}")
        for quantity in wanted if quantity not in held
    ]

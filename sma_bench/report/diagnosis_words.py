"""The argument of a diagnosis in sentences and tables, made from its numbers. No matplotlib."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.argument import cell_in_words
from sma_bench.diagnose.chain import reading_of
from sma_bench.diagnose.decision import NO_GAP, RECALIBRATION, UNEXPLAINED, Candidate
from sma_bench.diagnose.shrinkage import Shrinkage
from sma_bench.estimation.observation import QUANTITIES
from sma_bench.parameters.table import BY_NAME
from sma_bench.physics.effects import EFFECTS
from sma_bench.results import AT_NOISE, DiagnoseResult, in_print, in_unit, percent, with_error

_LIKELY = 0.02  # probability of a stage that is worth a word


def headline(result: Diagnosis) -> str:
    """The verdict in one sentence."""
    first = result.decision.candidates[0]
    sure = f" (probability {percent(first.probability)})"
    if result.decision.verdict == "effect":
        return f"The gap is explained by {_and(result.decision.cause)}{sure}."
    if result.decision.verdict == "ambiguous":
        tied = ", ".join(f"{c.name} ({percent(c.probability)})" for c in result.decision.credible)
        return f"The records cannot separate these: {tied}."
    return {
        RECALIBRATION: f"The parameters are off; no effect is missing{sure}.",
        NO_GAP: f"There is no gap beyond the noise{sure}.",
        UNEXPLAINED: f"There is a gap that no effect of the library explains{sure}.",
    }[result.decision.verdict]


def worst_first(result: Diagnosis) -> list[str]:
    """Held-out quantities by what the belief misses of them, over the noise."""
    times = {q: s.rmse_before / s.noise_floor for q, s in result.shrinkage.items()}
    others = [q for q in QUANTITIES if q not in times]
    return sorted(times, key=lambda q: times[q], reverse=True) + others


def is_there_a_gap(result: Diagnosis) -> list[str]:
    """What the believed parameters miss, against the noise."""
    said = []
    for quantity, s in in_order(result):
        times = s.rmse_before / s.noise_floor
        if at_noise(s):
            said.append(f"The held-out {quantity} agrees with the simulation within its noise.")
            continue
        said.append(
            f"With the parameters as believed the simulation misses the held-out {quantity} by "
            f"{in_print(quantity, s.rmse_before)} rms; the sensor's own noise is "
            f"{in_print(quantity, s.noise_floor)} ({times:.1f} times)."
        )
    moved = candidate_named(result, RECALIBRATION).gap
    said.append(
        f"Moving the parameters within their uncertainties shifts some reading by {moved:.2g} "
        "times its noise (rms over a record). The noise is what the best model leaves, white and "
        "slowly drifting parts estimated for every sensor."
    )
    if result.decision.verdict == NO_GAP:
        said.append("Measurement and simulation agree within the noise.")
    return said


def where_is_it(result: Diagnosis) -> list[str]:
    """The cell with the largest share, and the stage."""
    if result.decision.verdict == NO_GAP:
        return ["There is no gap, so it has no place."]
    if result.decision.verdict == UNEXPLAINED:
        missing = result.where[0]
        return [
            f"What is missing is largest in {cell_in_words(missing)}: {missing.gap:.2g} times the "
            f"noise, {in_print(missing.signal, missing.rms)} rms.",
            _stages(result),
        ]
    top = result.where[0]
    named = result.model.unknowns.effects
    subject = (
        f"what {_and(named)} {'does' if len(named) == 1 else 'do'} to the readings" if named
        else "what recalibration changes in the readings"
    )
    said = [
        f"{percent(top.share)} of {subject} lies in {cell_in_words(top)}: "
        f"{top.gap:.2g} times the noise, {in_print(top.signal, top.rms)} rms."
    ]
    if named:
        said.append(
            f"{_stages(result)} All signals are fitted together, so what an upstream signal "
            "explains is not counted again downstream."
        )
    reading = reading_of(result.chain)
    return [*said, reading] if reading else said


def which_effect(result: Diagnosis) -> list[str]:
    """The explanation, its rivals, and whether what it leaves is noise."""
    said = [headline(result)]
    for name in result.decision.cause:
        said.append(f"{name} ({EFFECTS[name].stage}) shows like this: {EFFECTS[name].shows}.")
    return [*said, *_numbers(result), *result.why]


def how_far(result: Diagnosis) -> list[str]:
    """Shrinkage in words, a sentence a quantity."""
    said = []
    for quantity, s in in_order(result):
        low, high = s.ci90
        if at_noise(s):
            said.append(f"The {quantity} was at its noise before: nothing to shrink.")
            continue
        said.append(
            f"On data that the fit had not seen, the {quantity}'s error goes from "
            f"{in_print(quantity, s.rmse_before)} to {in_print(quantity, s.rmse_after)} rms "
            f"(noise {in_print(quantity, s.noise_floor)}): {percent(s.fraction)} of the gap "
            f"beyond the noise is gone, 90 % interval {round(100 * low)} to {round(100 * high)} %."
        )
    return said


def what_next(result: Diagnosis) -> list[str]:
    """What to measure or do."""
    if result.next_experiment:
        return [_sentence(result.next_experiment.why)]
    advice = {
        "effect": "Load the improved parameters in the simulator. A further record with a drive "
                  "unlike these would test the effect where it has not been seen.",
        RECALIBRATION: "Load the improved parameters; the model itself needs nothing more for "
                       "drives like these.",
        NO_GAP: "Nothing to correct. Only a stronger or longer drive could show a gap.",
        UNEXPLAINED: "The shape of the missing term is the lead: look for what at the bench "
                     "follows it.",
        "ambiguous": "No protocol within the bench's limits was found that would separate the "
                     "tied explanations; a missing sensor may (see the remarks).",
    }
    return [advice[result.decision.verdict]]


def in_order(result: Diagnosis) -> list[tuple[str, Shrinkage]]:
    """Held-out quantities with what shrinks, the worst first."""
    return [(q, result.shrinkage[q]) for q in worst_first(result) if q in result.shrinkage]


def at_noise(shrinkage: Shrinkage) -> bool:
    """Whether there was nothing to shrink."""
    return shrinkage.rmse_before < AT_NOISE * shrinkage.noise_floor


def candidate_named(result: Diagnosis, name: str) -> Candidate:
    """The candidate of this name."""
    return next(c for c in result.decision.candidates if c.name == name)


def _stages(result: Diagnosis) -> str:
    """Where the chain breaks, over all explanations."""
    likely = [s for s in result.stages if result.stages[s] >= _LIKELY] or [result.stage]
    said = ", ".join(f"{s} ({percent(result.stages[s])})" for s in likely)
    return f"By all explanations together the chain breaks at this stage: {said}."


def estimates(candidate: Candidate) -> list[str]:
    """The numbers of a candidate's effects as text, `name value ± std unit`."""
    if candidate.fit is None or not candidate.effects:
        return []
    unknowns = candidate.fit.unknowns
    values, stds = unknowns.values(candidate.fit.x), candidate.fit.errors
    return [
        f"{name.removeprefix('effect.')} {in_unit(with_error(value, std), BY_NAME[name].unit)}"
        for name, value, std in list(zip(unknowns.names, values, stds, strict=True))[
            unknowns.baseline :
        ]
    ]


def _numbers(result: Diagnosis) -> list[str]:
    return [
        "Estimate: " + "; ".join(estimates(c)) + "."
        for c in result.decision.candidates[:1] if c.effects
    ]


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".") + "."


def _and(names: Iterable[str]) -> str:
    return " and ".join(names)


# --- The tables of a result, the same on a terminal and on a page.

_LEAST_SHOWN = 0.005


class DiagnosisTable(NamedTuple):
    """`name` for a file, title, cells as text; `numeric` are the columns set flush right."""

    name: str
    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    numeric: frozenset[int]


def result_tables(result: DiagnoseResult) -> list[DiagnosisTable]:
    """Candidates, where the gap lies, the chain where there is one, and what shrinks."""
    candidates = [
        (
            c.name, c.stage, f"{c.probability:.3f}", _or_empty(c.gap, ".2f"),
            _or_empty(c.gain, "+.1f"),
            "; ".join(
                f"{n.name} = {in_unit(with_error(n.value, n.std), n.unit)}" for n in c.numbers
            ),
        )
        for c in result.candidates if c.probability >= _LEAST_SHOWN
    ]  # fmt: skip
    where = [
        (signal, phase, side, f"{gap:.2f}", f"{100 * share:.0f} %", in_print(signal, rms))
        for signal, phase, side, gap, share, rms in result.where
    ]
    chain = [(b, f"{gap:.2f}", f"{low:.2f} to {high:.2f}") for b, gap, low, high in result.chain]
    shrinkage = [
        (
            s.quantity, *(in_print(s.quantity, rms) for rms in (s.before, s.after, s.noise)),
            _or_empty(100 * s.fraction, ".0f", " %"),
            f"{100 * s.ci90[0]:.0f} to {100 * s.ci90[1]:.0f} %" if np.isfinite(s.ci90[0]) else "",
        )
        for s in result.shrinkage
    ]
    tables = [
        DiagnosisTable(
            "candidates_table", "Candidates",
            ("candidate", "stage", "probability", "gap over noise", "log evidence [nats]",
             "numbers"), candidates, frozenset({2, 3, 4}),
        ),
        DiagnosisTable(
            "where", "Where the gap lies",
            ("signal", "phase", "side", "gap over noise", "share", "rms"), where,
            frozenset({3, 4, 5}),
        ),
        DiagnosisTable(
            "chain_table", "The chain, block by block",
            ("block, driven by what was measured", "gap over noise", "90 % interval"), chain,
            frozenset({1, 2}),
        ),
        DiagnosisTable(
            "shrinkage", "How far the gap shrinks, on data that no fit saw",
            ("held-out quantity", "rms before", "rms after", "noise", "gap that is gone",
             "90 % interval"), shrinkage, frozenset({1, 2, 3, 4, 5}),
        ),
    ]  # fmt: skip
    return [table for table in tables if table.rows or table.name != "chain_table"]


def _or_empty(value: float, form: str, unit: str = "") -> str:
    """JSON has null for a number that does not exist."""
    return format(value, form) + unit if np.isfinite(value) else ""

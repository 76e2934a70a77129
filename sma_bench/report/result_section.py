"""The parts of a report that show result files of `identify` and `diagnose`."""

import math
from collections.abc import Sequence

import numpy as np

from sma_bench.parameters.table import BY_NAME
from sma_bench.report.diagnosis_figures import STAGE_COLOURS
from sma_bench.report.diagnosis_words import with_error
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, new_figure
from sma_bench.report.page import Picture, Section, Table
from sma_bench.report.record_section import plain
from sma_bench.results import DiagnoseResult, IdentifyResult, Number, in_print

_LEAST_SHOWN = 0.005
_MOST_BARS = 12
_NUMBER_HEADER = ("parameter", "value", "standard error", "unit", "points", "method")
_QUANTITIES = frozenset({"current", "temperature", "deflection"})


def identify_section(result: IdentifyResult, name: str) -> tuple[Section, str]:
    """Numbers with their errors, and where they lie to the parameter table's.

    Returns:
        The section and a sentence for the summary.
    """
    tables = [_number_table(result.parameters, f"{name}_parameters", "Parameters")]
    for k, (title, source, numbers) in enumerate(result.experiments, 1):
        tables.append(_number_table(numbers, f"{name}_experiment_{k}", f"{title}, from {source}"))
    picture = _comparison(result, f"{name}_comparison")
    section = Section(
        f"Identification {result.path}", [], result.warnings, tables,
        [picture] if picture else [],
    )
    done = ", ".join(dict.fromkeys(title.split()[0] for title, _, _ in result.experiments))
    return section, f"{len(result.parameters)} parameters identified by {done or 'no experiment'}"


def diagnose_section(result: DiagnoseResult, name: str) -> tuple[Section, str]:
    """Verdict, candidates, where, and how far the gap shrinks.

    Returns:
        The section and a sentence for the summary.
    """
    said = verdict(result)
    following = [f"Next: {result.next_experiment}"] if result.next_experiment else []
    tables = [_candidates(result, name), _where(result, name), _shrinkage(result, name)]
    pictures = [_bars(result, f"{name}_candidates")]
    if result.chain:
        tables.insert(2, _chain(result, name))
        pictures.append(_chain_picture(result, f"{name}_chain"))
    section = Section(
        f"Diagnosis {result.path}", [f"{said}.", *following], result.warnings, tables, pictures
    )
    return section, said


def verdict(result: DiagnoseResult) -> str:
    """Verdict, cause and the probability of the first candidate, in one line."""
    cause = f" {' and '.join(result.cause)}" if result.cause else ""
    stage = f", {result.stage} stage" if result.stage and result.cause else ""
    first = result.candidates[0] if result.candidates else None
    sure = f" ({first.name} has probability {100 * first.probability:.0f} %)" if first else ""
    return f"{result.verdict}{cause}{stage}{sure}"


def _number_table(numbers: Sequence[Number], name: str, title: str) -> Table:
    rows = [
        (n.name, f"{n.value:.6g}", f"{n.std:.2g}", n.unit, str(n.n) if n.n else "", n.method)
        for n in numbers
    ]
    return Table(_NUMBER_HEADER, rows, frozenset({1, 2, 4}), name, title)


def _comparison(result: IdentifyResult, name: str) -> Picture | None:
    """Deviation from the table's defaults in percent, with one and two standard errors."""
    shown = [(n, default) for n in result.parameters if (default := _default(n))]
    if not shown:
        return None
    figure, (ax,) = new_figure(height=1.2 + 0.32 * len(shown))
    place = np.arange(len(shown))[::-1]
    off = [100.0 * (n.value / default - 1.0) for n, default in shown]
    error = [100.0 * abs(n.std / default) for n, default in shown]
    ax.errorbar(off, place, xerr=2.0 * np.array(error), fmt="none", ecolor=FAINT, elinewidth=1.0)
    ax.errorbar(off, place, xerr=error, fmt="o", color=MEASURED, elinewidth=2.5, ms=4)
    ax.axvline(0.0, color=MODEL, lw=1.0, ls="--")
    assumed = [BY_NAME[n.name].provenance.startswith("assumed") for n, _ in shown]
    labels = [f"{n.name} *" if a else n.name for (n, _), a in zip(shown, assumed, strict=True)]
    ax.set_yticks(place, labels, fontsize=8)
    ax.set_ylim(-0.6, len(shown) - 0.4)
    ax.set_xlabel("off the parameter table [%], one and two standard errors")
    drawn = [
        (n.name, f"{default:.6g}", f"{n.value:.6g}", f"{n.std:.2g}", n.unit)
        for n, default in shown
    ]
    caption = (
        "Reference: the default of docs/parameters.md, which is the paper's where it gives one; "
        "marked *: assumed."
    )
    table = Table(("parameter", "reference", "identified", "standard error", "unit"), drawn)
    return Picture(name, "Identified against the parameter table", caption, plain(figure), table)


def _default(number: Number) -> float:
    """0 where there is nothing to compare with."""
    known = BY_NAME.get(number.name)
    finite = math.isfinite(number.value) and math.isfinite(number.std) and number.std >= 0.0
    return float(known.default) if finite and known and isinstance(known.default, float) else 0.0


def _candidates(result: DiagnoseResult, name: str) -> Table:
    rows = [
        (
            c.name, c.stage, f"{c.probability:.3f}", f"{c.gap:.2f}", f"{c.gain:+.1f}",
            "; ".join(f"{n.name} = {with_error(n.value, n.std)} {n.unit}" for n in c.numbers),
        )
        for c in result.candidates if c.probability >= _LEAST_SHOWN
    ]  # fmt: skip
    header = ("candidate", "stage", "probability", "gap over noise", "log evidence [nats]",
              "numbers")  # fmt: skip
    return Table(header, rows, frozenset({2, 3, 4}), f"{name}_candidates_table", "Candidates")


def _where(result: DiagnoseResult, name: str) -> Table:
    rows = [
        (signal, phase, side, f"{gap:.2f}", f"{100 * share:.0f} %", printed(signal, rms))
        for signal, phase, side, gap, share, rms in result.where
    ]
    header = ("signal", "phase", "side", "gap over noise", "share", "rms")
    return Table(header, rows, frozenset({3, 4, 5}), f"{name}_where", "Where the gap lies")


def _chain(result: DiagnoseResult, name: str) -> Table:
    rows = [(b, f"{gap:.2f}", f"{low:.2f} to {high:.2f}") for b, gap, low, high in result.chain]
    header = ("block, driven by what was measured", "gap over noise", "90 % interval")
    return Table(
        header, rows, frozenset({1, 2}), f"{name}_chain_table", "The chain, block by block"
    )


def _shrinkage(result: DiagnoseResult, name: str) -> Table:
    rows = [
        (
            s.quantity, printed(s.quantity, s.before), printed(s.quantity, s.after),
            printed(s.quantity, s.noise), f"{100 * s.fraction:.0f} %",
            f"{100 * s.ci90[0]:.0f} to {100 * s.ci90[1]:.0f} %",
        )
        for s in result.shrinkage
    ]
    header = ("held-out quantity", "rms before", "rms after", "noise", "gap that is gone",
              "90 % interval")  # fmt: skip
    title = "How far the gap shrinks, on data that no fit saw"
    return Table(header, rows, frozenset({1, 2, 3, 4, 5}), f"{name}_shrinkage", title)


def printed(signal: str, value: float) -> str:
    """An SI value with its unit on paper; without one where the signal is not known."""
    if signal.rpartition(".")[2] in _QUANTITIES:
        return in_print(signal, value)
    return f"{value:.3g}"


def _bars(result: DiagnoseResult, name: str) -> Picture:
    shown = [c for c in result.candidates if c.probability >= _LEAST_SHOWN][:_MOST_BARS]
    figure, (ax,) = new_figure(height=1.2 + 0.32 * max(len(shown), 1))
    place = np.arange(len(shown))[::-1]
    colours = [STAGE_COLOURS.get(c.stage, FAINT) for c in shown]
    ax.barh(place, [c.probability for c in shown], color=colours, height=0.7)
    for y, c in zip(place, shown, strict=True):
        label = f"{c.probability:.3f}" + (f"  {c.stage}" if c.stage else "")
        ax.text(c.probability + 0.01, y, label, va="center", fontsize=8)
    ax.set_yticks(place, [c.name for c in shown], fontsize=8)
    ax.set(xlabel="probability", xlim=(0.0, 1.3), xticks=np.linspace(0.0, 1.0, 6))
    drawn = [(c.name, c.stage, f"{c.probability:.6g}") for c in shown]
    table = Table(("candidate", "stage", "probability"), drawn)
    return Picture(name, "Candidates", f"From {result.path}.", plain(figure), table)


def _chain_picture(result: DiagnoseResult, name: str) -> Picture:
    figure, (ax,) = new_figure(height=1.2 + 0.4 * len(result.chain))
    place = np.arange(len(result.chain))[::-1]
    gap = np.array([link[1] for link in result.chain])
    low, high = (np.array([link[k] for link in result.chain]) for k in (2, 3))
    error = np.maximum([gap - low, high - gap], 0.0)
    ax.errorbar(gap, place, xerr=error, fmt="o", color=MEASURED, capsize=4)
    ax.axvline(0.0, color=FAINT, lw=0.8)
    ax.set_yticks(place, [link[0] for link in result.chain], fontsize=8)
    ax.set_ylim(-0.6, len(result.chain) - 0.4)
    ax.set_xlabel("gap over noise, 90 % interval")
    drawn = [(b, *(f"{x:.6g}" for x in numbers)) for b, *numbers in result.chain]
    table = Table(("block", "gap over noise", "5 %", "95 %"), drawn)
    caption = "Each block of the model driven by what was measured before it."
    return Picture(name, "Where the chain breaks", caption, plain(figure), table)

"""An answer on one card: the same on a terminal, a page and in a notebook.

Made from the result file alone, so that a stored answer shows what a fresh one does.
"""

import html
import math
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

from sma_bench.border import printable
from sma_bench.parameters.effect_table import EFFECTS
from sma_bench.results import (
    AT_NOISE,
    DIFFER_MOST,
    NEEDS_NONE,
    NEEDS_OFF,
    NO_GAP,
    SOMETHING_ELSE,
    DiagnoseResult,
    IdentifyResult,
    Number,
    Proposed,
    Shown,
    Shrunk,
    in_print,
    percent,
    with_error,
)

_LEAST_NAMED = 0.02  # probability
_WIDTH = 96
_PHASES = {"initial": "before the first drive", "drive": "while driven", "rest": "at rest"}


class Card(NamedTuple):
    """The verdict in one line, and rows of a label ("" for that of the row above) and a text."""

    title: str
    rows: tuple[tuple[str, str], ...]


def verdict_card(result: DiagnoseResult) -> Card:
    """Cause, place, error on unseen data, rivals, and what to type next."""
    rows = [
        *(("cause", line) for line in _causes(result)),
        ("moved", _moved(result)),
        ("where", _where(result)),
        *(("error", line) for line in _errors(result)),
        ("rivals", _rivals(result)),
        ("left", _said(result, SOMETHING_ELSE)),
        ("next", _next(result)),
    ]
    said = [(label, text) for label, text in rows if text]
    above = ["", *(label for label, _ in said)]
    return Card(
        _title(result),
        tuple(("" if label == a else label, t) for a, (label, t) in zip(above, said, strict=False)),
    )


def card_text(result: DiagnoseResult) -> str:
    """The card as lines for a terminal, folded, labels once."""
    card = verdict_card(result)
    lines = textwrap.wrap(printable(card.title), _WIDTH)
    for label, text in card.rows:
        lines += textwrap.wrap(
            printable(text), _WIDTH, initial_indent=f"{label:8}", subsequent_indent=" " * 8,
            break_on_hyphens=False,
        )
    return "\n".join(lines)


def card_html(result: DiagnoseResult) -> str:
    """The card as a table, every text escaped."""
    card = verdict_card(result)
    rows = "".join(
        f"<tr><th>{label}</th><td>{html.escape(text)}</td></tr>" for label, text in card.rows
    )
    title = html.escape(card.title)
    return f'<div class="card"><p><strong>{title}</strong></p><table>{rows}</table></div>'


def identification_text(result: IdentifyResult) -> str:
    """What was identified, a number a line, and how much there is to be read beside it."""
    rows = [(n.name, _number(n), n.method) for n in result.parameters]
    wide = [max((len(row[k]) for row in rows), default=0) for k in range(2)]
    lines = [
        textwrap.shorten(f"{method}", max(_WIDTH - sum(wide) - 4, 20), placeholder=" ...")
        for _, _, method in rows
    ]
    said = [
        f"{name:{wide[0]}}  {number:{wide[1]}}  {line}".rstrip()
        for (name, number, _), line in zip(rows, lines, strict=True)
    ]
    count = len(result.warnings)
    if count:
        said.append(f"{count} warning{'s' if count > 1 else ''}, the first: {result.warnings[0]}")
    return "\n".join(printable(line) for line in said) or "nothing identified"


def identification_html(result: IdentifyResult) -> str:
    """The same as a table, every text escaped."""
    rows = "".join(
        f"<tr><th>{html.escape(n.name)}</th><td>{html.escape(_number(n))}</td>"
        f"<td>{html.escape(n.method)}</td></tr>"
        for n in result.parameters
    )
    warnings = "".join(f"<li>{html.escape(w)}</li>" for w in result.warnings)
    return f"<table>{rows}</table>" + (f"<ul>{warnings}</ul>" if warnings else "")


def _title(result: DiagnoseResult) -> str:
    if result.verdict == "ambiguous":
        return f"not settled by these records: {_named(result.candidates)}"
    verb = "explains" if len(result.cause) == 1 else "explain"
    said = {
        "effect": f"{' and '.join(result.cause)} {verb} the gap",
        "recalibration": "no effect is missing, the parameters are off",
        NO_GAP: "no gap beyond the noise",
    }.get(result.verdict, "a gap that no known effect explains")
    sure = [f" (probability {percent(c.probability)})" for c in result.candidates[:1]]
    return "".join([said, *sure])


def _causes(result: DiagnoseResult) -> list[str]:
    """An effect in plain words, its size and the stage where it acts."""
    numbers = [n for c in result.candidates[:1] for n in c.numbers]
    return [f"{name}: {_plain(name)} {_size(name, numbers)}".rstrip() for name in result.cause]


def _plain(name: str) -> str:
    effect = EFFECTS.get(name)
    if effect is None:
        return ""
    title = effect.text.strip().partition("\n")[0].rstrip(".")
    return f"{title[:1].lower()}{title[1:]} ({effect.stage} stage)."


def _size(name: str, numbers: Sequence[Number]) -> str:
    own = [n for n in numbers if n.name.startswith(f"effect.{name}.")]
    return ", ".join(f"{n.name.rpartition('.')[2]} {_number(n)}" for n in own)


def _number(number: Number) -> str:
    """The value with its error, of which a part may be the sensors'."""
    unit = "" if number.unit == "1" else number.unit
    shown = f"{with_error(number.value, number.std)} {unit}".strip()
    if not number.systematic > 0.0:
        return shown
    return f"{shown} ({number.systematic:.2g} of the sensors)"


def _moved(result: DiagnoseResult) -> str:
    """Parameters that are surprisingly far off; of a recalibration, that none is, too."""
    off = _said(result, NEEDS_OFF)
    return off if off or result.verdict != "recalibration" else _said(result, NEEDS_NONE)


def _where(result: DiagnoseResult) -> str:
    if result.verdict == NO_GAP or not result.where:
        return ""
    signal, phase, side, gap, share, rms = result.where[0]
    place = f"{signal} {_PHASES.get(phase, phase)}, {side} side"
    size = f"{in_print(signal, rms)} rms, {gap:.3g} times the noise of a reading"
    return f"{place}: {percent(share)} of it ({size})"


def _errors(result: DiagnoseResult) -> list[str]:
    """A line a quantity on data that no fit saw, the worst first."""
    return [_error(s, result) for s in sorted(result.shrinkage, key=_times, reverse=True)]


def _times(shrunk: Shrunk) -> float:
    times = shrunk.before / shrunk.noise if shrunk.noise > 0.0 else math.nan
    return times if math.isfinite(times) else 0.0


def _error(s: Shrunk, result: DiagnoseResult) -> str:
    if _times(s) < AT_NOISE:
        return f"{s.quantity} within its noise as believed ({in_print(s.quantity, s.noise)})"
    steps = [f"{in_print(s.quantity, s.before)} as believed"]
    if math.isfinite(s.recalibrated) and result.verdict not in ("recalibration", NO_GAP):
        steps.append(f"{in_print(s.quantity, s.recalibrated)} recalibrated")
    if result.verdict != NO_GAP:
        with_it = "recalibrated" if result.verdict == "recalibration" else "with the best model"
        with_it = "with the effect" if result.verdict == "effect" else with_it
        steps.append(f"{in_print(s.quantity, s.after)} {with_it}")
    said = f"{s.quantity} {' -> '.join(steps)}, noise {in_print(s.quantity, s.noise)}"
    if result.verdict == NO_GAP or not math.isfinite(s.fraction):
        return said
    low, high = s.ci90
    between = f" [{100 * low:.0f}, {100 * high:.0f}]" if math.isfinite(low) else ""
    return f"{said}: {percent(s.fraction)}{between} of the gap gone"


def _rivals(result: DiagnoseResult) -> str:
    difference = _said(result, DIFFER_MOST)
    close = _named(result.candidates[1:])
    if not close or result.verdict == "ambiguous":
        return difference
    return ". ".join(part for part in (close, difference) if part)


def _said(result: DiagnoseResult, words: str) -> str:
    """The sentence of `why` with these words, "" without one."""
    return next((sentence for sentence in result.why if words in sentence), "")


def _next(result: DiagnoseResult) -> str:
    if result.next_experiment is not None:
        return _proposal(result.next_experiment)
    return {
        "effect": "the same command with --out improved.yaml, then sma-bench simulate --params "
                  "improved.yaml --input RECORD --out simulated",
        "recalibration": "the same command with --out improved.yaml; load that file in every node",
        NO_GAP: "nothing to correct; a stronger or longer drive may show more",
        "ambiguous": "nothing that the bench can do would settle it: see the remarks",
    }.get(result.verdict, "the same command with --report page draws the shape of what is missing")


def _proposal(proposed: Proposed) -> str:
    if not proposed.separates:
        return proposed.why
    name = f"record {proposed.name} " if proposed.name else "record "
    if proposed.kind not in ("protocol", "sensor"):
        name = f"{proposed.kind} "
    minutes = f"({proposed.minutes:.1f} min) " if math.isfinite(proposed.minutes) else ""
    chance = (
        f"; it settles the matter with a probability of {percent(proposed.chance)}"
        if math.isfinite(proposed.chance) else ""
    )
    more = f"; {proposed.why}" if proposed.kind != "protocol" else ""
    return f"{name}{minutes}to separate {', '.join(proposed.separates)}{chance}{more}"


def _named(candidates: Sequence[Shown]) -> str:
    close = [c for c in candidates if c.probability >= _LEAST_NAMED]
    return ", ".join(f"{c.name} ({percent(c.probability)})" for c in close)

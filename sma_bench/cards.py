"""An answer on one card: the same on a terminal, a page and in a notebook.

Made from the result file alone, so that a stored answer shows what a fresh one does.
"""

import html
import math
import shlex
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

from sma_bench.border import printable
from sma_bench.parameters.parameter import EFFECTS
from sma_bench.results import (
    AT_NOISE,
    DIFFER_MOST,
    NEEDS_NONE,
    NEEDS_OFF,
    NO_GAP,
    NOT_COMPARED,
    SOMETHING_ELSE,
    DiagnoseResult,
    IdentifyResult,
    Invocation,
    Proposed,
    ShownCandidate,
    ShownNumber,
    Shrunk,
    in_print,
    in_unit,
    percent,
    signed,
    with_error,
)

_LEAST_NAMED = 0.02  # probability
_WIDTH, _NARROWEST = 96, 40
_PHASES = {"initial": "before the first drive", "drive": "while driven", "rest": "at rest"}


class Card(NamedTuple):
    """The verdict in one line, and rows of a label ("" for that of the row above) and a text."""

    title: str
    rows: tuple[tuple[str, str], ...]


def verdict_card(result: DiagnoseResult, asked: Invocation | None = None) -> Card:
    """Cause, place, error on unseen data, rivals, and what to type next."""
    rows = [
        *(("cause", line) for line in _causes(result)),
        ("moved", _moved(result)),
        ("where", _where(result)),
        *(("error", line) for line in _errors(result)),
        ("rivals", _rivals(result)),
        ("left", _said(result, SOMETHING_ELSE)),
        ("missing", _missing(result)),
        ("next", _next(result, asked)),
    ]
    said = [(label, text) for label, text in rows if text]
    above = ["", *(label for label, _ in said)]
    return Card(
        _title(result),
        tuple(("" if label == a else label, t) for a, (label, t) in zip(above, said, strict=False)),
    )


def card_text(
    result: DiagnoseResult, width: int = _WIDTH, asked: Invocation | None = None
) -> str:
    """The card as lines for a terminal of `width`, folded, labels once."""
    return "\n".join(card_lines(verdict_card(result, asked), width))


def card_html(result: DiagnoseResult) -> str:
    """The card as a table, every text escaped."""
    return _html(verdict_card(result))


def card_lines(card: Card, width: int = _WIDTH) -> list[str]:
    """The title and the rows, folded; no line is longer than can be read at ease."""
    width = max(min(width, _WIDTH), _NARROWEST)
    lines = textwrap.wrap(printable(card.title), width)
    for label, text in card.rows:
        lines += textwrap.wrap(
            printable(text), width, initial_indent=f"{label:8}", subsequent_indent=" " * 8,
            break_on_hyphens=False,
        )
    return lines


def _html(card: Card, above: str = "") -> str:
    rows = "".join(
        f"<tr><th>{label}</th><td>{html.escape(text)}</td></tr>" for label, text in card.rows
    )
    title = html.escape(card.title)
    return f'<div class="card"><p><strong>{title}</strong></p>{above}<table>{rows}</table></div>'


# --- The card of an identification.

NUMBER_HEADER = (
    "parameter", "value ± statistical ± systematic", "from the records", "reference", "off it",
    "by",
)
_SURPRISES = 3.0  # standard deviations
_TOGETHER = 0.5  # correlation worth a line
_MOST_PAIRS = 3


def fit_line(result: IdentifyResult) -> str:
    """Which signals the model misses; "" where it fits all within their noise."""
    for verdict, head, tail in (
        ("misfit", "The model does not fit", "Do not use these numbers; run diagnose with the "
         "parameters you believed"),
        ("imperfect", "The model fits imperfectly", "Above the noise, at most 5 % of the range"),
    ):  # fmt: skip
        missed = [
            f"{name} is missed by {_sized(fit.rms, fit.unit)} rms (noise "
            f"{_sized(fit.noise, fit.unit)})"
            for name, fit in result.fit.items() if fit.verdict == verdict
        ]
        if missed:
            return f"{head}: {', '.join(missed)}. {tail}"
    return ""


_THOUSANDTHS = {"m": "mm", "A": "mA"}


def _sized(value: float, unit: str) -> str:
    thousandth = _THOUSANDTHS.get(unit)
    return f"{1e3 * value:.2g} {thousandth}" if thousandth else in_unit(f"{value:.2g}", unit)


def is_misfit(result: IdentifyResult) -> bool:
    """Whether the model misses some signal by more than noise and 5 % of its range."""
    return any(fit.verdict == "misfit" for fit in result.fit.values())


def identification_card(
    result: IdentifyResult, numbers: bool = True, asked: Invocation | None = None
) -> Card:
    """Every number in a row of its own where there is no table of them, which surprise, which hang
    together, and what to type next; a model that does not fit comes first of all."""
    done = ", ".join(dict.fromkeys(title.split()[0] for title, _, _ in result.experiments))
    count, warned = len(result.parameters), len(result.warnings)
    rows = [(row[0], _in_a_row(row)) for row in number_rows(result) if numbers]
    rows += [
        ("off", ", ".join(map(_surprise, surprising(result)))),
        ("linked", _linked(result)),
        ("beware", f"{_plural(warned, 'warning')}, the first: {result.warnings[0]}"
         if warned else ""),
        ("next", _after_identification(result, asked)),
    ]  # fmt: skip
    title = f"{_plural(count, 'parameter')} identified" + (f" by {done}" if done else "")
    if said := fit_line(result):
        rows = [("", title), *rows] if is_misfit(result) else [("fit", said), *rows]
        title = said if is_misfit(result) else title
    return Card(title, tuple((label, text) for label, text in rows if text))


def _after_identification(result: IdentifyResult, asked: Invocation | None) -> str:
    """From what was asked for: after a misfit from the parameters that were believed, never from
    those that were fitted."""
    if not result.parameters:
        return ""
    records = " ".join(map(shlex.quote, asked.records)) if asked and asked.records else "RECORD"
    if is_misfit(result):
        params = shlex.quote(asked.params) if asked and asked.params else "lab.yaml"
        stated = "" if asked and asked.params else (
            ", a file of what you believe (sma-bench parameters --out lab.yaml is one to begin "
            "with)")
        return f"sma-bench diagnose {records} --params {params}{stated}"
    if asked is None or asked.out:
        out = shlex.quote(asked.out) if asked else "identified.yaml"
        return f"sma-bench diagnose {records} --params {out}"
    return (f"the same command with --out identified.yaml, then sma-bench diagnose {records} "
            "--params identified.yaml")


def number_rows(result: IdentifyResult) -> list[tuple[str, ...]]:
    """A row a number, as `NUMBER_HEADER`: its error in two parts, the share of its information
    that came from the records, and how it agrees with what the parameter file states."""
    experiment_of = {n.name: title.split()[0] for title, _, own in result.experiments for n in own}
    return [
        (
            n.name, two_errors(n),
            percent(n.informed) if math.isfinite(n.informed) else "", *_agreement(n),
            ", ".join([experiment_of.get(n.name, ""), *["warned"] * bool(n.warned)]),
        )
        for n in result.parameters
    ]


def _in_a_row(cells: tuple[str, ...]) -> str:
    _, value, informed, reference, off, _ = cells
    said = [value, f"{informed} from the records" if informed else ""]
    said.append(f"{off} off {reference}" if reference else "")
    return ", ".join(part for part in said if part)


def two_errors(number: ShownNumber) -> str:
    """Value ± statistical ± systematic error, to the digits that the smaller leaves it, and the
    unit."""
    parts = [part for part in (number.statistical, number.systematic) if part > 0.0]
    if not number.systematic > 0.0 or not all(map(math.isfinite, (number.value, *parts))):
        return in_unit(with_error(number.value, number.std), number.unit)
    value = with_error(number.value, min(parts)).partition(" ±")[0]
    both = f"{value} ± {number.statistical:.2g} ± {number.systematic:.2g}"
    return in_unit(both, number.unit)


def surprising(result: IdentifyResult) -> list[ShownNumber]:
    """Numbers that lie far off what the parameter file states, both errors together."""
    return [n for n in result.parameters if n.stated and abs(_off(n)) > _SURPRISES]


def _off(number: ShownNumber) -> float:
    """Standard deviations from what is stated; 0 where nothing is."""
    value, std = number.stated or (math.nan, math.nan)
    off = (number.value - value) / max(math.hypot(number.std, std), 1e-300)
    return off if math.isfinite(off) else 0.0


def _surprise(number: ShownNumber) -> str:
    _, off = _agreement(number)
    return f"{number.name} {off}"


def _agreement(number: ShownNumber) -> tuple[str, str]:
    """What the parameter file states, and how far the number is off it."""
    if number.stated is None or not math.isfinite(number.value):
        return "", ""
    value, std = number.stated
    apart = number.value - value  # of temperatures, a share of the absolute one says nothing
    relative = value != 0.0 and number.unit != "K"
    off = f"{signed(100.0 * apart / value, '.2g')} %" if relative else (
        in_unit(signed(apart, ".2g"), number.unit))
    if number.std > 0.0 or std > 0.0:
        off += f" ({signed(_off(number), '.1f')} std)"
    return with_error(value, std), off


def _linked(result: IdentifyResult) -> str:
    names, rows = result.correlation
    pairs = [
        (rows[i][j], names[i], names[j]) for i in range(len(names)) for j in range(i)
        if abs(rows[i][j]) > _TOGETHER
    ]
    pairs.sort(key=lambda pair: abs(pair[0]), reverse=True)
    said = [f"{one} and {two} ({value:+.2f})" for value, one, two in pairs[:_MOST_PAIRS]]
    more = [f"{len(pairs) - _MOST_PAIRS} more"] if len(pairs) > _MOST_PAIRS else []
    return "errors of " + ", ".join(said + more) if said else ""


def _plural(count: int, name: str) -> str:
    return f"{count} {name}" + ("" if count == 1 else "s")


def identification_text(result: IdentifyResult, asked: Invocation | None = None) -> str:
    """The card, a number a line below its title."""
    if not result.parameters:
        return "nothing identified"
    rows = [NUMBER_HEADER, *number_rows(result)]
    kept = [k for k in range(len(NUMBER_HEADER)) if any(row[k] for row in rows[1:])]
    wide = [max(len(row[k]) for row in rows) for k in kept]
    table = [
        "  ".join(f"{row[k]:{w}}" for k, w in zip(kept, wide, strict=True)).rstrip() for row in rows
    ]
    title, *below = title_apart(identification_card(result, False, asked))
    return "\n".join([title, *map(printable, table), *below])


def title_apart(card: Card, width: int = _WIDTH) -> list[str]:
    """The lines of the title as one, then those of the rows."""
    title = card_lines(Card(card.title, ()), width)
    return ["\n".join(title), *card_lines(card, width)[len(title) :]]


def identification_html(result: IdentifyResult) -> str:
    """The same as a table, every text escaped."""
    rows = [f"<tr>{''.join(f'<th>{head}</th>' for head in NUMBER_HEADER)}</tr>"]
    rows += [
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>"
        for row in number_rows(result)
    ]
    return _html(identification_card(result, numbers=False), f"<table>{''.join(rows)}</table>")


# --- Parts of the card of a diagnosis.

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


def _size(name: str, numbers: Sequence[ShownNumber]) -> str:
    own = [n for n in numbers if n.name.startswith(f"effect.{name}.")]
    return ", ".join(f"{n.name.rpartition('.')[2]} {two_errors(n)}" for n in own)


def _moved(result: DiagnoseResult) -> str:
    """Parameters that are surprisingly far off; of a recalibration, that none is, too."""
    off = _said(result, NEEDS_OFF)
    return off if off or result.verdict != "recalibration" else _said(result, NEEDS_NONE)


def _where(result: DiagnoseResult) -> str:
    if result.verdict == NO_GAP or not result.where:
        return ""
    signal, phase, side, gap, share, rms = result.where[0]
    place = f"{signal} {_PHASES.get(phase, phase)}" + f", {side} side" * bool(side)
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
    between = f" [{round(100 * low)}, {round(100 * high)}]" if math.isfinite(low) else ""
    return f"{said}: {percent(s.fraction)}{between} of the gap gone"


def _rivals(result: DiagnoseResult) -> str:
    difference = _said(result, DIFFER_MOST)
    close = _named(result.candidates[1:])
    if not close or result.verdict == "ambiguous":
        return difference
    return ". ".join(part for part in (close, difference) if part)


def _missing(result: DiagnoseResult) -> str:
    """Sensors that the records lack, and what they would have told."""
    found = [w.partition(": ")[2] for w in result.warnings if NOT_COMPARED in w]
    return "; ".join(text.replace(f": {NOT_COMPARED}:", " was not compared:") for text in found)


def _said(result: DiagnoseResult, words: str) -> str:
    """The sentence of `why` with these words, "" without one."""
    return next((sentence for sentence in result.why if words in sentence), "")


def _next(result: DiagnoseResult, asked: Invocation | None) -> str:
    """What to do, from what was asked for: with what is there already, or where nothing is known of
    the command, without one."""
    if result.next_experiment is not None:
        return _proposal(result.next_experiment)
    improved = shlex.quote(asked.out) if asked and asked.out else "improved.yaml"
    again = f"the same command with --out {improved}" if asked and not asked.out else ""
    record = shlex.quote(asked.records[0]) if asked and asked.records else "RECORD"
    simulated = f"sma-bench simulate --params {improved} --input {record} --out simulated"
    shape = "draws the shape of what is missing"
    return {
        "effect": f"{again}, then {simulated}" if again else simulated,
        "recalibration": f"{again}; load that file in every node" if again else
                         f"load {improved} in every node",
        NO_GAP: "nothing to correct; a stronger or longer drive may show more",
        "ambiguous": "nothing that the bench can do would settle it: see the remarks",
    }.get(
        result.verdict, f"{asked.report} {shape}" if asked and asked.report else
        f"the same command with --report page {shape}" if asked else f"its page {shape}",
    )  # fmt: skip


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


def _named(candidates: Sequence[ShownCandidate]) -> str:
    close = [c for c in candidates if c.probability >= _LEAST_NAMED]
    return ", ".join(f"{c.name} ({percent(c.probability)})" for c in close)

"""An examination's result as a page: on the terminal, and as a repository keeps it."""

import math
from collections.abc import Sequence

from examination.blind.case_files import CaseSet
from examination.blind.measures import OTHERS, TARGETS, Bound, Measure, Measured
from examination.blind.score import FOLLOWED_UP, Paper, Score, confusion, groups
from sma_bench.installation import VERSION

_MOST_SHOWN = 4
_DASH = "–"
# By style of a measure: factor, digits, unit behind the number.
_STYLES = {"share": (100.0, 1, " %"), "points": (100.0, 1, ""), "number": (1.0, 2, ""),
           "seconds": (1.0, 1, " s")}  # fmt: skip
Rows = Sequence[Sequence[str]]


def number(measure: Measure, value: float) -> str:
    """A value in the style of its measure; a dash for none."""
    factor, digits, unit = _STYLES[measure.style]
    return f"{value * factor:.{digits}f}{unit}" if math.isfinite(value) else _DASH


def interval(measure: Measure, measured: Measured) -> str:
    """Low to high; an open end where the cases are too few for a bound."""
    low, high = number(measure, measured.low), number(measure, measured.high)
    if not measured.n or low == high == _DASH:
        return _DASH
    if _DASH in (low, high):
        return f"above {low}" if high == _DASH else f"below {high}"
    return f"{low.removesuffix(_STYLES[measure.style][2])} to {high}"


def bound(measure: Measure, value: Bound) -> str:
    """A floor or an aim."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return f"{100 * value[0]:.0f} to {100 * value[1]:.0f} %"
    factor, _, unit = _STYLES[measure.style]
    return f"{'≥' if measure.better == 'higher' else '≤'} {value * factor:g}{unit}"


def side_by_side(scores: Sequence[Score], measures: Sequence[Measure]) -> list[tuple[str, ...]]:
    """One row a measure: its name, and each examinee's value with its interval."""
    rows = []
    for m in measures:
        found = [score.measured[m.name] for score in scores]
        values = [f"{number(m, f.value)} ({interval(m, f)})" if f.n else _DASH for f in found]
        rows.append((m.title, *values))
    return rows


def summary(score: Score) -> str:
    """How many floors and aims an examinee reaches, and which floors it misses."""
    met = {m.name: m.met(score.measured[m.name]) for m in TARGETS}
    judged = {name: how for name, how in met.items() if how}
    missed = [name for name, how in judged.items() if how == "missed"]
    aims = sum(how == "aim" for how in judged.values())
    text = f"{score.name}: {aims} aims reached, {len(judged) - len(missed)} of {len(judged)} floors"
    return text + (f"; missed: {', '.join(missed)}" if missed else "")


def tables(score: Score) -> list[str]:
    """Everything that is known of one examinee: measures, groups of cases, and what was chosen
    instead of the truth."""
    rows = {}
    for m in (*TARGETS, *OTHERS):
        found = score.measured[m.name]
        rows[m] = (m.title, str(found.n), number(m, found.value), interval(m, found))
    bounds = {m: (bound(m, m.floor), bound(m, m.aim), m.met(score.measured[m.name])) for m in rows}
    header = ("measure", "cases", "value", "95 % interval")
    targets = [rows[m] + bounds[m] for m in TARGETS]
    lines = [*_table((*header, "floor", "aim", "met"), targets), "", "Besides:", ""]
    lines += _table(header, [rows[m] for m in OTHERS])
    for name, by_group in groups(score.cases).items():
        body = []
        for group, row in by_group.items():
            values = [f"{v.value:.2f} ({v.low:.2f} to {v.high:.2f})" for v in row.values()]
            body.append((group, str(next(iter(row.values())).n), *values))
            header = ("", "cases", *row)
        if body:
            lines += ["", f"{name.capitalize()}:", "", *_table(header, body)]
    choices = []
    for truth, row in confusion(score.cases).items():
        often = [f"{row[name]} {name}" for name in sorted(row, key=lambda name: -row[name])]
        if len(often) > _MOST_SHOWN:
            often[_MOST_SHOWN:] = [f"{len(often) - _MOST_SHOWN} more"]
        choices.append((truth, str(sum(row.values())), ", ".join(often)))
    header = ("truth", "cases", "most frequent first choices")
    return [*lines, "", "Truth against first choice:", "", *_table(header, choices)]


def page(cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score], name: str) -> str:
    """The result page, which a repository keeps as the file `name`."""
    head = (
        f"{len(cases.names)} cases of seed {cases.seed} ({cases.split}), sma_bench {VERSION}, "
        f"sealed labels {cases.sealed_sha256[:16]}."
    )
    lines = ["# The withheld-effect check", "", head, "", "```"]
    lines += [f"./bench blind make --seed {cases.seed} --n {len(cases.names)} --out cases"]
    for paper in papers:
        if not paper.name.endswith(FOLLOWED_UP):
            rival = f" --rival {paper.name}" if "rival" in paper.examination.program else ""
            lines.append(f"./bench blind run cases{rival}")
    lines += [f"./bench blind score cases --markdown {name}", "```", ""]
    lines += [f"- {summary(score)}" for score in scores]
    lines += ["", "Value (95 % interval); Clopper-Pearson for shares.", ""]
    rows = [
        (name, bound(m, m.floor), bound(m, m.aim), *values)
        for m, (name, *values) in zip(TARGETS, side_by_side(scores, TARGETS), strict=True)
    ]
    lines += _table(("measure", "floor", "aim", *(score.name for score in scores)), rows)
    for score in scores:
        lines += ["", f"## {score.name}", "", *tables(score), ""]
    lines += ["## Definitions", ""]
    lines += [f"- **{m.name}**: {m.definition}" for m in (*TARGETS, *OTHERS) if m.definition]
    return "\n".join(lines) + "\n"


def _table(header: Sequence[str], rows: Rows) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

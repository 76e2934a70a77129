"""An examination's result in tables: on the terminal, and as the page that a repository keeps."""

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from examination.blind.case_files import CaseSet
from examination.blind.measures import OTHERS, TARGETS, Bound, Measure, Measured
from examination.blind.score import (
    FOLLOWED_UP,
    Paper,
    Score,
    beaten,
    confusion,
    groups,
    reliability,
)
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters.yaml_file import write_text_atomically

NOTES = "## Notes"
_CHALLENGER = "diagnosis"
_MOST_SHOWN = 4
_DASH = "–"
# By style of a measure: factor, digits, unit behind the number, unit behind the name.
_STYLES = {
    "share": (100.0, 1, " %", ""), "points": (100.0, 1, "", " (points)"),
    "number": (1.0, 2, "", ""), "seconds": (1.0, 1, " s", ""),
}

# (title, header, rows)
ResultTable = tuple[str, Sequence[str], list[tuple[str, ...]]]


# --- Numbers.


def title(measure: Measure) -> str:
    """Name of a row with its unit."""
    return measure.name + _STYLES[measure.style][3]


def number(measure: Measure, value: float) -> str:
    """A value in the style of its measure; a dash for none."""
    factor, digits, unit, _ = _STYLES[measure.style]
    return f"{value * factor:.{digits}f}{unit}" if math.isfinite(value) else _DASH


def interval(measure: Measure, measured: Measured) -> str:
    """Low to high; an open end where the cases are too few for a bound."""
    if not measured.n:
        return _DASH
    low, high = number(measure, measured.low), number(measure, measured.high)
    if math.isinf(measured.high):
        return f"above {low}" if math.isfinite(measured.low) else _DASH
    if math.isinf(measured.low):
        return f"below {high}"
    return f"{low.removesuffix(_STYLES[measure.style][2])} to {high}"


def bound(measure: Measure, value: Bound) -> str:
    """A floor or an aim."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return f"{100 * value[0]:.0f} to {100 * value[1]:.0f} %"
    factor, _, unit, _ = _STYLES[measure.style]
    return f"{'≥' if measure.better == 'higher' else '≤'} {value * factor:g}{unit}"


# --- Tables.


def tables(score: Score) -> list[ResultTable]:
    """Everything that is known of one examinee: measures, groups of cases, reliability, and what
    was chosen instead of the truth."""
    rows = [
        (title(m), str(found.n), number(m, found.value), interval(m, found), bound(m, m.floor),
         bound(m, m.aim), m.met(found))
        for m in (*TARGETS, *OTHERS) for found in [score.measured[m.name]]
    ]  # fmt: skip
    header = ("measure", "cases", "value", "95 % interval", "floor", "aim", "met")
    shown: list[ResultTable] = [
        ("measures", header, rows[: len(TARGETS)]),
        ("besides", header[:4], [row[:4] for row in rows[len(TARGETS) :]]),
    ]
    for name, by_group in groups(score.cases).items():
        columns = list(next(iter(by_group.values()), {}))
        lines = [
            (group, str(row[columns[0]].n),
             *(f"{row[n].value:.2f} ({row[n].low:.2f} to {row[n].high:.2f})" for n in columns))
            for group, row in by_group.items()
        ]  # fmt: skip
        if lines:
            shown.append((name, ("", "cases", *columns), lines))
    bins = [
        (f"{b.low:.1f} to {b.high:.1f}", str(b.n), f"{b.stated:.2f}",
         f"{b.right:.2f} ({b.right_low:.2f} to {b.right_high:.2f})")
        for b in reliability(score.cases)
    ]  # fmt: skip
    shown.append(("reliability", ("probability of the first choice", "cases", "stated", "right"),
                  bins))  # fmt: skip
    choices = []
    for truth, row in confusion(score.cases).items():
        chosen = sorted((name for name in row if row[name]), key=lambda name: -row[name])
        often = [f"{row[name]} {name}" for name in chosen[:_MOST_SHOWN]]
        if len(chosen) > _MOST_SHOWN:
            often.append(f"{len(chosen) - _MOST_SHOWN} more")
        choices.append((truth, str(sum(row.values())), ", ".join(often)))
    header = ("truth", "cases", "most frequent first choices")
    return [*shown, ("truth against first choice", header, choices)]


def side_by_side(scores: Sequence[Score], measures: Sequence[Measure]) -> list[tuple[str, ...]]:
    """One row a measure: its name, and each examinee's value with its interval."""
    return [
        (title(m), *(f"{number(m, found.value)} ({interval(m, found)})" if found.n else _DASH
                     for found in (s.measured[m.name] for s in scores)))
        for m in measures
    ]  # fmt: skip


def summary(score: Score) -> str:
    """How many floors and aims an examinee reaches, and which floors it misses."""
    met = {m.name: m.met(score.measured[m.name]) for m in TARGETS}
    judged = {name: how for name, how in met.items() if how}
    missed = [name for name, how in judged.items() if how == "missed"]
    aims = sum(how == "aim" for how in judged.values())
    text = f"{score.name}: {aims} aims reached, {len(judged) - len(missed)} of {len(judged)} floors"
    return text + (f"; missed: {', '.join(missed)}" if missed else "")


# --- The page.


def write_markdown(
    path: str | Path, cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score]
) -> Path:
    """Write the result page of a repository; what stands below `## Notes` in it stays.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    head = (
        f"{len(cases.names)} cases of seed {cases.seed} ({cases.split}), sma_bench {VERSION}, "
        f"sealed labels {cases.sealed_sha256[:16]}."
    )
    lines = ["# The withheld-effect check", "", head, "", "```"]
    lines += [f"./bench blind make --seed {cases.seed} --n {len(cases.names)} --out cases"]
    for paper in papers:
        words = paper.examination.program
        if not paper.name.endswith(FOLLOWED_UP):
            rival = f" --rival {paper.name}" if "rival" in words else ""
            own = rival or paper.name == _CHALLENGER
            other = "" if own else f" --program '{' '.join(words)}'"
            lines.append(f"./bench blind run cases{rival}{other}")
    lines += [f"./bench blind score cases --markdown {path.name}", "```", ""]
    lines += [f"- {summary(score)}" for score in scores]
    mine = next((score for score in scores if score.name == _CHALLENGER), None)
    rivals = [score for score in scores if not score.name.startswith(_CHALLENGER)]
    if mine and rivals:
        worse = ", ".join(beaten(mine, rivals))
        lines.append(f"- A rival is better than the diagnosis in: {worse}." if worse else
                     "- The diagnosis is as good as every rival or better in every row.")
    lines += ["", "Value (95 % interval); Clopper-Pearson for shares.", ""]
    rows = [
        (name, bound(m, m.floor), bound(m, m.aim), *values)
        for m, (name, *values) in zip(TARGETS, side_by_side(scores, TARGETS), strict=True)
    ]
    lines += _markdown(("measure", "floor", "aim", *(score.name for score in scores)), rows)
    for score in scores:
        lines += ["", f"## {score.name}", ""]
        for name, header, rows in tables(score):
            lines += [f"{name.capitalize()}:", "", *_markdown(header, rows), ""]
    lines += ["## Definitions", ""]
    lines += [f"- **{m.name}**: {m.definition}" for m in (*TARGETS, *OTHERS) if m.definition]
    lines.append("")
    # The hand-written end of the page stays as it is.
    with suppress(OSError, UnicodeDecodeError):
        _, found, notes = path.read_text(encoding="utf-8").partition(f"\n{NOTES}\n")
        lines += [NOTES, notes] if found else []
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be made: {error.strerror}") from None
    write_text_atomically(path, "\n".join(lines).rstrip() + "\n")
    return path


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

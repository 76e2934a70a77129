"""The result of an examination as pages: HTML with figures, and Markdown for a repository."""

from collections.abc import Sequence
from pathlib import Path

from sma_bench import __version__
from sma_bench.blind.breakdown import confusion, groups
from sma_bench.blind.case_set import CaseSet
from sma_bench.blind.measure_table import OTHERS, TARGETS
from sma_bench.blind.result_figures import pictures
from sma_bench.blind.score import Paper, Score
from sma_bench.blind.wording import (
    MEASURE_HEADER,
    beaten,
    bound,
    measure_row,
    side_by_side,
    summary,
)
from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.report.page import Section, Table, write_report

NOTES = "## Notes"
_CHALLENGER = "diagnosis"
_MOST_SHOWN = 4
_NUMBERS = frozenset(range(1, 4))


def commands(cases: CaseSet, papers: Sequence[Paper], target: str) -> list[str]:
    """The command lines that lead to a result."""
    lines = [f"sma-bench blind make --seed {cases.seed} --n {len(cases.names)} --out cases"]
    for paper in papers:
        words = paper.examination.program
        rival = f" --rival {paper.name}" if "rival" in words else ""
        other = "" if rival or paper.name == _CHALLENGER else f" --program '{' '.join(words)}'"
        lines.append(f"sma-bench blind run cases{rival}{other}")
    return [*lines, f"sma-bench blind score cases {target}"]


def write_page(
    directory: str | Path, cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score]
) -> Path:
    """Write the HTML page; its path.

    Raises:
        InputError: the folder cannot be written.
    """
    sections = [
        Section(
            "Side by side",
            paragraphs=[summary(score) for score in scores],
            notes=_comparison(scores),
            tables=[Table(*_side_by_side(scores))],
        ),
        *(_section(score) for score in scores),
        Section("Definitions", tables=[Table(("measure", "what counts"), _definitions())]),
        Section("Made by", paragraphs=commands(cases, papers, f"--page {directory}")),
    ]
    return write_report(directory, "The withheld-effect check", _head(cases), sections)


def write_markdown(
    path: str | Path, cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score]
) -> Path:
    """Write the result page of a repository; what stands below `## Notes` in it stays.

    Raises:
        InputError: the file cannot be written.
    """
    path = Path(path)
    lines = ["# The withheld-effect check", "", _head(cases), "", "```"]
    lines += commands(cases, papers, f"--markdown {path.name}")
    lines += ["```", "", *(f"- {summary(score)}" for score in scores)]
    lines += [f"- {note}" for note in _comparison(scores)]
    lines += ["", "Value (95 % interval); Clopper-Pearson for shares.", ""]
    lines += _markdown_table(*_side_by_side(scores))
    for score in scores:
        lines += ["", f"## {score.name}", ""]
        for title, header, rows in _tables(score):
            lines += [f"{title[0].upper()}{title[1:]}:", ""] if title else []
            lines += [*_markdown_table(header, rows), ""]
    lines += ["## Definitions", "", *(f"- **{name}**: {text}" for name, text in _definitions())]
    lines += ["", *_kept_notes(path)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be made: {error.strerror}") from None
    write_text_atomically(path, "\n".join(lines).rstrip() + "\n")
    return path


def _head(cases: CaseSet) -> str:
    return (
        f"{len(cases.names)} cases of seed {cases.seed} ({cases.split}), sma_bench {__version__}, "
        f"sealed labels {cases.sealed_sha256[:16]}."
    )


def _kept_notes(path: Path) -> list[str]:
    """The hand-written end of the page as it is."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return []
    _, found, notes = text.partition(f"\n{NOTES}\n")
    return [NOTES, notes] if found else []


def _comparison(scores: Sequence[Score]) -> list[str]:
    """Whether the diagnosis beats every rival, row by row."""
    mine = [score for score in scores if score.name == _CHALLENGER]
    rivals = [score for score in scores if score.name != _CHALLENGER]
    if not mine or not rivals:
        return []
    worse = beaten(mine[0], rivals)
    if not worse:
        return ["The diagnosis is as good as every rival or better in every row."]
    return [f"A rival is better than the diagnosis in: {', '.join(worse)}."]


def _side_by_side(
    scores: Sequence[Score],
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    header = ("measure", "floor", "aim", *(score.name for score in scores))
    rows = [
        (name, bound(m, m.floor), bound(m, m.aim), *values)
        for m, (name, *values) in zip(TARGETS, side_by_side(scores, TARGETS), strict=True)
    ]
    return header, rows


def _tables(score: Score) -> list[tuple[str, Sequence[str], list[Sequence[str]]]]:
    """(title, header, rows) of one examinee."""
    found: list[tuple[str, Sequence[str], list[Sequence[str]]]] = [
        ("", MEASURE_HEADER, [measure_row(m, score.measured[m.name]) for m in TARGETS]),
        (
            "besides", MEASURE_HEADER[:4],
            [measure_row(m, score.measured[m.name])[:4] for m in OTHERS],
        ),
    ]  # fmt: skip
    for title, by_group in groups(score.cases).items():
        names = list(next(iter(by_group.values()), {}))
        rows: list[Sequence[str]] = [
            (group, str(row[names[0]].n),
             *(f"{row[n].value:.2f} ({row[n].low:.2f} to {row[n].high:.2f})" for n in names))
            for group, row in by_group.items()
        ]  # fmt: skip
        if rows:
            found.append((title, ("", "cases", *names), rows))
    header = ("truth", "cases", "most frequent first choices")
    return [*found, ("truth against first choice", header, _choices(score))]


def _choices(score: Score) -> list[Sequence[str]]:
    rows: list[Sequence[str]] = []
    for truth, row in confusion(score.cases).items():
        chosen = sorted((name for name in row if row[name]), key=lambda name: -row[name])
        shown = ", ".join(f"{row[name]} {name}" for name in chosen[:_MOST_SHOWN])
        more = len(chosen) - _MOST_SHOWN
        rows.append((truth, str(sum(row.values())), shown + (f", {more} more" if more > 0 else "")))
    return rows


def _section(score: Score) -> Section:
    tables = [Table(header, rows, _NUMBERS) for _, header, rows in _tables(score)]
    failed = [f"{c.label.id}: {c.failure}" for c in score.cases if c.answer is None]
    notes = [f"{len(failed)} cases failed, the first {failed[0]}"] if failed else []
    return Section(score.name, notes=notes, tables=tables, pictures=pictures(score))


def _definitions() -> list[tuple[str, str]]:
    return [(m.name, m.definition) for m in (*TARGETS, *OTHERS) if m.definition]


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

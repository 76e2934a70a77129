"""Pages of the check: every effect with it and without it, and an examination's result."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from examination.blind.case_files import MANIFEST, CaseSet
from examination.blind.cases import (
    ALL,
    EFFECTS,
    OUTSIDE,
    QUANTITIES,
    SINGLE,
    Card,
    Case,
    Draw,
    amount_for,
    draw,
    draw_case,
)
from examination.blind.measures import OTHERS, TARGETS
from examination.blind.reality import BY_NAME
from examination.blind.rigs import (
    COARSE,
    RECORDS,
    Stage,
    gaps,
    largest,
    quantity_of,
    world_of,
)
from examination.blind.score import (
    COLUMNS,
    FOLLOWED_UP,
    Paper,
    ResultTable,
    Score,
    beaten,
    bound,
    confusion,
    groups,
    reliability,
    side_by_side,
    summary,
    tables,
)
from examination.blind.sensors import UNITS, measure
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.records import Signal
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Made, Picture, Section, Table, write_report

# --- How an effect shows: the same record with it and without it.

Array = npt.NDArray[np.float64]

NAMES = (*EFFECTS, *OUTSIDE)
# Gap over noise that the eye sees beside the whole stroke, where the effect can be so large.
_TARGET = 120.0
_DPI = 80
_FEW_COLOURS = 64
_EVERY = 3  # samples: enough for the eye, a third of the file
_PANELS = 2
_SCALE = {"deflection": (1e3, "mm"), "temperature": (1.0, "K"), "current": (1.0, "A")}


@dataclass(frozen=True)
class Seen:
    """A figure and the numbers of its title.

    Attributes:
        name: of the effect; file: of the figure.
        features: what the effect moved, by name.
        gap: over noise, by signal.
    """

    name: str
    file: str
    features: dict[str, float]
    gap: dict[str, float]


def write_symptom(folder: Path, name: str, seed: int = 1) -> Seen:
    """Draw one effect into `folder`.

    Args:
        folder: exists.
        name: one of NAMES.
        seed: of the rig and its drive; every effect of a seed acts on the same rig.
    """
    case = draw_case(seed, 0, Card(SINGLE, (name,), (_TARGET,), ALL, "white"), name)
    stage = Stage(case.truth, case.sensors, case.drives)
    symptom = {**EFFECTS, **OUTSIDE}[name]
    drawn = draw(symptom, case.stream("effect"), stage.peak_current())
    features = drawn.features({}, _amount(stage, drawn))
    without, with_effect = (stage.read(f, RECORDS[0]) for f in ({}, features))
    gap = gaps(with_effect, without, stage.sensors, QUANTITIES[ALL])
    figure = _draw(case, stage, name, features, gap)
    file = f"{name}.png"
    _save(figure, folder / file)
    return Seen(name, file, features, gap)


def _save(figure: Figure, path: Path) -> None:
    """As a PNG of few colours: a fifth of the bytes."""
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(_FEW_COLOURS).save(path, optimize=True)


def _amount(stage: Stage, drawn: Draw) -> float:
    def gap(amount: float) -> float:
        with_effect = stage.read(drawn.features({}, amount), RECORDS[0], COARSE)
        without = stage.read({}, RECORDS[0], COARSE)
        return largest(gaps(with_effect, without, stage.sensors, QUANTITIES[ALL]))

    return amount_for(drawn, _TARGET, gap)


def _draw(
    case: Case, stage: Stage, name: str, features: dict[str, float], gap: dict[str, float]
) -> Figure:
    """The signals that show it best over time, measured, and the difference over the noise."""
    with_effect, without = (_measured(case, stage, f) for f in (features, {}))
    shown = _shown(gap)
    figure, axes = new_figure(_PANELS + 1, height=5.4)
    for ax, signal in zip(axes, shown, strict=False):
        _compare(ax, with_effect[signal], without[signal])
    _difference(axes[-1], stage, features, shown)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), frameon=False, fontsize=8)
    axes[0].set_title(_title(name, features, gap), fontsize=9, loc="left")
    axes[-1].set_xlabel("time / s")
    for ax in axes:
        _shade(ax, stage)
    return figure


def _shown(gap: dict[str, float]) -> list[str]:
    """The best signal of each of the quantities that show most."""
    best = [max((n for n in gap if quantity_of(n) == q), key=lambda n: gap[n]) for q in _SCALE]
    return sorted(best, key=lambda n: -gap[n])[:_PANELS]


def _measured(case: Case, stage: Stage, features: dict[str, float]) -> dict[str, Signal]:
    outcome, world = stage.play(features, RECORDS[0]), world_of(case.truth, features)
    rng = case.stream(RECORDS[0])
    return {s.name: s for s in measure(outcome, world, case.sensors, stage.channels, rng)}


def _compare(ax: Axes, with_effect: Signal, without: Signal) -> None:
    scale, unit = _SCALE[quantity_of(with_effect.name)]
    curves = ((without, MEASURED, 1.6, "without"), (with_effect, SECOND, 0.9, "with"))
    for signal, colour, width, label in curves:
        time, values = signal.time[::_EVERY], signal.values[::_EVERY]
        ax.plot(time, scale * values, color=colour, linewidth=width, label=label)
    ax.set_ylabel(f"{with_effect.name}\n/ {unit}", fontsize=8)


def _difference(
    ax: Axes, stage: Stage, features: dict[str, float], shown: Sequence[str]
) -> None:
    one, two = (stage.read(f, RECORDS[0]) for f in (features, {}))
    time = stage.drives[RECORDS[0]].grid(0.02)
    for name, colour in zip(shown, (SECOND, FAINT), strict=False):
        over_noise = (one[name] - two[name]) / stage.sensors.std(quantity_of(name))
        ax.plot(time[::5], over_noise[::5], color=colour, linewidth=0.9, label=name)
    ax.set_ylabel("with - without\n/ noise", fontsize=8)
    ax.legend(
        loc="lower right", bbox_to_anchor=(1, 0.92), frameon=False, ncols=2, fontsize=8
    )


def _shade(ax: Axes, stage: Stage) -> None:
    """Where a side is driven: front darker than back."""
    for pulse in stage.drives[RECORDS[0]].pulses:
        grey = "0.88" if pulse.side == "front" else "0.95"
        ax.axvspan(pulse.times[0], pulse.times[-1], color=grey, linewidth=0.0, zorder=0)


def _title(name: str, features: dict[str, float], gap: dict[str, float]) -> str:
    best = max(gap, key=lambda signal: gap[signal])
    return f"{name}\n{_settings(features)}\ngap {gap[best]:.0f} x noise in {best}"


def _settings(features: dict[str, float]) -> str:
    parts = [f"{n} {v:.3g} {BY_NAME[n].unit}".removesuffix(" 1") for n, v in features.items()]
    return ", ".join(sorted(parts))


def write_symptoms_index(folder: Path, seen: Sequence[Seen], seed: int) -> None:
    """An index of the figures, README.md."""
    lines = [
        "# How every effect shows",
        "",
        f"Made by `./bench blind figures --seed {seed}`: one rig and one drive, each effect in a "
        "size that the eye sees. Measured records with (red) and without (blue) the effect; below, "
        "the difference without noise, over the noise. Grey: front (darker) or back driven.",
        "",
    ]
    for group, names in (("The contract's effects", EFFECTS), ("Outside of it", OUTSIDE)):
        lines += [f"## {group}", ""]
        for one in (s for s in seen if s.name in names):
            lines += [f"### {one.name}", "", f"![{one.name}]({one.file})", ""]
            lines += [_table(one.gap), ""]
    (folder / "README.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def _table(gap: dict[str, float]) -> str:
    parts = [
        f"{quantity} {max(v for n, v in gap.items() if quantity_of(n) == quantity):.1f}"
        for quantity in UNITS
        if any(quantity_of(n) == quantity for n in gap)
    ]
    return f"Gap over noise: {', '.join(parts)}."


# --- Figures of one examinee's result.

_COLOURS = (MEASURED, MODEL, SECOND, "#4f8f5b", "#7a5195")
_SEVERITY = "single effects by severity (gap over noise)"
_SHOWN = ("gap seen", "first choice right", "probability of the truth")


def pictures(score: Score) -> list[Picture]:
    """Everything that is drawn of one examinee."""
    return [
        reliability_picture(score), severity_picture(score), confusion_picture(score),
        *shrinkage_pictures(score),
    ]  # fmt: skip


def reliability_picture(score: Score) -> Picture:
    """Stated probability against frequency, and below how often it was stated."""
    figure, (above, below) = new_figure(2, 5.4)
    bins = reliability(score.cases)
    stated, right = [b.stated for b in bins], np.array([b.right for b in bins])
    ends = np.array([[b.right - b.right_low, b.right_high - b.right] for b in bins]).T
    above.plot([0, 1], [0, 1], color=FAINT, lw=1, label="as stated")
    if bins:
        above.errorbar(stated, right, yerr=ends.clip(0.0), fmt="o", color=MEASURED, capsize=3)
        widths = [b.high - b.low for b in bins]
        below.bar([b.low for b in bins], [b.n for b in bins], widths, align="edge", alpha=0.6)
    above.set(xlim=(0, 1), ylim=(-0.02, 1.02), ylabel="share that was right")
    above.legend(frameon=False)
    below.set(xlabel="probability of the first choice", ylabel="cases")
    return Picture(
        f"{score.name}_reliability", f"Reliability of {score.name}",
        "Most probable candidates in bins of a tenth: mean stated probability against the share "
        "that was right, with 95 % Clopper-Pearson intervals.", figure,
    )  # fmt: skip


def severity_picture(score: Score) -> Picture:
    """What is seen and named of single effects, by the size of their gap."""
    figure, (ax,) = new_figure(1, 3.8)
    by_group = groups(score.cases)[_SEVERITY]
    names = list(by_group)
    for k, shown in enumerate(_SHOWN):
        rows = [by_group[name][shown] for name in names]
        value = np.array([row.value for row in rows])
        ends = np.array([[row.value - row.low, row.high - row.value] for row in rows]).T
        place = np.arange(len(names)) + 0.12 * (k - 1)
        if names:
            ax.errorbar(place, value, yerr=ends.clip(0.0), fmt="o-", color=_COLOURS[k],
                        capsize=3, label=shown)  # fmt: skip
    counts = [by_group[name][_SHOWN[0]].n for name in names]
    labels = [
        f"{name.partition(': ')[2]}\n{n} case{'s' if n != 1 else ''}"
        for name, n in zip(names, counts, strict=True)
    ]
    ax.set_xticks(range(len(names)), labels)
    ax.set_xlim(-0.5, max(len(names), 1) - 0.5)
    ax.set(xlabel="measured gap over noise", ylim=(-0.02, 1.02))
    if names:
        ax.legend(frameon=False)
    return Picture(
        f"{score.name}_severity", f"Single effects by severity, {score.name}",
        "Gap over noise as measured on the reality with and without the effect; 95 % intervals.",
        figure,
    )  # fmt: skip


def confusion_picture(score: Score) -> Picture:
    """Truth down, first choice across."""
    matrix = confusion(score.cases)
    counts = np.array([[row[column] for column in COLUMNS] for row in matrix.values()], dtype=float)
    figure, (ax,) = new_figure(1, 1.6 + 0.26 * max(len(matrix), 4))
    ax.grid(False)
    totals = counts.sum(axis=1, keepdims=True) if matrix else np.ones((1, 1))
    ax.imshow(counts / totals if matrix else [[0.0]], cmap="Blues", vmin=0.0, vmax=1.0,
              aspect="auto")  # fmt: skip
    for i, j in np.argwhere(counts > 0) if matrix else []:
        dark = counts[i, j] > 0.5 * totals[i, 0]
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7,
                color="white" if dark else "black")  # fmt: skip
    ax.set_xticks(range(len(COLUMNS)), COLUMNS, rotation=90, fontsize=7)
    ax.set_yticks(range(len(matrix)), list(matrix), fontsize=7)
    ax.set(xlabel="first choice", ylabel="truth")
    return Picture(
        f"{score.name}_confusion", f"Confusion matrix of {score.name}",
        "Number of cases; the shade is the share of the row.", figure,
    )  # fmt: skip


def shrinkage_pictures(score: Score) -> list[Picture]:
    """Claimed against true shrinkage, with the claimed 90 % intervals; none without claims."""
    claims = [case.claim for case in score.cases]
    rows = [(said, true) for said, true in filter(None, claims) if math.isfinite(true)]
    if not rows:
        return []
    figure, (ax,) = new_figure(1, 4.4)
    true, said = np.array([t for _, t in rows]), np.array([c.fraction for c, _ in rows])
    ends = np.array([[c.fraction - c.ci90[0], c.ci90[1] - c.fraction] for c, _ in rows]).T
    ax.errorbar(100 * true.clip(-0.5), 100 * said.clip(-0.5), yerr=100 * ends.clip(0.0), fmt="o",
                ms=3, lw=0.7, color=MEASURED)  # fmt: skip
    ax.plot([-50, 100], [-50, 100], color=FAINT, lw=1)
    ax.set(xlim=(-52, 102), ylim=(-52, 102), xlabel="true shrinkage [%]",
           ylabel="claimed shrinkage [%]")  # fmt: skip
    return [
        Picture(
            f"{score.name}_shrinkage", f"Claimed and true shrinkage, {score.name}",
            "Share of the reducible gap that is gone: claimed on the hold-out record with its 90 % "
            "interval, and true on a drive nobody saw, without noise. Values below -50 % are drawn "
            "there.", figure,
        )
    ]  # fmt: skip


# --- The result of an examination as pages: HTML with figures, and Markdown for a repository.

NOTES = "## Notes"
_CHALLENGER = "diagnosis"
_MOST_SHOWN = 4
_NUMBERS = frozenset(range(1, 4))


def commands(cases: CaseSet, papers: Sequence[Paper], target: str) -> list[str]:
    """The command lines that lead to a result."""
    lines = [f"./bench blind make --seed {cases.seed} --n {len(cases.names)} --out cases"]
    for paper in papers:
        if paper.name.endswith(FOLLOWED_UP):
            continue
        words = paper.examination.program
        rival = f" --rival {paper.name}" if "rival" in words else ""
        other = "" if rival or paper.name == _CHALLENGER else f" --program '{' '.join(words)}'"
        lines.append(f"./bench blind run cases{rival}{other}")
    return [*lines, f"./bench blind score cases {target}"]


def write_page(
    directory: str | Path, cases: CaseSet, papers: Sequence[Paper], scores: Sequence[Score]
) -> Path:
    """Write the HTML page; its path.

    Raises:
        InputError: the folder cannot be written.
    """
    made_by = commands(cases, papers, f"--page {directory}")
    made = Made(made_by[-1], [str(cases.root / MANIFEST)])
    sections = [
        Section(
            "Side by side",
            paragraphs=[summary(score) for score in scores],
            notes=_comparison(scores),
            tables=[Table(*_side_by_side(scores))],
        ),
        *(_section(score) for score in scores),
        Section("Definitions", tables=[Table(("measure", "what counts"), _definitions())]),
        Section("Commands", paragraphs=made_by),
        made.section(),
    ]
    head = f"{_head(cases)} {made.when:%Y-%m-%d}."
    return write_report(directory, "The withheld-effect check", head, sections)


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
        f"{len(cases.names)} cases of seed {cases.seed} ({cases.split}), sma_bench {VERSION}, "
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
    rivals = [score for score in scores if not score.name.startswith(_CHALLENGER)]
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


def _tables(score: Score) -> list[ResultTable]:
    """What is measured, and what was chosen instead of the truth."""
    header = ("truth", "cases", "most frequent first choices")
    return [*tables(score), ("truth against first choice", header, _choices(score))]


def _choices(score: Score) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for truth, row in confusion(score.cases).items():
        chosen = sorted((name for name in row if row[name]), key=lambda name: -row[name])
        shown = ", ".join(f"{row[name]} {name}" for name in chosen[:_MOST_SHOWN])
        more = len(chosen) - _MOST_SHOWN
        rows.append((truth, str(sum(row.values())), shown + (f", {more} more" if more > 0 else "")))
    return rows


def _section(score: Score) -> Section:
    shown = [
        Table(header, rows, _NUMBERS, title=f"{title[:1].upper()}{title[1:]}")
        for title, header, rows in _tables(score)
    ]
    failed = [f"{c.label.id}: {c.failure}" for c in score.cases if c.answer is None]
    notes = [f"{len(failed)} cases failed, the first {failed[0]}"] if failed else []
    return Section(score.name, notes=notes, tables=shown, pictures=pictures(score))


def _definitions() -> list[tuple[str, str]]:
    return [(m.name, m.definition) for m in (*TARGETS, *OTHERS) if m.definition]


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---"] * len(header), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]

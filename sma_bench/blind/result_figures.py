"""Figures of the result page: how sure, how right, what for what, by how much."""

import math

import numpy as np

from sma_bench.blind.breakdown import COLUMNS, confusion, groups, reliability
from sma_bench.blind.score import Score
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, SECOND, new_figure
from sma_bench.report.page import Picture

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
    for k, measure in enumerate(_SHOWN):
        rows = [by_group[name][measure] for name in names]
        value = np.array([row.value for row in rows])
        ends = np.array([[row.value - row.low, row.high - row.value] for row in rows]).T
        place = np.arange(len(names)) + 0.12 * (k - 1)
        if names:
            ax.errorbar(place, value, yerr=ends.clip(0.0), fmt="o-", color=_COLOURS[k],
                        capsize=3, label=measure)  # fmt: skip
    labels = [
        f"{name.partition(': ')[2]}\n{by_group[name][_SHOWN[0]].n} cases" for name in names
    ]
    ax.set_xticks(range(len(names)), labels)
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

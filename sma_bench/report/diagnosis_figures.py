"""Figures of a diagnosis: courses before and after, candidates, evidence, shrinkage."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sma_bench.diagnose import Diagnosis
from sma_bench.diagnose.decision import JOIN, NO_GAP, RECALIBRATION, UNEXPLAINED, Candidate
from sma_bench.diagnose.sizes import sample_noise
from sma_bench.estimation.observation import BinnedSignal, Observation
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS
from sma_bench.protocols import parse_protocol
from sma_bench.report.diagnosis_words import at_noise
from sma_bench.report.drawing import FAINT, MEASURED, MODEL, new_figure
from sma_bench.report.page import Picture
from sma_bench.results import scale_of

Array = NDArray[np.float64]

STAGE_COLOURS = {
    "electrical": "#b58900", "thermal": "#c0504d", "transformation": "#7a5195",
    "mechanical": "#2a7f62", "sensor": "#1f4e79",
}
_TWO_STAGES = "#4a4a4a"
_RIVALS = (RECALIBRATION, NO_GAP, UNEXPLAINED)
_MOST_BARS = 10
_LEAST_SHOWN = 0.005
_LINEAR = 3.0  # nats, within which the axis of evidence is linear
_AS_BAD = 20.0  # nats below recalibration, where bars are cut
_PROTOCOL_STEP = 0.05  # s


def course_pictures(result: Diagnosis) -> list[Picture]:
    """Measured against simulated, before and after: a picture a quantity of the held-out data."""
    pictures = []
    for quantity in result.shrinkage:
        obs = next(v for v in result.held_out if quantity in v.quantities)
        pictures.append(_courses(result, obs, quantity))
    return pictures


def candidate_picture(result: Diagnosis) -> Picture:
    """Probabilities of the candidates."""
    shown = [
        c for k, c in enumerate(result.decision.candidates)
        if c.name in _RIVALS or (k < _MOST_BARS and c.probability >= _LEAST_SHOWN)
    ]
    figure, (ax,) = new_figure(height=1.2 + 0.32 * len(shown))
    credible = {c.name for c in result.decision.credible}
    place = np.arange(len(shown))[::-1]
    colours = [_colour(c.effects) for c in shown]
    ax.barh(place, [c.probability for c in shown], color=colours, height=0.7)
    for y, c in zip(place, shown, strict=True):
        ax.text(c.probability + 0.01, y, f"{c.probability:.3f}", va="center", fontsize=8)
    ax.set_yticks(place, [f"{c.name} *" if c.name in credible else c.name for c in shown])
    ax.set(xlabel="probability", xlim=(0.0, 1.12))
    _stage_legend(ax, [c for c in shown if c.effects])
    caption = (
        "They sum to 1 over all effects, their pairs, and three rivals that name no effect. "
        "Marked *: the fewest that make 90 % together."
    )
    return Picture("diagnosis_candidates", "Candidates", caption, figure)


def evidence_picture(result: Diagnosis) -> Picture:
    """What each effect alone, and the best pairs, would explain."""
    search = result.search
    base = search.recalibrated.evidence
    gains = {name: search.gain(name) for name in search.ranked}
    gains |= {
        JOIN.join(pair): fit.evidence - base for pair, fit in search.pairs.items()
        if fit.evidence - base > max(gains.values(), default=0.0)
    }
    gains["response of free form"] = search.flexible.gain
    ranked = sorted(gains, key=lambda name: gains[name], reverse=True)
    figure, (ax,) = new_figure(height=1.2 + 0.28 * len(ranked))
    place = np.arange(len(ranked))[::-1]
    colours = [_colour([part for part in n.split(JOIN) if part in EFFECTS]) for n in ranked]
    ax.barh(place, [gains[n] for n in ranked], color=colours, height=0.7)
    ax.set_xscale("symlog", linthresh=_LINEAR)
    ax.set_xlim(left=max(min(gains.values()), -_AS_BAD), right=1.5 * max(*gains.values(), _LINEAR))
    ax.axvline(0.0, color=FAINT, lw=0.8)
    ax.set_yticks(place, ranked, fontsize=8)
    ax.set_xlabel("log evidence over recalibration alone [nats]")
    caption = (
        "Each effect fitted together with all parameters, its freedom charged (Laplace). Below 0: "
        f"the records do better without it (cut at {-_AS_BAD:g}). Pairs are shown where they beat "
        "every single effect. The response of free form names nothing; what it gains beyond the "
        "best effect is structure that the library does not have."
    )
    return Picture("diagnosis_evidence", "What each candidate would explain", caption, figure)


def shrinkage_picture(result: Diagnosis) -> Picture:
    """Errors before and after against the noise, and the share of the gap that is gone."""
    names = list(result.shrinkage)
    found = [result.shrinkage[name] for name in names]
    figure = Figure(figsize=(7.2, 1.4 + 0.6 * len(names)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(names))[::-1]
    before = [s.rmse_before / s.noise_floor for s in found]
    after = [s.rmse_after / s.noise_floor for s in found]
    left.barh(place + 0.18, before, height=0.34, color=FAINT, label="as believed")
    left.barh(place - 0.18, after, height=0.34, color=MODEL, label="improved")
    left.axvline(1.0, color=MEASURED, lw=1.2, ls="--", label="noise floor")
    left.set_xscale("log")
    left.set_yticks(place, names)
    left.set_xlabel("rms error over the sensor's noise")
    left.legend(fontsize=8)
    left.set_xlim(left=0.7)
    for y, s in zip(place, found, strict=True):
        if at_noise(s):
            right.text(50.0, y, "was at its noise", ha="center", va="center", fontsize=8)
            continue
        ends = np.abs(np.array(s.ci90) - s.fraction)[:, np.newaxis]
        right.errorbar(
            [100.0 * s.fraction], [y], xerr=100.0 * ends, fmt="o", color=MODEL, capsize=4, ms=5
        )
    right.axvline(100.0, color=MEASURED, lw=1.2, ls="--")
    right.axvline(0.0, color=FAINT, lw=0.8)
    right.set_xlabel("gap that is gone [%], 90 % interval")
    for ax in (left, right):
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    caption = (
        "On data that no fit saw. Fraction: 1 - sqrt((after² - noise²)/(before² - noise²)), "
        "so that a perfect model reaches 100 %, whatever the sensor; interval by drawing "
        "stretches of time anew."
    )
    return Picture("diagnosis_shrinkage", "How far the gap shrinks", caption, figure)


def next_experiment_picture(result: Diagnosis, parameters: Parameters) -> Picture | None:
    """Voltages of the proposed protocol; None where there is none.

    Raises:
        InputError: the protocol cannot be run on this rig.
    """
    if result.next_experiment is None:
        return None
    protocol = parse_protocol(result.next_experiment.protocol, parameters)
    time, voltage = protocol.sample(_PROTOCOL_STEP)
    sides = np.array(parameters["bench.channel_sides"])
    figure, (ax,) = new_figure(height=2.8)
    for side, colour in zip(dict.fromkeys(sides), (MEASURED, MODEL), strict=False):
        ax.plot(time, voltage[:, sides == side].max(axis=1), color=colour, lw=1.2, label=side)
    ax.set(xlabel="time [s]", ylabel="voltage [V]")
    ax.legend(fontsize=8)
    separates = ", ".join(result.next_experiment.separates)
    caption = f"Separates {separates}; within the bench's limits, as the experiment node runs it."
    return Picture("diagnosis_next_experiment", "The next experiment", caption, figure)


def _courses(result: Diagnosis, obs: Observation, quantity: str) -> Picture:
    unit, factor = scale_of(quantity)
    shown = _worst_of_sides(result, obs, quantity)
    figure = Figure(figsize=(7.2, 0.8 + 2.9 * len(shown)), layout="constrained")
    axes = figure.subplots(
        2 * len(shown), 1, sharex=True, gridspec_kw={"height_ratios": (1.6, 1.0) * len(shown)}
    )
    for k, (signal, old, new) in enumerate(shown):
        course, error = axes[2 * k : 2 * k + 2]
        course.plot(signal.time, factor * signal.value, color=MEASURED, lw=2.6, alpha=0.45,
                    label="measured")
        course.plot(signal.time, factor * old, color=FAINT, lw=1.0, ls="--", label="as believed")
        course.plot(signal.time, factor * new, color=MODEL, lw=1.0, label="improved")
        course.set_ylabel(f"[{unit}]")
        course.set_title(signal.name, loc="left", fontsize=9)
        _error(error, result, (signal, factor * old, factor * new))
        error.set_ylabel(f"error [{unit}]")
    axes[0].legend(
        fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False
    )
    axes[-1].set_xlabel("time [s]")
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.spines[["top", "right"]].set_visible(False)
    caption = (
        f"{obs.path}, held out; means over {shown[0][0].period:.2g} s; of each side the signal "
        "with the largest error. Error: measured less simulated, the band is twice the noise of a "
        "sample. The improved parameters are those of --out, fitted to all records."
    )
    return Picture(
        f"diagnosis_{quantity}", f"Measured and simulated {quantity}", caption, figure,
        over_time=True,
    )


def _worst_of_sides(
    result: Diagnosis, obs: Observation, quantity: str
) -> list[tuple[BinnedSignal, Array, Array]]:
    """Of each side the signal that the belief misses most, with its readings before and after."""
    before = obs.readings(obs.simulate(result.parameters))
    after = obs.readings(obs.simulate(result.improved))
    worst: dict[str, tuple[float, tuple[BinnedSignal, Array, Array]]] = {}
    for signal, old, new in zip(obs.signals, before, after, strict=True):
        if signal.quantity == quantity:
            miss = float(np.mean((signal.value - old) ** 2))
            side = obs.sides[signal.wire]
            if side not in worst or miss > worst[side][0]:
                worst[side] = (miss, (signal, old, new))
    return [row for _, row in worst.values()]


def _error(ax: Axes, result: Diagnosis, row: tuple[BinnedSignal, Array, Array]) -> None:
    """Differences in the unit on paper, which `row` has already."""
    signal, old, new = row
    factor = scale_of(signal.name).factor
    noise = 2.0 * factor * sample_noise(result.model.problem, signal.name)
    ax.axhspan(-noise, noise, color=FAINT, alpha=0.18, lw=0)
    ax.plot(signal.time, factor * signal.value - old, color=FAINT, lw=1.0, ls="--")
    ax.plot(signal.time, factor * signal.value - new, color=MODEL, lw=1.0)


def _colour(effects: Sequence[str]) -> str:
    stages = {EFFECTS[name].stage for name in effects}
    if not stages:
        return FAINT
    return STAGE_COLOURS[stages.pop()] if len(stages) == 1 else _TWO_STAGES


def _stage_legend(ax: Axes, candidates: Sequence[Candidate]) -> None:
    shown = {}
    for candidate in candidates:
        stages = dict.fromkeys(EFFECTS[name].stage for name in candidate.effects)
        shown[" and ".join(stages)] = _colour(candidate.effects)
    for label, colour in shown.items():
        ax.barh([0.0], [0.0], color=colour, label=label)
    if shown:
        ax.legend(fontsize=8, loc="lower right", title="stage", title_fontsize=8)

"""How large a case's effects are, and whether another explanation could look the same."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from examination.blind import cases, rigs
from examination.blind.case_files import RECALIBRATION
from examination.blind.cases import EFFECTS, QUANTITIES, Case, Draw, Symptom
from examination.blind.rigs import COARSE, RECORDS, Stage, gaps, quantity_of
from sma_bench.parameters.parameters import load_kind

Array = npt.NDArray[np.float64]

Features = Mapping[str, float]
Readings = Mapping[str, Mapping[str, Array]]
ALL_QUANTITIES = QUANTITIES["all"]
# Features that a mildly different kinetics moves together, at amount 1.
MILD_KINETICS = {"grain_spread": 1.2, "kinetics_smoothness": 0.5}
_SHRINK = 0.8
_TRIALS = 8


@dataclass(frozen=True)
class Sized:
    """What a case's world holds: features without what is hidden (`base`: nuisances and mild
    kinetics) and with it, draws and amounts by effect, measured gaps, the larger of both records.
    """

    base: dict[str, float]
    features: dict[str, float]
    draws: dict[str, Draw]
    amounts: dict[str, float]
    nuisance_gap: float
    kinetics_gap: float

    def without(self, effect: str) -> dict[str, float]:
        """Features of a world in which this one effect is not there."""
        features = dict(self.base)
        for name, drawn in self.draws.items():
            if name != effect:
                features = drawn.features(features, self.amounts[name])
        return features


def size(case: Case) -> Sized:
    """Find the features of a case: nuisances below their limit, effects at their targets."""
    # The rig's nuisances at their wanted gap.
    wanted, scale = case.nuisance_gap, 1.0
    little: dict[str, float] = {}
    nuisance_gap = 0.0
    for trial in range(_TRIALS):
        scaled = {name: scale * value for name, value in case.nuisances.items()}
        reached = measured(case, scaled, {}, fine=COARSE if trial == 0 else 1.0)
        if trial and reached <= cases.NUISANCE_LIMIT:
            little, nuisance_gap = scaled, reached
            break
        # The gap grows with the scale or its square: down by the root stays above nothing.
        scale *= wanted / reached if trial == 0 else min(wanted / reached, _SHRINK)

    # A transformation smoother by the wanted gap.
    base, kinetics_gap = dict(little), 0.0
    if case.card.mild_kinetics:
        rng = case.stream("effect")
        parts = {name: value * rng.uniform(0.3, 1.0) for name, value in MILD_KINETICS.items()}

        def smoother(amount: float) -> dict[str, float]:
            added = {name: little.get(name, 0.0) + amount * part for name, part in parts.items()}
            smoothness = min(added["kinetics_smoothness"], 1.0)
            return {**little, **added, "kinetics_smoothness": smoothness}

        amount = 1.0
        for _ in range(3):
            reached = measured(case, smoother(amount), little, fine=COARSE)
            # Smoothing acts by its variance: the gap grows between the first and second power.
            amount *= float(np.clip((case.mild_gap / reached) ** 0.7, 0.2, 3.0))
        base = smoother(amount)
        kinetics_gap = measured(case, base, little)

    # What is hidden, at its target or as it comes.
    rng, quantities = case.stream("effect"), QUANTITIES[case.card.signals]
    features, draws, amounts = dict(base), {}, {}
    for name, target in zip(case.card.effects, case.card.targets, strict=True):
        drawn = cases.draw({**EFFECTS, **cases.OUTSIDE}[name], rng, case.peak_current())
        natural = drawn.natural(rng)
        amount = natural
        if target is not None:
            def gap(amount: float, drawn: Draw = drawn) -> float:
                return measured(case, drawn.features(base, amount), base, quantities, COARSE)

            amount = cases.amount_for(drawn, target, gap, natural)
        features = drawn.features(features, amount)
        draws[name], amounts[name] = drawn, amount
    return Sized(base, features, draws, amounts, nuisance_gap, kinetics_gap)


def measured(
    stage: Stage, features: Features, other: Features,
    quantities: tuple[str, ...] = ALL_QUANTITIES, fine: float = 1.0,
) -> float:
    """Gap over noise between two worlds: the largest over signals and records."""
    found = 0.0
    for record in RECORDS:
        one, two = (stage.read(f, record, fine) for f in (features, other))
        found = max(found, *gaps(one, two, stage.sensors, quantities).values())
    return found


# --- Could another explanation look the same? Measured with the reality's own sensitivities.
#
# The difference that an effect makes is whitened by the true noise and compared with every rival:
# each other effect of the contract, refitted in size and shape, and wrong parameters alone, the
# parameters being refitted under their stated uncertainty each time. What no refit takes away, in
# standard deviations, is the distance to that rival.

# Squared distance above which two explanations are distinguishable: five standard deviations.
DISTINCT = 25.0
_WINDOW = 10  # samples of 20 ms to a mean: 5 Hz
_STEP = 0.5  # stated standard deviations
_TINY = 1e-12
_SHAPES = (0.25, 0.75)  # places within the range of a setting


def separation(
    stage: Stage, base: Features, truth: Readings, without: Readings, quantities: tuple[str, ...],
    own: str = "",
) -> dict[str, Any]:
    """Distances [standard deviations] of one difference from every rival explanation, the closest
    rival with its own, and whether every rival is out of reach.

    Args:
        base: features without the effect; truth, without: noise-free readings by record, with and
            without what is hidden; own: the effect itself, no rival of its own.
    """
    sensors, width = stage.sensors, _WINDOW * rigs.COMMAND_PERIOD

    def whitened(one: Readings, other: Readings) -> Array:
        """(m,) difference in windows of all signals of both records, of unit white noise."""
        parts = []
        for record in RECORDS:
            for name in sorted(one[record]):
                quantity = quantity_of(name)
                if quantity not in quantities:
                    continue
                values = one[record][name] - other[record][name]
                n = len(values) // _WINDOW
                means = np.asarray(values[: n * _WINDOW].reshape(n, _WINDOW).mean(axis=1))
                samples = sensors.rate(quantity) * width * (1.0 - sensors.dropout)
                # Rounding is noise like the rest; that it is white makes next to no difference.
                noise = replace(sensors.noise[quantity], std=sensors.std(quantity))
                parts.append(noise.whiten_means(means, width, samples))
        return np.concatenate(parts)

    origin = {record: stage.read(base, record, COARSE) for record in RECORDS}
    difference, load = whitened(truth, without), load_kind(stage.truth)
    # What a stated standard deviation of each parameter does, all under their uncertainty.
    columns = []
    for name in rigs.recalibrated(load):
        step = _STEP * rigs.numbers(load)[name].stated_std(stage.truth[name])
        twins = (rigs.FRONT, rigs.BACK) if name == rigs.FRONT else (name,)
        moved = stage.truth.replace({n: stage.truth[n] + step for n in twins})
        changed = {r: stage.read(base, r, COARSE, parameters=moved) for r in RECORDS}
        columns.append(whitened(changed, origin) / _STEP)
    prior = np.vstack([np.column_stack(columns), np.eye(len(columns))])
    free = np.linalg.qr(prior)[0]

    def beyond_parameters(columns: Array) -> Array:
        """What a refit of the parameters under their uncertainty leaves of (m, k) columns."""
        padded = np.vstack([columns, np.zeros((prior.shape[1], columns.shape[1]))])
        return padded - free @ (free.T @ padded)

    rest = beyond_parameters(difference[:, None])[:, 0]
    distances = {RECALIBRATION: float(np.linalg.norm(rest))}
    for name in cases.possible(EFFECTS, load):
        symptom = EFFECTS[name]
        if name == own or not (symptom.in_deflection or "temperature" in quantities):
            continue
        columns = [
            whitened({r: stage.read(features, r, COARSE) for r in RECORDS}, origin)
            for features in _varieties(symptom, base)
        ]
        free_of = beyond_parameters(np.column_stack(columns))
        # What the columns cannot explain, those of one direction in that direction only.
        if free_of.shape[1] == 1:
            square = float(np.sum(free_of**2))
            share = float(free_of[:, 0] @ rest) / max(square, _TINY)
            if symptom.signs in ((1,), (-1,)):
                share = max(share, 0.0)
            left = rest - share * free_of[:, 0]
        else:
            basis, spread, _ = np.linalg.svd(free_of, full_matrices=False)
            basis = basis[:, spread > spread[0] * _TINY]
            left = rest - basis @ (basis.T @ rest)
        distances[name] = float(np.linalg.norm(left))
    rival = min(distances, key=lambda name: distances[name])
    return {
        "rival": rival,
        "distance": round(distances[rival], 3),
        "distances": {name: round(value, 3) for name, value in distances.items()},
        "distinguishable": distances[rival] ** 2 > DISTINCT,
    }


def _varieties(symptom: Symptom, base: Features) -> Iterator[dict[str, float]]:
    """Worlds with one feature of the effect, in each of its shapes, at the small end of its natural
    size."""
    amount = symptom.signs[0] * symptom.natural[0]
    shapes: list[dict[str, float]] = [
        {name: s.low * (s.high / s.low) ** share for name, s in symptom.settings.items()}
        for share in (_SHAPES if symptom.settings else _SHAPES[:1])
    ]
    for k, (name, move) in enumerate(symptom.moves.items()):
        moved = move.moved(name, base, amount * max(move.weight, key=abs))
        for shape in shapes if k == 0 else shapes[:1]:
            yield {**base, **shape, name: moved}

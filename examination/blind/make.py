"""Makes a set of cases: sizes of the hidden effects, distances from other explanations, bags,
stated parameters, and sealed labels."""

import json
import shutil
from collections import namedtuple
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import joblib
import numpy as np

from examination.bags import in_sqlite3
from examination.blind import cases, rigs
from examination.blind.case_files import CASES, LABELS, MANIFEST, RECALIBRATION, STAGE_OF, seal
from examination.blind.cases import EFFECTS, NONE, OUTSIDE, QUANTITIES, Case, Draw, Symptom
from examination.blind.judgement import WORTH_NAMING
from examination.blind.reality import BY_NAME
from examination.blind.rigs import COARSE, RECORDS, Stage, gaps, quantity_of
from sma_bench.arrays import Array
from sma_bench.errors import InputError
from sma_bench.installation import VERSION
from sma_bench.parameters import Parameters, write_parameters
from sma_bench.parameters.parameter import TRANSITIONS
from sma_bench.parameters.parameters import load_kind
from sma_bench.records.bag_writer import write_record

Features, Readings = Mapping[str, float], Mapping[str, Mapping[str, Array]]

# --- How large a case's effects are.
# Features that a mildly different kinetics moves together, at amount 1.
MILD_KINETICS = {"grain_spread": 1.2, "kinetics_smoothness": 0.5}
_SHRINK, _TRIALS = 0.8, 8
LAW_SHOWS = 2.0  # gap over noise from which another law counts as a cause

# Features of a case's world without what is hidden (`base`: nuisances and mild kinetics) and with
# it, draws and amounts by effect, measured gaps (the larger of both records).
Sized = namedtuple("Sized", "base features draws amounts nuisance_gap kinetics_gap")


def size(case: Case) -> Sized:
    """Find the features of a case: nuisances below their limit, effects at their targets."""
    # The rig's nuisances at their wanted gap.
    wanted, scale = case.nuisance_gap, 1.0
    little: dict[str, float] = {}
    nuisance_gap = 0.0
    for trial in range(_TRIALS):
        # Within their ranges: a clamped wire hardly shows some of them.
        scaled = {name: float(np.clip(scale * value, BY_NAME[name].low, BY_NAME[name].high))
                  for name, value in case.nuisances.items()}
        reached = measured(case, {**case.fixed, **scaled}, {}, fine=COARSE if trial == 0 else 1.0)
        if trial and reached <= cases.NUISANCE_LIMIT:
            little, nuisance_gap = scaled, reached
            break
        # The gap grows with the scale or its square; after the first trial the scale only shrinks.
        scale *= wanted / reached if trial == 0 else min(wanted / reached, _SHRINK)
    # A transformation smoother by the wanted gap.
    little = {**case.fixed, **little}
    base, kinetics_gap = dict(little), 0.0
    rng = case.stream("effect")
    if case.card.mild_kinetics:
        parts = {name: value * rng.uniform(0.3, 1.0) for name, value in MILD_KINETICS.items()}
        amount = 1.0
        for trial in range(4):
            base = dict(little)
            for name, part in parts.items():  # within its range, even if it shows too little
                base[name] = min(little.get(name, 0.0) + amount * part, BY_NAME[name].high)
            kinetics_gap = measured(case, base, little, fine=COARSE if trial < 3 else 1.0)
            # Smoothing acts by its variance: the gap grows between the first and second power.
            amount *= float(np.clip((case.mild_gap / kinetics_gap) ** 0.7, 0.2, 3.0))
    # The hidden effects, at their targets or natural amounts.
    rng, quantities = case.stream("effect"), QUANTITIES[case.card.signals]
    features, draws, amounts = dict(base), {}, {}
    for name, target in zip(case.card.effects, case.card.targets, strict=True):
        symptom = {**EFFECTS, **OUTSIDE}[name].in_form(case.forms.get(name, ""))
        drawn = cases.draw(symptom, rng, case.peak_current())
        amount = natural = drawn.natural(rng)
        if target is not None:

            def gap(amount: float, drawn: Draw = drawn) -> float:
                return measured(case, drawn.features(base, amount), base, quantities, COARSE)

            amount = cases.amount_for(drawn, target, gap, natural)
        features = drawn.features(features, amount)
        draws[name], amounts[name] = drawn, amount
    return Sized(base, features, draws, amounts, nuisance_gap, kinetics_gap)


def measured(stage: Stage, features: Features, other: Features,
             quantities: tuple[str, ...] = QUANTITIES[cases.ALL], fine: float = 1.0,
             records: Sequence[str] = RECORDS) -> float:
    """Gap over noise between two worlds: the largest over signals and records."""
    found = 0.0
    for record in records:
        one, two = (stage.read(f, record, fine) for f in (features, other))
        found = max(found, *gaps(one, two, stage.sensors, quantities).values())
    return found


# --- Could another explanation look the same? Measured with the reality's own sensitivities.
#
# The difference that an effect makes is whitened by the true noise and compared with every rival:
# each other effect of the contract, refitted in size and shape, and wrong parameters alone, with
# the parameters refitted under their stated uncertainty each time. The part that no refit explains,
# in standard deviations, is the distance to that rival. From cases.WITH_REFITS on, zeros of
# deflections are refitted, too, benches are not linearised, and rivals have all their forms.
# Squared distance above which two explanations are distinguishable: five standard deviations.
DISTINCT = 25.0
_WINDOW = 10  # samples of 20 ms per mean: 5 Hz
_STEP = 0.5  # stated standard deviations
_TINY = 1e-12
_SHAPES = (0.25, 0.75)  # places within the range of a setting
_ZERO = 1e-3  # m, of a deflection's sensor
_REFITS, _BETTER = 8, 0.99  # Gauss-Newton steps; halved unless the squares fall to this share


def separation(stage: Stage, base: Features, truth: Readings, without: Readings,
               quantities: tuple[str, ...], own: str = "", nominal: Parameters | None = None,
               refits: int = 0) -> dict[str, Any]:
    """Distances [standard deviations] of one difference from every rival explanation, the closest
    rival with its own, and whether every rival is out of reach. `base`: features without the
    effect; `truth`, `without`: noise-free readings of each record that is given, with and without
    what is hidden; `own`: the effect itself, no rival; `nominal`: stated parameters, if not
    those of the owners; `refits`: steps to the best-fitting parameters, with free zeros."""
    records, sensors, width = tuple(truth), stage.sensors, _WINDOW * rigs.COMMAND_PERIOD
    load = load_kind(stage.truth)

    def whitened(one: Readings, other: Readings) -> Array:
        """(m,) difference in windows of all signals of both records, of unit white noise."""
        parts = []
        for record in records:
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

    names = rigs.recalibrated(load)
    stated = [rigs.numbers(load)[n].stated_std(stage.truth[n]) for n in names]
    stds = [nominal.std(n) if nominal else std for n, std in zip(names, stated, strict=True)]

    def read(features: Features, numbers: Parameters) -> Readings:
        return {r: stage.read(features, r, COARSE, parameters=numbers) for r in records}

    def moved(numbers: Parameters, name: str, by: float) -> Parameters:
        twins = (rigs.FRONT, rigs.BACK) if name == rigs.FRONT else (name,)
        return numbers.replace({n: numbers[n] + by for n in twins})

    def directions(numbers: Parameters, here: Readings) -> Array:
        """(m, k) change by a standard deviation of each parameter, then of each zero."""
        found = []
        for name, std, wide in zip(names, stated, stds, strict=True):
            changed = read(base, moved(numbers, name, _STEP * std))
            found.append(whitened(changed, here) * wide / (_STEP * std))
        for r, signals in here.items() if refits else ():
            for signal in signals:
                if quantity_of(signal) == "deflection":
                    there = {n: v + _ZERO * (n == signal) for n, v in signals.items()}
                    found.append(whitened({**here, r: there}, here))
        return np.column_stack(found)

    # Fit all parameters under their uncertainty, starting from those of the bench.
    numbers, origin, difference = stage.truth, read(base, stage.truth), whitened(truth, without)
    here, columns = origin, directions(numbers, origin)
    x, prior = np.zeros(columns.shape[1]), np.eye(columns.shape[1])
    rest = np.concatenate([difference, x])
    share = 1.0
    for _ in range(refits):
        step = np.linalg.lstsq(np.vstack([columns, prior]), rest, rcond=None)[0]
        moves, there = x + share * step, stage.truth
        try:
            for name, wide, value in zip(names, stds, moves[: len(names)].tolist(), strict=True):
                there = moved(there, name, wide * value)
            found = read(base, there)
        except InputError:  # not a valid bench
            share *= 0.5
            continue
        left = difference - whitened(found, origin) - columns[:, len(names):] @ moves[len(names):]
        if left @ left + moves @ moves > _BETTER * (rest @ rest):
            share *= 0.5
            continue
        numbers, here, x, rest = there, found, moves, np.concatenate([left, -moves])
        columns, share = directions(numbers, here), 1.0
    free = np.linalg.qr(np.vstack([columns, prior]))[0]

    def beyond_parameters(columns: Array) -> Array:
        """The part of columns (m, k) that a refit of the parameters does not explain."""
        padded = np.pad(columns, ((0, len(free) - len(columns)), (0, 0)))
        return padded - free @ (free.T @ padded)

    rest = beyond_parameters(rest[:, None])[:, 0]
    distances = {RECALIBRATION: float(np.linalg.norm(rest))}
    for name in cases.possible(EFFECTS, load):
        symptom = EFFECTS[name]
        if name == own or not (symptom.in_deflection or "temperature" in quantities):
            continue
        forms = [symptom.in_form(form) for form in (symptom.forms if refits else ("",))]
        does = [whitened(read(features, numbers), here)
                for form in forms for features in _varieties(form, base)]
        free_of = beyond_parameters(np.column_stack(does))
        # The part that the columns cannot explain; some effects have one direction only.
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
    return {"rival": rival, "distance": round(distances[rival], 3),
            "distances": {name: round(value, 3) for name, value in distances.items()},
            "distinguishable": distances[rival] ** 2 > DISTINCT}


def _varieties(symptom: Symptom, base: Features) -> Iterator[dict[str, float]]:
    """Worlds with one feature of the effect in each of its shapes, at its least natural size."""
    amount = symptom.signs[0] * symptom.natural[0]
    shapes: list[dict[str, float]] = [
        {name: s.low * (s.high / s.low) ** share for name, s in symptom.settings.items()}
        for share in (_SHAPES if symptom.settings else _SHAPES[:1])]
    for k, (name, move) in enumerate(symptom.moves.items()):
        moved = move.moved(name, base, amount * max(move.weight, key=abs))
        for shape in shapes if k == 0 else shapes[:1]:
            yield {**base, **shape, name: moved}


def law_distances(stage: Stage, base: Features, quantities: tuple[str, ...]) -> tuple[float, float]:
    """Gap over noise, the largest over signals and records, between a rig's law and the best fit of
    two others: the cosine with its four temperatures, and any smooth law of a single grain, which
    has no inner loops of its own."""
    if not any(base.get(name, 0.0) for name in MILD_KINETICS):
        return 0.0, 0.0

    def readings(features: Features, parameters: Parameters | None = None) -> dict[str, Array]:
        played = {r: stage.read(features, r, COARSE, parameters) for r in RECORDS}
        return {f"{r}/{name}": values / stage.sensors.std(quantity_of(name))
                for r, read in played.items() for name, values in read.items()
                if quantity_of(name) in quantities}

    def stacked(one: Mapping[str, Array], other: Mapping[str, Array]) -> Array:
        return np.concatenate([one[name] - other[name] for name in other])

    wanted, temperatures = readings(base), list(TRANSITIONS.values())

    def nearest(smooth: bool) -> float:
        """Gauss-Newton steps, of which the best counts, because a temperature may overshoot."""
        fitted, best = stage.truth, np.inf
        features = {**base, "grain_spread": 0.0, "kinetics_smoothness": 0.5 * smooth}
        for _ in range(3 + 2 * smooth):
            found = readings(features, fitted)
            gap = max(float(np.sqrt(np.mean((wanted[n] - found[n]) ** 2))) for n in wanted)
            if gap >= best:
                break
            best = gap
            moves = [stacked(readings(features, fitted.replace({n: fitted[n] + 0.5})), found) / 0.5
                     for n in temperatures]
            here = features["kinetics_smoothness"]
            if smooth:
                step = 0.1 if here < 0.9 else -0.1
                other = {**features, "kinetics_smoothness": here + step}
                moves.append(stacked(readings(other, fitted), found) / step)
            by = np.linalg.lstsq(np.column_stack(moves), stacked(wanted, found), rcond=None)[0]
            if smooth:
                features["kinetics_smoothness"] = float(np.clip(here + by[4], 0.0, 1.0))
            changed = {n: fitted[n] + float(d) for n, d in zip(temperatures, by[:4], strict=True)}
            try:
                fitted = fitted.replace(changed)
            except InputError:  # not a valid wire
                break
        return best

    return nearest(smooth=False), nearest(smooth=True)


# --- A case's label, its bags, and a set of them in a new folder.
NOMINAL = "nominal.yaml"
_LAYOUT = 1


def make_label(case: Case, sized: Sized, records: Sequence[str] = RECORDS,
               nominal: Parameters | None = None) -> dict[str, Any]:
    """A label: what is hidden, and how far these records and stated numbers can show it."""
    card, load, quantities = case.card, load_kind(case.truth), QUANTITIES[case.card.signals]
    # Noise-free readings with and without what is hidden: the effect, or the owners' mistakes.
    mistaken = None
    if case.wrong:
        twins = {n for name in case.wrong for n in (name, name.replace("_front", "_back"))}
        mistaken = case.truth.replace({name: case.nominal[name] for name in twins})
    truth = {r: case.read(sized.features, r) for r in RECORDS}
    without = {r: case.read(sized.base, r, parameters=mistaken) for r in RECORDS}
    gap = {}
    for r in RECORDS:
        found = gaps(truth[r], without[r], case.sensors, quantities)
        gap[r] = {name: round(value, 4) for name, value in found.items()}
    severity = 0.0 if card.kind == NONE else max(max(gap[r].values()) for r in records)
    stages = [STAGE_OF.get(name) or OUTSIDE[name].stage for name in card.effects]
    if card.kind == RECALIBRATION:
        stages = sorted({rigs.numbers(load)[name].stage for name in case.wrong})
    # The gap that each effect adds to the others.
    severities = dict.fromkeys(card.effects, severity)
    for name in card.effects if len(card.effects) > 1 else ():
        others = dict(sized.base)
        for other, drawn in sized.draws.items():
            others = others if other == name else drawn.features(others, sized.amounts[other])
        its_gap = measured(case, sized.features, others, quantities, records=records)
        severities[name] = round(its_gap, 4)
    apart: dict[str, Any] = {}
    if card.kind not in (NONE, RECALIBRATION):
        own = card.effects[0] if len(card.effects) == 1 else ""
        seen = {r: truth[r] for r in records}
        refits = _REFITS if case.seed in cases.WITH_REFITS else 0
        apart = separation(case, sized.base, seen, without, quantities, own, nominal, refits)
    # Its place in the record that a diagnosis sees: signal with the largest gap; phase and side
    # with the largest share of that; stage of the largest effect; the twelve largest cells.
    place: dict[str, Any] | None = None
    if severity:
        first = RECORDS[0]
        table = rigs.where(truth[first], without[first], case, first, quantities)
        signal = max(gap[first], key=lambda name: gap[first][name])
        most = next(row for row in table if row["signal"] == signal)
        place = {"signal": quantity_of(signal), "channel": signal.rpartition(".")[0],
                 "phase": most["phase"], "side": most["side"], "stage": stages[0],
                 "table": [{**row, "gap": round(row["gap"], 4), "share": round(row["share"], 4)}
                           for row in table[:12]]}
    of_forms: dict[str, Any] = {}
    if case.forms:
        shown = (*card.effects, "kinetics", "noise", *cases.OF_ALL_RIGS)
        of_forms["forms"] = {n: case.forms[n] for n in shown if n in case.forms}
        law, loops = law_distances(case, sized.base, quantities)
        of_forms["law_distance"] = round(law, 4)
        of_forms["transformation_law"] = of_forms["law_distance"] > LAW_SHOWS
        if case.seed in cases.WITH_LOOPS:
            of_forms["loops_distance"] = round(loops, 4)
            of_forms["inner_loops"] = of_forms["loops_distance"] > WORTH_NAMING
        if case.seed in cases.WITH_REFITS:
            of_forms["beyond_parameters"] = apart.get("distances", {}).get(RECALIBRATION)
    return {"id": case.name, "kind": card.kind, "effects": list(card.effects), "stages": stages,
            "signals": card.signals, "noise": card.noise, "kinetics": card.mild_kinetics,
            "severity": severity, "severities": severities, "targets": list(card.targets),
            "amounts": dict(sized.amounts), "gap": gap,
            "nuisance_gap": round(sized.nuisance_gap, 4),
            "kinetics_gap": round(sized.kinetics_gap, 4), "wrong": dict(case.wrong), "where": place,
            "distinguishable": apart.pop("distinguishable", True), "separation": apart or None,
            "features": dict(sorted(sized.features.items())),
            "base": dict(sorted(sized.base.items())), "load": load,
            "truth": rigs.true_values(case.truth), "sensors": asdict(case.sensors),
            "drives": {name: vars(drive) for name, drive in case.drives.items()},
            "starts": dict(case.starts), "version": VERSION, **of_forms,
            **({"second_run": dict(case.second_run)} if case.second_run else {})}


def make_case(case: Case, folder: Path) -> dict[str, Any]:
    """Write the bags and the stated parameters of a case below `folder`; returns its label."""
    case = replace(case)  # a copy, whose cached simulations are freed with it
    sized = size(case)
    label, place = make_label(case, sized), folder / case.name
    shutil.rmtree(place, ignore_errors=True)  # a process that was killed may have left half of it
    place.mkdir()
    for record in RECORDS:
        signals = case.signals(sized.features, record)
        write_record(place / record, signals, case.namespace, case.starts[record])
        if case.storage == "sqlite3":
            in_sqlite3(place / record)
    write_parameters(place / NOMINAL, case.nominal, names=sorted(case.nominal.given))
    return label


def make(out: str | Path, seed: int, n: int, jobs: int = 1, load: str = "beam") -> dict[str, Any]:
    """Make n cases in a new folder, which appears when all are done; returns its manifest. The
    same seed and n give the same bytes, whatever the number of jobs. Raises InputError where the
    folder exists."""
    out = Path(out)
    if out.exists():
        raise InputError(f"{out}: exists already, expected a new folder")
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as parent:
        folder = Path(parent) / out.name
        (folder / CASES).mkdir(parents=True)
        due = cases.draw_cases(seed, n, load)
        if jobs > 1:
            labels = joblib.Parallel(jobs)(joblib.delayed(make_case)(case, folder / CASES)
                                           for case in due)
        else:  # joblib's own way in one process now and then lets an interrupt past its caller
            labels = [make_case(case, folder / CASES) for case in due]
        manifest = {"layout": _LAYOUT, "version": VERSION, "seed": seed, "n": n, "load": load,
                    "split": cases.split_of(seed), "cases": [label["id"] for label in labels],
                    "sha256": seal(folder / LABELS, labels)}
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
        folder.rename(out)
    return manifest

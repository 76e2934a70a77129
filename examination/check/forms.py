"""Do two forms of one effect differ, if one is fitted to the other?

Both act on one rig of the population with the drives of its two records. The true form causes a gap
of 30 times the noise (or the largest that its bounds allow); the size and shape parameters of the
other are fitted to it. If the residual over the noise, scaled to a gap of 30, is above 3 (median
over the rigs), the two forms count as different.

    ./bench check forms --json forms.json
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from examination.blind import cases
from examination.blind.cases import EFFECTS, QUANTITIES, Draw, draw_cases
from examination.blind.make import measured
from examination.blind.rigs import COARSE, RECORDS, quantity_of
from examination.pieces import IN_PIECES, in_pieces, options_of, print_table

GAP, APART = 30.0, 3.0  # times the noise
SEED = 3000
_TRIALS, _STARTS = 40, 12


def main(argv: Sequence[str] | None = None) -> int:
    own = {"rigs": (2, "that each pair is tried on"), "effect": ("", "only this one")}
    options = options_of("forms", __doc__, argv, **own, **IN_PIECES)
    names = [options.effect] if options.effect else list(EFFECTS)
    jobs = [(name, true, other, rig)
            for name in names for true in EFFECTS[name].forms for other in EFFECTS[name].forms
            for rig in range(options.rigs) if true != other]
    return report(jobs, in_pieces(try_forms, jobs, options))


def try_forms(name: str, true: str, other: str, rig: int) -> float:
    """Residual of the other form fitted to the true one, over the noise, at a gap of GAP."""
    case = draw_cases(SEED, rig + 1)[rig]
    rng = np.random.default_rng([SEED, rig])
    forms = (EFFECTS[name].in_form(form) for form in (true, other))
    one, two = (cases.draw(form, rng, case.peak_current()) for form in forms)
    quantities = QUANTITIES[cases.ALL]

    def gap(amount: float) -> float:
        return measured(case, one.features({}, amount), {}, quantities, COARSE)

    amount = cases.amount_for(one, GAP, gap, one.natural(rng))
    wanted = _stacked(case, one.features({}, amount))
    scale = GAP / max(gap(amount), 1e-9)
    # Fit the size and, within their ranges, the shape parameters of the other form.
    shapes = {n: s for n, s in two.symptom.settings.items() if s.high > s.low}
    low, high = np.log(two.symptom.natural[1] * 1e-3), np.log(two.symptom.natural[1] * 2.0)

    def left(x: Any, sign: int) -> Any:
        settings = dict(two.settings)
        for (n, s), place in zip(shapes.items(), x[1:].tolist(), strict=True):
            settings[n] = s.low + (s.high - s.low) * place
        drawn = Draw(two.symptom, sign, two.weights, settings, two.peak_current)
        return _stacked(case, drawn.features({}, float(np.exp(x[0])))) - wanted

    bounds = ([low] + [0.0] * len(shapes), [high] + [1.0] * len(shapes))
    best = wanted - _stacked(case, {})
    for sign in two.symptom.signs:
        tried = [np.array([at, *[0.5] * len(shapes)]) for at in np.linspace(low, high, _STARTS)]
        begin = min(tried, key=lambda x: float(np.sum(left(x, sign) ** 2)))
        found = least_squares(left, begin, bounds=bounds, args=(sign,), diff_step=0.03, x_scale=0.3,
                              max_nfev=_TRIALS)
        best = min(best, found.fun, key=lambda rest: float(rest @ rest))
    parts = np.split(best, np.cumsum([len(p) for p in _parts(case, {})])[:-1])
    return scale * max(float(np.sqrt(np.mean(part**2))) for part in parts)


def _parts(case: cases.Case, features: dict[str, float]) -> list[Any]:
    """Every signal of both records over its noise, at every tenth sample."""
    read = [case.read(features, record, COARSE) for record in RECORDS]
    return [v[::10] / case.sensors.std(quantity_of(n)) for found in read for n, v in found.items()]


def _stacked(case: cases.Case, features: dict[str, float]) -> Any:
    return np.concatenate(_parts(case, features))


def report(jobs: Sequence[tuple], found: Sequence[float]) -> int:
    left: dict[tuple[str, str], dict[str, list[float]]] = {}
    for (name, true, other, _), value in zip(jobs, found, strict=True):
        left.setdefault((name, true), {}).setdefault(other, []).append(value)
    print(f"residual of one form fitted by another, over the noise, at a gap of {GAP:g}")
    rows, alike, pairs = [], 0, 0
    for key, others in left.items():
        medians = {other: float(np.median(values)) for other, values in others.items()}
        alike += sum(median <= APART for median in medians.values())
        pairs += len(medians)
        rows.append((*key, ", ".join(f"{other} {value:.1f}" for other, value in medians.items())))
    print_table(("effect", "true form", "left, refitted as"), rows)
    print(f"{pairs - alike} of {pairs} differ by more than {APART:g}")
    return 0 if alike == 0 else 1

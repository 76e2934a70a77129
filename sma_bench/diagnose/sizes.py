"""How large a gap is over the sensors' noise, where it lies, how far it shrinks on held-out data.

    fraction = 1 - sqrt((after^2 - noise^2)/(before^2 - noise^2))

counts only the part of the gap that is not noise: a perfect model reaches 1, whatever the sensor.
The models are simulated as by a user who loads their parameters, without the zeros, delays or jump
times of a fit. Drift counts as noise only up to the least that a candidate needs, or a usual
instrument has, because errors of a model are slow too."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sma_bench.arrays import Array
from sma_bench.compiled import in_threads
from sma_bench.diagnose.result import JOIN, Cell, Shrinkage
from sma_bench.diagnose.search import Search
from sma_bench.estimation.noise_model import Noise
from sma_bench.estimation.observation import Observation
from sma_bench.estimation.residual import DRIFT_EFFECT, Block, Problem
from sma_bench.estimation.rig import DRIVEN
from sma_bench.estimation.solver import Fit
from sma_bench.parameters import Parameters
from sma_bench.physics.effects import EFFECTS

_BLOCK = 8.0  # s, block of the bootstrap, longer than any sensor's memory
_DRAWS, _SEED = 400, 1  # of the bootstrap
_SMALLEST = 0.3  # of the noise: below it there is no gap to shrink
_BETWEEN_DRIVES = 0.4  # standard deviation of the log of the remaining share, between drives
_AT_LEAST = 0.007  # standard deviation of that share in addition
_SHARE = "effect.residual_strain.share"
REMARK = 0.1  # share of the gap below which a partner is a remark, not a second cause


def contribution(fitted: Fit, names: Sequence[str]) -> Array:
    """(n,) added to the readings by effects of a fit, without what parameters `beside` explain."""
    problem, known = fitted.problem, fitted.unknowns.names
    off = {p.name: p.default for name in names for p in EFFECTS[name].parameters}
    added = fitted.predicted - problem.predict(fitted.parameters.replace(off))
    for block in problem.of_signal("deflection") if DRIFT_EFFECT in names else ():
        added[block.rows] += problem.noise["deflection"].drift_in(fitted.residual[block.rows])
    beside = [known.index(p) for n in names for p in EFFECTS[n].beside if p in known]
    if beside:
        columns, whiten = fitted.derivatives[:, beside], problem.whiten
        added -= columns @ np.linalg.lstsq(whiten(columns), whiten(added), rcond=None)[0]
    return added


def sample_noise(problem: Problem, name: str) -> float:
    """Standard deviation of a sample: white noise, and drift unless an effect explains it."""
    signal, noise = next(problem.of_signal(name)).signal, problem.noise[name]
    white = noise.white / signal.noise * signal.scatter
    return float(white if noise.wanders else np.hypot(white, noise.drift))


def largest_gap(problem: Problem, difference: Array) -> float:
    """Largest root mean square over noise of a difference (n,), of all signals and records."""
    return max(float(np.sqrt(np.mean(difference[b.rows] ** 2)))
               / sample_noise(problem, b.signal.name)
               for b in problem.blocks)


def locate(problem: Problem, difference: Array) -> list[Cell]:
    """Cells of a difference (n,) in the signals' units; the largest share first, then by time."""
    sums = defaultdict[tuple[str, str, str], Array](lambda: np.zeros(3))
    for block in problem.blocks:
        signal, part = block.signal, difference[block.rows]
        noise = sample_noise(problem, signal.name)
        phase, side = block.observation.phase_of(signal.time), _sides(block)
        for p, s in dict.fromkeys(zip(phase.tolist(), side.tolist(), strict=True)):
            here = (phase == p) & (side == s)
            power = np.sum(part[here] ** 2 * signal.count[here])
            sums[signal.name, p, s] += signal.count[here].sum(), power, power / noise**2
    total = sum(energy for *_, energy in sums.values()) or 1.0
    cells = [Cell(*key, float(np.sqrt(energy / count)), float(energy / total),
                  float(np.sqrt(power / count))) for key, (count, power, energy) in sums.items()]
    return sorted(cells, key=lambda cell: -round(cell.share, 9))


def _sides(block: Block) -> NDArray[np.str_]:
    """The wire's own side; for the deflection the side driven last; "" where there is but one."""
    obs, time = block.observation, block.signal.time
    if len(set(obs.sides)) == 1:
        return np.full(len(time), "")
    if block.signal.quantity != "deflection":
        return np.full(len(time), obs.sides[block.signal.wire])
    largest = obs.voltage.max(axis=1)
    driven = largest > DRIVEN * max(float(largest.max()), 1e-9)
    last = np.maximum.accumulate(np.where(driven, np.arange(len(driven)), np.argmax(driven)))
    at = np.clip(np.searchsorted(obs.grid, time, side="right") - 1, 0, len(obs.grid) - 1)
    return np.array(obs.sides)[np.argmax(obs.voltage, axis=1)[last[at]]]


# --- How far it shrinks.


def shrinkage(observations: Sequence[Observation], nominal: Parameters, recalibrated: Parameters,
              improved: Parameters, noises: Mapping[str, Noise]) -> dict[str, Shrinkage]:
    """By quantity of the held-out data: with the parameters as stated, and those of fits without
    these data, without and with effects. `noises`: of the sensors, by signal."""
    # By quantity, a row a block: samples, the variance of their noise, sums of squares by model.
    found = defaultdict[str, list[Array]](list)
    for obs in observations:
        models = map(obs.by_signal, obs.predict([nominal, recalibrated, improved]).T)
        for signal, *readings in zip(obs.signals, *models, strict=True):
            noise = noises[signal.name]
            white = noise.white / signal.noise * signal.scatter  # of a sample
            which = np.floor((signal.time - signal.time[0]) / _BLOCK).astype(np.intp)
            _, which = np.unique(which, return_inverse=True)
            counts = np.bincount(which, signal.count)
            floor = float(white**2 + noise.drift**2)
            # A bin's mean hides most of its samples' white noise: it is added again.
            hidden = white**2 * (signal.count - 1.0)
            squares = [np.bincount(which, signal.count * (signal.value - model) ** 2 + hidden)
                       for model in readings]
            rows = np.column_stack([counts, np.full(len(counts), floor), *squares])
            found[signal.quantity].append(rows)
    return {quantity: _of_blocks(np.concatenate(rows)) for quantity, rows in found.items()}


def _of_blocks(rows: Array) -> Shrinkage:
    """The shrinkage over blocks (b, 5), with its interval by bootstrap."""
    counts, floors, squares = rows[:, 0], rows[:, 1], rows[:, 2:]

    def fraction(drawn: Any) -> float:
        total = counts[drawn].sum()
        noise = float((counts[drawn] * floors[drawn]).sum() / total)
        before, _, after = squares[drawn].sum(axis=0) / total - noise
        if before < _SMALLEST**2 * noise:
            return 0.0
        return float(1.0 - np.sqrt(max(after, 0.0) / before))

    random = np.random.default_rng(_SEED)
    draws = random.integers(0, len(counts), (_DRAWS, len(counts)))
    gone, value = np.array([fraction(drawn) for drawn in draws]), fraction(slice(None))
    factor, more = random.standard_normal((2, _DRAWS))
    left = (1.0 - gone) * np.exp(_BETWEEN_DRIVES * factor) + _AT_LEAST * more
    low, high = np.quantile(1.0 - left, [0.05, 0.95])
    total = float(counts.sum())
    before, recalibrated, after = np.sqrt(squares.sum(axis=0) / total).tolist()
    return Shrinkage(before, after, value,
                     (float(min(low, value)), float(min(max(high, value), 1.0))),
                     float(np.sqrt((counts * floors).sum() / total)), recalibrated)


def sensors_noise(model: Fit, candidates: Iterable[Fit]) -> dict[str, Noise]:
    """By signal, the noise model with no more drift than a candidate needs or is usual."""
    least = [fitted.problem.noise for fitted in candidates]
    return {name: replace(noise,
                          drift=min(noise.drift, noise.usual, *(n[name].drift for n in least)))
            for name, noise in model.problem.noise.items()}


# --- Inputs of the decision: gain, size and residual of every candidate.


@dataclass(frozen=True)
class Facts:
    """Inputs from one candidate, with an effect or two."""

    gain: float  # evidence over recalibration [nats]
    gap: float  # contribution over the noise of a sample
    unsteady: float  # scatter of its size between stretches of time, over that expected of noise
    own: float  # largest prior deviation of the effects' own numbers
    parts: dict[str, float]  # contribution of each effect, over noise


@dataclass(frozen=True)
class DecisionInputs:
    """Inputs from one search."""

    candidates: dict[str, Facts]
    moved: float  # gap between the parameters as stated and as recalibrated, over noise
    surprise: float  # of recalibration: squared prior deviations of the bench's parameters
    as_stated: float  # evidence of the parameters as stated over recalibration [nats]
    ratio: float  # `ResidualTest.ratio` and `ResidualTest.outlier` of the best candidate
    outlier: float
    beyond: float  # nats that a smooth response gains over the best
    input: float  # the same of a smooth input to some stage
    records: int
    curve: float = 0.0  # nats gained by a bent curve of the motion's sensor, or a mount that gives

    def remarks(self) -> dict[str, tuple[str, str]]:
        """Pairs whose effect of smaller gain adds almost nothing: (the other one, this one)."""
        found = {}
        for pair, facts in self.candidates.items():
            small, *main = sorted(facts.parts, key=lambda effect: self.candidates[effect].gain)
            if main and facts.parts[small] < REMARK * facts.parts[main[0]]:
                found[pair] = main[0], small
        return found


def decision_inputs(search: Search) -> DecisionInputs:
    """All inputs of the decision."""
    recalibrated, fits = search.recalibrated, effect_fits(search)
    moved = recalibrated.x[: recalibrated.unknowns.bench]
    # Below 0, strain is lost for good at the first pull, as where crimps straighten: that is no
    # effect of the wire, but a rival of each, as a sensor's bent curve is.
    lost = {n: f.evidence - recalibrated.evidence for n, f in fits.items()
            if "residual_strain" in f.unknowns.effects and f.parameters[_SHARE] < 0.0}

    def facts(name: str, fitted: Fit) -> Facts:
        effects, first = fitted.unknowns.effects, fitted.unknowns.baseline
        gap, gain = own_gap(fitted), fitted.evidence - recalibrated.evidence
        gain = min(gain, 0.0) if name in lost else gain
        parts = {e: own_gap(fitted, (e,)) for e in effects} if len(effects) > 1 else {name: gap}
        # Without a gain no size is compared, and a drifting zero has no constant size.
        unsteady = 1.0
        if effects != (DRIFT_EFFECT,) and gain > 0.0:
            unsteady = float(fitted.jackknifed[first] / fitted.std[first])
        own = float(np.max(np.abs(fitted.x[first:])))
        return Facts(gain, gap, unsteady, own, parts)

    return DecisionInputs(
        dict(zip(fits, in_threads(facts, list(fits.items())), strict=True)),
        largest_gap(recalibrated.problem, recalibrated.predicted - search.nominal.predicted),
        float(moved @ moved), search.nominal.evidence - recalibrated.evidence,
        search.left_by_best.ratio, search.left_by_best.outlier, search.beyond.gain,
        max(one.gain for one in search.inputs_by_best.values()), len(search.problem.observations),
        max(search.curve, lost.get("residual_strain", 0.0)))


def effect_fits(search: Search) -> dict[str, Fit]:
    return {**search.singles, **{JOIN.join(key): fit for key, fit in search.pairs.items()}}


def own_gap(fitted: Fit, names: tuple[str, ...] = ()) -> float:
    """Largest gap over noise due to the effects of a candidate, or to `names` of them."""
    return largest_gap(fitted.problem, contribution(fitted, names or fitted.unknowns.effects))

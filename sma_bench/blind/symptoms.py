"""Every effect as features of the reality: what moves, how far it goes in practice."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sma_bench.blind.answers import STAGE_OF
from sma_bench.blind.reality import BY_NAME

LOG, EVEN = "log", "even"


@dataclass(frozen=True)
class Move:
    """A feature that goes with the effect's amount a.

    Attributes:
        feature: of the reality.
        weight: it moves by a times a number of this range.
        factor: the amount is the logarithm of a factor on the feature instead of a step.
    """

    feature: str
    weight: tuple[float, float] = (1.0, 1.0)
    factor: bool = False


@dataclass(frozen=True)
class Setting:
    """A feature that shapes the effect whatever its amount."""

    feature: str
    low: float
    high: float
    spread: str = EVEN


@dataclass(frozen=True)
class Symptom:
    """One effect.

    Attributes:
        moves: the features it moves, the first one being the one that gives it its size.
        natural: smallest and largest amount to be met in practice.
        signs: the directions in which it can go.
        settings: that shape it.
        stage: where it acts.
        in_deflection: whether a record of voltages and deflection can show it at all.
        of_peak_current: its amount is a share of the record's largest current.
    """

    moves: tuple[Move, ...]
    natural: tuple[float, float]
    signs: tuple[int, ...] = (1,)
    settings: tuple[Setting, ...] = ()
    stage: str = ""
    in_deflection: bool = True
    of_peak_current: bool = False


_BOTH = (1, -1)

# The contract's effects; sizes of the literature (matrix: 1 to 90 times the wire's own heat
# capacity; sides: 0.15 to 0.24 W/(m K) over a hand's length; and so on).
EFFECTS: dict[str, Symptom] = {
    "phase_dependent_resistance": Symptom(
        (
            Move("resistance_austenite_change"),
            Move("resistance_temperature_coefficient", (0.0, 3e-3)),
        ),
        (0.05, 0.25), _BOTH,
    ),
    "supply_drop": Symptom((Move("supply_resistance"),), (0.05, 0.5)),
    "latent_heat": Symptom((Move("latent_heat"),), (4e3, 25e3)),
    "temperature_dependent_convection": Symptom(
        (Move("convection_by_correlation"),), (0.2, 1.0)
    ),
    "matrix_thermal_mass": Symptom(
        (Move("silicone_heat_capacity"),), (0.04, 3.4),
        settings=(Setting("silicone_share", 0.25, 0.75),),
    ),
    "side_heat_coupling": Symptom((Move("side_conductance"),), (0.01, 0.05)),
    "ambient_drift": Symptom(
        (Move("ambient_rate"), Move("ambient_wave", (-60.0, 60.0))), (3.3e-4, 8.3e-3), _BOTH
    ),
    "partial_transformation": Symptom((Move("return_point_memory"),), (0.2, 1.0)),
    "transition_drift": Symptom(
        (Move("transition_drift"), Move("plastic_strain", (0.0, 3e-4))), (0.5, 10.0), _BOTH,
        settings=(Setting("drift_cycles", 1.5, 8.0, LOG),),
    ),
    "stress_dependent_transition": Symptom(
        (
            Move("stress_influence_factor_austenite", factor=True),
            Move("stress_influence_factor_martensite", (0.5, 1.3), factor=True),
        ),
        (0.1, 0.6), _BOTH,
    ),
    "residual_strain": Symptom((Move("unrecovered_strain"),), (0.01, 0.3)),
    "viscoelastic_matrix": Symptom(
        (Move("matrix_relaxation"),), (0.05, 0.2),
        settings=(Setting("relaxation_time", 1.0, 100.0, LOG),),
    ),
    "opposing_wires": Symptom(
        (Move("opposing"),), (0.1, 1.0),
        settings=(Setting("detwinning_stress", 40e6, 150e6, LOG),),
    ),
    "side_asymmetry": Symptom((Move("stiffness_asymmetry"),), (0.05, 0.5), _BOTH),
    "slack": Symptom((Move("slack"),), (5e-4, 0.01)),
    "temperature_underfill": Symptom(
        (Move("spot_fill"),), (0.05, 0.6), (-1,), in_deflection=False
    ),
    "temperature_lag": Symptom((Move("camera_lag"),), (0.05, 2.0), in_deflection=False),
    "deflection_drift": Symptom((Move("deflection_drift"),), (2e-4, 1.75e-3), _BOTH),
}
EFFECTS = {
    name: Symptom(s.moves, s.natural, s.signs, s.settings, STAGE_OF[name], s.in_deflection)
    for name, s in EFFECTS.items()
}

# What no diagnosis has in its library.
OUTSIDE: dict[str, Symptom] = {
    "current_limit": Symptom(
        (Move("current_limit"),), (0.02, 0.4), stage="electrical", of_peak_current=True
    ),
    "contact_growth": Symptom((Move("contact_growth"),), (0.02, 0.6), stage="electrical"),
    "draught": Symptom(
        (Move("draught"),), (0.05, 1.0), stage="thermal",
        settings=(Setting("draught_seed", 0.0, 1e6),),
    ),
    "r_phase": Symptom((Move("r_phase"),), (0.03, 0.4), stage="transformation"),
    "transformation_lag": Symptom(
        (Move("transformation_lag"),), (0.05, 2.0), stage="transformation"
    ),
    "friction": Symptom((Move("friction"),), (1e-4, 3e-3), stage="mechanical"),
    "stiffening": Symptom((Move("stiffening"),), (10.0, 400.0), stage="mechanical"),
    "clamp_slip": Symptom(
        (Move("clamp_slip"),), (1e-4, 2e-3), _BOTH, stage="mechanical",
        settings=(Setting("clamp_slip_time", 20.0, 90.0),),
    ),
    "sensor_nonlinearity": Symptom(
        (Move("sensor_nonlinearity"),), (0.1, 3.0), _BOTH, stage="sensor"
    ),
    "pickup": Symptom((Move("pickup"),), (5e-5, 2e-3), _BOTH, stage="sensor"),
    "shutter_steps": Symptom(
        (Move("shutter_steps"),), (0.1, 3.0), stage="sensor", in_deflection=False
    ),
}

# The largest amount that a target may ask for, over the largest natural one.
STRETCH = 1.5
_SMALLEST = 1e-4  # of the largest
_TRIALS = 6
_CLOSE = 0.12  # of the target
_STALLED = 1e-3


@dataclass(frozen=True)
class Draw:
    """One rig's variety of an effect: everything about it but its amount."""

    symptom: Symptom
    sign: int
    weights: tuple[float, ...]
    settings: Mapping[str, float]
    peak_current: float

    def features(self, base: Mapping[str, float], amount: float) -> dict[str, float]:
        """Features of a world that had `base` and now has the effect, too."""
        changed = {**base, **self.settings}
        for move, weight in zip(self.symptom.moves, self.weights, strict=True):
            feature = BY_NAME[move.feature]
            before = base.get(move.feature, feature.off)
            if self.symptom.of_peak_current:
                value = self.peak_current * (1.0 - amount)
            elif move.factor:
                value = before * float(np.exp(self.sign * amount * weight))
            else:
                value = before + self.sign * amount * weight
            changed[move.feature] = float(np.clip(value, feature.low, feature.high))
        return changed

    def natural(self, rng: np.random.Generator) -> float:
        """An amount to be met in practice, evenly in its logarithm."""
        return float(np.exp(rng.uniform(*np.log(self.symptom.natural))))


def draw(symptom: Symptom, rng: np.random.Generator, peak_current: float) -> Draw:
    """Direction, weights and settings of one occurrence.

    Args:
        symptom: of EFFECTS or OUTSIDE.
        rng: draws them.
        peak_current: the largest of the case's records in A.
    """
    sign = int(rng.choice(symptom.signs))
    weights = tuple(float(rng.uniform(*move.weight)) for move in symptom.moves)
    settings = {s.feature: _drawn(s, rng) for s in symptom.settings}
    return Draw(symptom, sign, weights, settings, peak_current)


def _drawn(setting: Setting, rng: np.random.Generator) -> float:
    if setting.spread == LOG:
        return float(np.exp(rng.uniform(np.log(setting.low), np.log(setting.high))))
    return float(rng.uniform(setting.low, setting.high))


def amount_for(
    drawn: Draw, target: float, gap: Callable[[float], float], start: float | None = None
) -> float:
    """Amount whose gap is `target`, or the nearest that the effect's bounds allow.

    Gaps grow about as amounts do: steps in proportion until the target is bracketed, then
    interpolation on logarithms.

    Args:
        drawn: the variety of the effect.
        target: gap over noise.
        gap: gap over noise of an amount; about monotonic.
        start: first amount to try.
    """
    low, high = drawn.symptom.natural
    smallest, largest = np.log(high * _SMALLEST), np.log(high * STRETCH)
    at = float(np.log(start)) if start else 0.5 * float(np.log(low * high))
    tried: list[tuple[float, float]] = []
    for _ in range(_TRIALS):
        tried.append((at, float(np.log(max(gap(float(np.exp(at))), 1e-9) / target))))
        following = float(np.clip(_next(tried), smallest, largest))
        if abs(tried[-1][1]) < _CLOSE or abs(following - at) < _STALLED:
            break
        at = following
    return float(np.exp(min(tried, key=lambda trial: abs(trial[1]))[0]))


def _next(tried: list[tuple[float, float]]) -> float:
    """Where the misses, (log amount, log gap over target), should cross zero."""
    below, above = ([t for t in tried if (t[1] < 0) == small] for small in (True, False))
    if not (below and above):
        amount, miss = tried[-1]
        return amount - miss
    (x0, y0), (x1, y1) = max(below), min(above)
    return x0 - y0 * (x1 - x0) / (y1 - y0)

"""A case: what is dealt to it, and everything about it that is drawn without knowing that."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sma_bench.blind.deck import RECALIBRATION, Card, deal
from sma_bench.blind.drives import Drive, draw_drives
from sma_bench.blind.noise import Noise
from sma_bench.blind.rigs import draw_nominal, draw_truth, draw_wrong
from sma_bench.blind.sensors import Sensors
from sma_bench.blind.stage import RECORDS
from sma_bench.parameters import Parameters

SPLITS = {"development": range(1000, 2000), "frozen-test": range(2000, 3000)}
OPEN = "open"

# Purposes of a case's own random numbers; each has its own stream, so that nothing drawn for one
# depends on how much another one drew.
_STREAMS = ("rig", "beliefs", "drives", "sensors", "nuisances", "effect", "bag", *RECORDS)
_DECK = 2**31 - 1

_STORAGES = ("mcap", "sqlite3")
_NAMESPACES = ("bench", "lab/bench", "rig_2/bench", "composite/bench")
_FIRST_DAY, _DAYS = 1_704_067_200, 540  # 2024-01-01, and the days of a campaign
_WORKING_HOURS = (8 * 3600, 18 * 3600)
_PAUSE = (200.0, 3000.0)  # s between the starts of a case's two records

# Middle of the noise of each quantity; it varies by a factor from rig to rig.
_NOISE = {"voltage": 0.004, "current": 0.008, "temperature": 0.25, "deflection": 40e-6}
_NOISE_FACTOR = (0.7, 1.4)
_JITTER = (0.0005, 0.0014)
_DROPOUT = (0.004, 0.02)
_CAMERA_CLOCK = (-0.004, 0.012)

# What every rig has a little of, at the size that `nuisance_scale` = 1 gives it.
_NUISANCES = {
    "grain_spread": (0.0, 0.4),
    "convection_by_correlation": (0.0, 0.02),
    "deflection_drift": (-15e-6, 15e-6),
}
# Gap over noise of all nuisances together.
NUISANCE_GAP = (0.05, 0.25)
NUISANCE_LIMIT = 0.3
# Of a transformation that is a little smoother than the model's.
MILD_GAP = (1.0, 6.0)


@dataclass(frozen=True)
class Case:
    """One case before anything is simulated.

    Attributes:
        name: of its folder.
        card: what it hides.
        truth, nominal: the rig, and what its owners believe.
        wrong: parameter -> error in stated standard deviations, where the owners are mistaken.
        sensors, drives: the instruments, and the voltages by record.
        nuisances: features that every rig has a little of; nuisance_gap: their wanted gap.
        mild_gap: wanted gap of mildly different kinetics.
        storage, namespace: of the bags; starts: by record, ns since the epoch.
    """

    seed: int
    index: int
    name: str
    card: Card
    truth: Parameters
    nominal: Parameters
    wrong: Mapping[str, float]
    sensors: Sensors
    drives: Mapping[str, Drive]
    nuisances: Mapping[str, float]
    nuisance_gap: float
    mild_gap: float
    storage: str
    namespace: str
    starts: Mapping[str, int]

    def stream(self, purpose: str) -> np.random.Generator:
        """Random numbers of this case for one purpose, from their beginning."""
        return _stream(self.seed, self.index, purpose)


def split_of(seed: int) -> str:
    """The set that cases of this seed belong to."""
    return next((name for name, seeds in SPLITS.items() if seed in seeds), OPEN)


def draw_cases(seed: int, n: int) -> list[Case]:
    """The n cases of a seed, nothing simulated."""
    cards = deal(n, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DECK,))))
    width = max(4, len(str(n)))
    return [draw_case(seed, k, card, f"{k + 1:0{width}d}") for k, card in enumerate(cards)]


def draw_case(seed: int, index: int, card: Card, name: str) -> Case:
    """One case; its card decides about the noise's colour and the owners' mistakes, no more."""

    def stream(purpose: str) -> np.random.Generator:
        return _stream(seed, index, purpose)

    truth = draw_truth(stream("rig"))
    beliefs = stream("beliefs")
    mistakes = draw_wrong(beliefs)
    wrong = mistakes if card.kind == RECALIBRATION else {}
    little = stream("nuisances")
    nuisances = {n: float(little.uniform(*limits)) for n, limits in _NUISANCES.items()}
    bag = stream("bag")
    return Case(
        seed,
        index,
        name,
        card,
        truth,
        draw_nominal(truth, beliefs, wrong),
        wrong,
        _draw_sensors(card.colour, stream("sensors")),
        draw_drives(truth, stream("drives")),
        nuisances,
        nuisance_gap=float(little.uniform(*NUISANCE_GAP)),
        mild_gap=float(np.exp(little.uniform(*np.log(MILD_GAP)))),
        storage=str(bag.choice(_STORAGES)),
        namespace=str(bag.choice(_NAMESPACES)),
        starts=_draw_starts(bag),
    )


def _stream(seed: int, index: int, purpose: str) -> np.random.Generator:
    key = (index, _STREAMS.index(purpose))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _draw_sensors(colour: str, rng: np.random.Generator) -> Sensors:
    noise = {}
    for quantity, middle in _NOISE.items():
        std = middle * float(np.exp(rng.uniform(*np.log(_NOISE_FACTOR))))
        noise[quantity] = Noise.of_colour("white" if quantity == "voltage" else colour, std, rng)
    return Sensors(
        noise,
        jitter=float(rng.uniform(*_JITTER)),
        dropout=float(rng.uniform(*_DROPOUT)),
        camera_clock=float(rng.uniform(*_CAMERA_CLOCK)),
        seed=int(rng.integers(2**31)),
    )


def _draw_starts(rng: np.random.Generator) -> dict[str, int]:
    """ns since the epoch: some working day, the second record after the first."""
    day = _FIRST_DAY + 86400 * int(rng.integers(_DAYS))
    first = day + float(rng.uniform(*_WORKING_HOURS))
    times = (first, first + float(rng.uniform(*_PAUSE)))
    return {name: int(t * 1e9) for name, t in zip(RECORDS, times, strict=True)}

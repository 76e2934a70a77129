"""False alarms of the twin, and its delay for real gaps: simulated residuals, no nodes.

A sensor's residual is white noise plus a slow drift (Ornstein-Uhlenbeck), as large as the twin
allows by `allowed.*`, or half of that. The table counts excursions, in weeks of a composite bench,
that would be alarms at lower limits of surprise and at the twin's own; the true rate is below the
last column with 95 % confidence (Poisson). A week with all drifts takes ten minutes.

    ./bench check twin_alarms [--weeks 8] [--seed 1]
"""

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from scipy.signal import lfilter

from examination.pieces import options_of, poisson_bound
from sma_bench.arrays import Array
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.twin.comparison import BIN, MEMORY, SURPRISING, Bin, SignalBins

SETTINGS = {p.name: p.default for p in NODE_TABLES["twin"]}
WINDOW, FEWEST = SETTINGS["window"], round(SETTINGS["learning"] / BIN)
THRESHOLD, ALLOWED = SETTINGS["threshold"], SETTINGS["allowed.temperature"]
SCATTER, COUNT = 0.1, 8  # K, noise of a sample; samples per bin: a camera of 40 Hz
SIGNALS = 9  # of a composite bench: four currents, four temperatures, the deflection
WEEK, MINUTE = 7 * 24 * 3600.0, round(60.0 / BIN)  # s, bins
EVERY = 5  # bins between two verdicts
LIMITS = (4.0, 4.5, 5.0, SURPRISING)
TIMES = (3.0, 10.0, 30.0, 200.0)  # s, correlation times of the drift
DRIFTS = (0.5, 1.0)  # of what is allowed
STARTS = 1000
MOST = 1.0  # alarms per bench and week
STEPS = (0.75, 1.5, 2.0, 3.0, 5.0)  # K
TRIALS = 40


def residuals(random: np.random.Generator, bins: int, drift: float, time: float) -> Array:
    """(bins,) K, residuals of a sensor; drift of std `drift` K with correlation time `time` s."""
    phi = math.exp(-BIN / time)
    driven = random.standard_normal(bins) * drift * math.sqrt(1.0 - phi**2)
    driven[0] = random.standard_normal() * drift
    white = random.standard_normal(bins) * SCATTER / math.sqrt(COUNT)
    return np.asarray(lfilter([1.0], [1.0, -phi], driven) + white)


def excursions(residual: Array) -> Iterator[float]:
    """Largest surprise of each excursion beyond the threshold, by the twin's code."""
    width = round(WINDOW / BIN)
    sums = np.cumsum(np.insert((residual / math.hypot(SCATTER, ALLOWED)) ** 2, 0, 0.0))
    ends = np.arange(width, len(residual) + 1, EVERY)
    gaps = np.sqrt((sums[ends] - sums[ends - width]) / width)
    largest, known, signal = 0.0, 0, signal_of(residual[:0])
    for end in ends[gaps >= THRESHOLD].tolist():
        if end > known + EVERY:
            if largest:
                yield largest
            largest, known = 0.0, max(end - MEMORY, 0)
            signal = signal_of(residual[:0])
        add(signal, residual, known, end)
        known = end
        said = signal.read(ALLOWED, 1, FEWEST, WINDOW)
        largest = max(largest, said.surprise if said else 0.0)
    if largest:
        yield largest


def signal_of(residual: Array) -> SignalBins:
    signal = SignalBins("temperature")
    scatter = np.tile([SCATTER, -SCATTER], 200) / math.sqrt(16.0 / 6.0)
    signal.samples(np.linspace(0.0, 1.0, 400), scatter)
    add(signal, residual, 0, len(residual))
    return signal


def add(signal: SignalBins, residual: Array, start: int, stop: int) -> None:
    for k in range(start, stop):
        signal.bins.append(Bin(BIN * (k + 1), float(residual[k]), COUNT, 0.0, 1.0, 0))


def delay_of_gap(residual: Array, known: int) -> float:
    """s from bin `known` of a residual (n,) K to the first verdict of a gap, inf for none."""
    signal, width = signal_of(residual[:known]), round(WINDOW / BIN)
    squares = (residual / math.hypot(SCATTER, ALLOWED)) ** 2
    for end in range(known, len(residual), EVERY):
        add(signal, residual, end, end + EVERY)
        window = squares[max(end + EVERY - width, 0) : end + EVERY]
        if np.sqrt(window.mean()) < THRESHOLD:  # no gap yet
            continue
        said = signal.read(ALLOWED, 1, FEWEST, WINDOW, THRESHOLD)
        if said and said.gap[0] >= THRESHOLD and said.surprise >= SURPRISING:
            return (end + EVERY - known) * BIN
    return math.inf


def delays(random: np.random.Generator, step: float, drift: float, time: float,
           trials: int = TRIALS) -> Array:
    """(trials,) s from a step of the residual to its detection, within a minute."""
    found = []
    for _ in range(trials):
        residual = residuals(random, MEMORY + MINUTE, drift, time)
        residual[MEMORY:] += step
        found.append(delay_of_gap(residual, MEMORY))
    return np.array(found)


def main(argv: Sequence[str] | None = None) -> int:
    """0 if, with 95 % confidence, no allowed drift causes more than one alarm per week."""
    options = options_of("twin_alarms", __doc__, argv, seed=(1, "of all"),
                         weeks=(8, "of a bench, of every kind of drift"))
    random = np.random.default_rng(options.seed)
    print(f"alarms a week, of {options.weeks} weeks of a bench with {SIGNALS} signals; the twin's "
          f"limit is {SURPRISING:g}")  # fmt: skip
    print("drift [allowed]  time [s]  " + "  ".join(f"limit {limit:3g}" for limit in LIMITS)
          + "  at most (95 %)")  # fmt: skip
    worst = 0.0
    for share, time in product(DRIFTS, TIMES):
        counts = np.zeros(len(LIMITS), int)
        for _ in range(options.weeks * SIGNALS):
            week = residuals(random, round(WEEK / BIN), share * ALLOWED, time)
            largest = list(excursions(week))
            counts += [sum(one >= limit for one in largest) for limit in LIMITS]
        bound = poisson_bound(counts[-1]) / options.weeks
        worst = max(worst, bound)
        cells = "  ".join(f"{count / options.weeks:9.3g}" for count in counts)
        print(f"{share:15g}  {time:8g}  {cells}  {bound:14.2f}", flush=True)
    print(f"\nof {STARTS} starts of a signal, those with an alarm in the first minute")
    for time in TIMES:
        starts = (residuals(random, MINUTE, ALLOWED, time) for _ in range(STARTS))
        found = sum(math.isfinite(delay_of_gap(start, 0)) for start in starts)
        print(f"{1.0:15g}  {time:8g}  {found:9d}", flush=True)
    print(f"\nseconds until a step is named, median of {TRIALS} (share that is within a minute)")
    print("drift [allowed]  " + "  ".join(f"{step:9g} K" for step in STEPS))
    for share in (0.0, 0.1, 0.5, 1.0):
        cells = ""
        for step in STEPS:
            delay = delays(random, step, share * ALLOWED, 30.0)
            named = np.isfinite(delay)
            median = f"{np.median(delay[named]):.0f} s" if named.any() else "-"
            cells += f"  {f'{median:>5} {100 * named.mean():3.0f} %':>11}"
        print(f"{share:15g}{cells}", flush=True)
    return int(worst > MOST)

"""Does identification give back what a bench was made of, with errors that are true?

Benches are drawn at random, run through protocol, simulated bench, instruments and bag on disk,
read back and identified from a parameter file that is off by its stated uncertainty. The bench is
simulated in this process (the physics that the simulator node steps), not over DDS.

    ./bench check identification --draws 50 --seed 0 --json result.json
"""

import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from examination.pieces import IN_PIECES, Z_95, in_pieces, options_of
from examination.simulated_lab.drawn_bench import EXACT, IDENTIFIED, draw_bench
from examination.simulated_lab.experiments import EXPERIMENTS, record_everything
from sma_bench.identify import identify
from sma_bench.records import read_record

BAND = (0.88, 0.99)
HEADER = """\
identification of {draws} benches drawn at random (seed {seed})
  bags of each: {bags}
  simulated in this process by sma_bench.physics (not over DDS); instruments of the simulator
  node: noise, quantisation, jitter of +-20 % of a period, 2 % of the samples lost
  inputs of the lab, taken as exact: {exact}, and with mass and diameter the wire's length;
  the other geometry of the composite enters only through alpha and beta
"""
ROW = "{:44s} {:>8s} {:>6s} {:>8s}  {:12s} {:>7s}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign; 0 if the stated errors are true, 1 if not."""
    scale = "judge as if the stated errors were so many times as large: 0.3 must fail"
    options = options_of(
        "identification", __doc__, argv, draws=(50, "benches"), seed=(0, "of the first bench"),
        error_scale=(1.0, scale), **IN_PIECES,
    )  # fmt: skip
    bags, exact = ", ".join(EXPERIMENTS), ", ".join(EXACT)
    print(HEADER.format(draws=options.draws, seed=options.seed, bags=bags, exact=exact))
    results = in_pieces(run_draw, range(options.seed, options.seed + options.draws), options)
    summary = summarise(results, options.error_scale)
    print(*table(summary), sep="\n")
    return 0 if summary["passed"] else 1


def run_draw(seed: int) -> dict[str, Any]:
    """One bench from its draw to its identified parameters."""
    bench = draw_bench(np.random.default_rng(seed))
    with tempfile.TemporaryDirectory(prefix="sma_bench_check_") as folder:
        records = [read_record(path) for path in record_everything(bench, Path(folder), seed)]
        found = identify(records, bench.known)
    parameters = {
        name: {
            "truth": float(bench.truth[name]), "prior_std": bench.known.std(name),
            "value": float(e.value), "std": float(e.std), "method": e.method,
        }
        for name in IDENTIFIED if (e := found.estimates.get(name))
    }  # fmt: skip
    return {"seed": seed, "parameters": parameters, "warnings": list(found.warnings)}


def summarise(results: Sequence[dict[str, Any]], error_scale: float = 1.0) -> dict[str, Any]:
    """Figures of every parameter and of all; each stated error taken `error_scale` as large."""
    rows = {}
    for name in IDENTIFIED:
        found = [r["parameters"][name] for r in results if name in r["parameters"]]
        z = np.array([(p["value"] - p["truth"]) / (error_scale * p["std"]) for p in found])
        gain = np.median([p["prior_std"] / p["std"] for p in found]) if found else 0.0
        bias, rms = (z.mean(), np.sqrt(np.mean(z**2))) if found else (math.nan, math.nan)
        figures = {"bias": float(bias), "rms": float(rms), "gain": float(gain)}
        rows[name] = figures | _share(int(np.sum(np.abs(z) < Z_95)), len(z))
    inside, n = (sum(row[key] for row in rows.values()) for key in ("inside", "n"))
    missing = len(IDENTIFIED) * len(results) - n
    whole = _share(inside, n)
    passed = missing == 0 and BAND[0] <= whole["coverage"] <= BAND[1]
    return {"parameters": rows, "missing": missing, "passed": passed, **whole}


def _share(inside: int, n: int) -> dict[str, Any]:
    """With its exact 95 % interval (Clopper and Pearson)."""
    low, high = binomtest(inside, n).proportion_ci(method="exact") if n else (0.0, 1.0)
    interval = (float(low), float(high))
    return {"inside": inside, "n": n, "coverage": inside / n if n else 0.0, "interval": interval}


def table(summary: dict[str, Any]) -> Iterator[str]:
    """Lines for people."""
    yield ROW.format("parameter", "bias/std", "rms z", "in 95 %", "", "gain").rstrip()
    for name, row in summary["parameters"].items():
        low, high = row["interval"]
        yield ROW.format(
            name, f"{row['bias']:+.2f}", f"{row['rms']:.2f}", f"{100.0 * row['coverage']:.0f} %",
            f"[{100 * low:.0f}, {100 * high:.0f}]", f"{row['gain']:.0f} x",
        )  # fmt: skip
    low, high = summary["interval"]
    missing = f"; {summary['missing']} estimates missing" if summary["missing"] else ""
    yield (
        f"\nall: {summary['inside']} of {summary['n']} within their 95 % intervals, "
        f"{100 * summary['coverage']:.1f} % [{100 * low:.1f}, {100 * high:.1f}]; "
        f"wanted {100 * BAND[0]:.0f} to {100 * BAND[1]:.0f} %{missing}"
    )
    yield "PASSED" if summary["passed"] else "FAILED"
    yield "gain: median of the prior's standard deviation over the estimate's"


if __name__ == "__main__":
    sys.exit(main())

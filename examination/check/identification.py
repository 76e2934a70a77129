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

from examination.pieces import Z_95, in_pieces, parser_of
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
TITLES = ("parameter", "bias/std", "rms z", "in 95 %", "", "gain")
ROW = "{:44s} {:>8s} {:>6s} {:>8s}  {:12s} {:>7s}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the campaign; 0 if the stated errors are true, 1 if not."""
    parser = parser_of("identification", __doc__)
    parser.add_argument("--draws", type=int, default=50, help="benches (default 50)")
    parser.add_argument("--seed", type=int, default=0, help="of the first bench (default 0)")
    parser.add_argument(
        "--error-scale", type=float, default=1.0, metavar="FACTOR",
        help="judge as if the stated errors were this many times as large: 0.3 must fail",
    )
    options = parser.parse_args(argv)
    if options.draws < 1 or options.error_scale <= 0.0:
        parser.error("--draws and --error-scale must be positive")
    bags = ", ".join(EXPERIMENTS)
    exact = ", ".join(EXACT)
    print(HEADER.format(draws=options.draws, seed=options.seed, bags=bags, exact=exact))
    results = in_pieces(run_draw, range(options.seed, options.seed + options.draws), options)
    summary = summarise(results, options.error_scale)
    for line in table(summary):
        print(line)
    return 0 if summary["passed"] else 1


def run_draw(seed: int) -> dict[str, Any]:
    """One bench from its draw to its identified parameters."""
    random = np.random.default_rng(seed)
    bench = draw_bench(random)
    with tempfile.TemporaryDirectory(prefix="sma_bench_check_") as folder:
        paths = record_everything(bench, Path(folder), seed)
        records = [read_record(path) for path in paths]
        found = identify(records, bench.known)
    parameters = {
        name: {
            "truth": float(bench.truth[name]),
            "prior_std": bench.known.std(name),
            "value": float(found.estimates[name].value),
            "std": float(found.estimates[name].std),
            "method": found.estimates[name].method,
        }
        for name in IDENTIFIED
        if name in found.estimates
    }
    return {"seed": seed, "parameters": parameters, "warnings": list(found.warnings)}


def summarise(results: Sequence[dict[str, Any]], error_scale: float = 1.0) -> dict[str, Any]:
    """Figures of every parameter and of all together.

    Args:
        results: of `run_draw`.
        error_scale: the stated errors are taken this many times as large.
    """
    rows = {name: _row(results, name, error_scale) for name in IDENTIFIED}
    inside = sum(row["inside"] for row in rows.values())
    n = sum(row["n"] for row in rows.values())
    missing = sum(len(results) - row["n"] for row in rows.values())
    coverage = inside / n if n else 0.0
    return {
        "parameters": rows,
        "inside": inside,
        "n": n,
        "missing": missing,
        "coverage": coverage,
        "interval": interval_of(inside, n),
        "passed": missing == 0 and BAND[0] <= coverage <= BAND[1],
    }


def _row(results: Sequence[dict[str, Any]], name: str, error_scale: float) -> dict[str, Any]:
    found = [r["parameters"][name] for r in results if name in r["parameters"]]
    z = np.array([(p["value"] - p["truth"]) / (error_scale * p["std"]) for p in found])
    inside = int(np.sum(np.abs(z) < Z_95))
    return {
        "n": len(z),
        "bias": float(z.mean()) if len(z) else math.nan,
        "rms": float(np.sqrt(np.mean(z**2))) if len(z) else math.nan,
        "inside": inside,
        "interval": interval_of(inside, len(z)),
        "gain": float(np.median([p["prior_std"] / p["std"] for p in found])) if len(z) else 0.0,
    }


def interval_of(inside: int, n: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson)."""
    low, high = binomtest(inside, n).proportion_ci(method="exact") if n else (0.0, 1.0)
    return float(low), float(high)


def table(summary: dict[str, Any]) -> Iterator[str]:
    """Lines for people."""
    yield ROW.format(*TITLES).rstrip()
    for name, row in summary["parameters"].items():
        low, high = row["interval"]
        share = 100.0 * row["inside"] / row["n"] if row["n"] else 0.0
        yield ROW.format(
            name, f"{row['bias']:+.2f}", f"{row['rms']:.2f}", f"{share:.0f} %",
            f"[{100 * low:.0f}, {100 * high:.0f}]", f"{row['gain']:.0f} x",
        )
    low, high = summary["interval"]
    yield (
        f"\nall: {summary['inside']} of {summary['n']} within their 95 % intervals, "
        f"{100 * summary['coverage']:.1f} % [{100 * low:.1f}, {100 * high:.1f}]; "
        f"wanted {100 * BAND[0]:.0f} to {100 * BAND[1]:.0f} %"
        + (f"; {summary['missing']} estimates missing" if summary["missing"] else "")
    )
    yield "PASSED" if summary["passed"] else "FAILED"
    yield "gain: median of the prior's standard deviation over the estimate's"


if __name__ == "__main__":
    sys.exit(main())

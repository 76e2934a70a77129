"""Does identification give back what a bench was made of, with errors that are true?

Benches are drawn at random, run through protocol, simulated bench, instruments and bag on disk,
read back and identified from a parameter file that is off by its stated uncertainty. The bench is
simulated in this process (the physics that the simulator node steps), not over DDS.

    ./bench check identification --draws 50 --seed 0 --json result.json
"""

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

# Two processes share the machine: linear algebra with threads of its own would only wait.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import beta

from examination.simulated_lab.drawn_bench import EXACT, IDENTIFIED, draw_bench
from examination.simulated_lab.experiments import EXPERIMENTS, record_everything
from sma_bench.identify import identify
from sma_bench.records import read_record

PROCESSES = 2
NOMINAL = 0.95
BAND = (0.88, 0.99)
Z_LIMIT = 1.959964

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
    options = _options(argv)
    bags = ", ".join(EXPERIMENTS)
    exact = ", ".join(EXACT)
    print(HEADER.format(draws=options.draws, seed=options.seed, bags=bags, exact=exact))
    started = time.monotonic()
    results = list(_with_progress(_campaign(options.seed, options.draws), options.draws))
    results.sort(key=lambda result: result["seed"])
    summary = summarise(results, options.error_scale)
    for line in table(summary):
        print(line)
    elapsed = time.monotonic() - started
    print(f"\n{elapsed:.0f} s, {elapsed * PROCESSES / options.draws:.1f} s a bench and process")
    if options.json:
        document = {"summary": summary, "draws": results}
        Path(options.json).write_text(json.dumps(document, indent=1))
    return 0 if summary["passed"] else 1


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench check identification", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--draws", type=int, default=50, help="benches (default 50)")
    parser.add_argument("--seed", type=int, default=0, help="of the first bench (default 0)")
    parser.add_argument("--json", metavar="FILE", help="write every estimate and the summary")
    parser.add_argument(
        "--error-scale", type=float, default=1.0, metavar="FACTOR",
        help="judge as if the stated errors were this many times as large: 0.3 must fail",
    )
    options = parser.parse_args(argv)
    if options.draws < 1 or options.error_scale <= 0.0:
        parser.error("--draws and --error-scale must be positive")
    return options


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


def _campaign(seed: int, draws: int) -> Iterator[dict[str, Any]]:
    seeds = range(seed, seed + draws)
    if draws == 1:
        yield run_draw(seed)
        return
    # A fresh interpreter each: forked ones would inherit the threads of numpy and numba.
    with get_context("spawn").Pool(PROCESSES) as pool:
        yield from pool.imap_unordered(run_draw, seeds)


def _with_progress(results: Iterator[dict[str, Any]], total: int) -> Iterator[dict[str, Any]]:
    live = sys.stderr.isatty()
    started = time.monotonic()
    for done, result in enumerate(results, start=1):
        left = (time.monotonic() - started) / done * (total - done)
        bar = "#" * round(30 * done / total)
        text = f"[{bar:30s}] {done}/{total}, {left:.0f} s left"
        if live:
            sys.stderr.write("\r\033[K" + text + ("\n" if done == total else ""))
            sys.stderr.flush()
        elif done % 5 == 0 or done == total:
            print(text, file=sys.stderr, flush=True)
        yield result


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
        "interval": clopper_pearson(inside, n),
        "passed": missing == 0 and BAND[0] <= coverage <= BAND[1],
    }


def _row(results: Sequence[dict[str, Any]], name: str, error_scale: float) -> dict[str, Any]:
    found = [r["parameters"][name] for r in results if name in r["parameters"]]
    z = np.array([(p["value"] - p["truth"]) / (error_scale * p["std"]) for p in found])
    inside = int(np.sum(np.abs(z) < Z_LIMIT))
    return {
        "n": len(z),
        "bias": float(z.mean()) if len(z) else math.nan,
        "rms": float(np.sqrt(np.mean(z**2))) if len(z) else math.nan,
        "inside": inside,
        "interval": clopper_pearson(inside, len(z)),
        "gain": float(np.median([p["prior_std"] / p["std"] for p in found])) if len(z) else 0.0,
    }


def clopper_pearson(inside: int, n: int, level: float = NOMINAL) -> tuple[float, float]:
    """Exact interval of a share, `inside` of `n`."""
    tail = 0.5 * (1.0 - level)
    low = float(beta.ppf(tail, inside, n - inside + 1)) if inside else 0.0
    high = float(beta.ppf(1.0 - tail, inside + 1, n - inside)) if inside < n else 1.0
    return low, high


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

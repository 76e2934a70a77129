"""Does identification give back what a bench was made of, with errors that are true?

Benches are drawn at random, run through protocol, simulated bench, instruments and bag on disk,
read back and identified from a parameter file that is off by its stated uncertainty. The bench is
simulated in this process (the physics that the simulator node steps), not over DDS.

    ./bench check identification --draws 50 --seed 0 --json result.json
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from examination.pieces import IN_PIECES, Z_95, in_pieces, options_of, print_coverage
from examination.simulated_lab import EXACT, EXPERIMENTS, IDENTIFIED, draw_bench, record_everything
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


def main(argv: Sequence[str] | None = None) -> int:
    own = {"draws": (50, "benches"), "seed": (0, "of the first bench")}
    options = options_of("identification", __doc__, argv, **own, **IN_PIECES)
    bags, exact = ", ".join(EXPERIMENTS), ", ".join(EXACT)
    print(HEADER.format(draws=options.draws, seed=options.seed, bags=bags, exact=exact))
    jobs = [(options.seed + k,) for k in range(options.draws)]
    results = in_pieces(run_draw, jobs, options)
    # Whether enough intervals hold the truth and none is missing.
    found = [(name, (p["value"] - p["truth"]) / p["std"])
             for result in results for name, p in result["parameters"].items()]
    share = print_coverage(found, Z_95)
    missing = len(IDENTIFIED) * len(results) - len(found)
    good = missing == 0 and BAND[0] <= share <= BAND[1]
    wanted = f"wanted {BAND[0]:.0%} to {BAND[1]:.0%}"
    print(f"{'PASSED' if good else 'FAILED'}: {share:.1%} inside, {wanted}; {missing} missing")
    return 0 if good else 1


def run_draw(seed: int) -> dict[str, Any]:
    bench = draw_bench(np.random.default_rng(seed))
    with tempfile.TemporaryDirectory(prefix="sma_bench_check_") as folder:
        records = [read_record(path) for path in record_everything(bench, Path(folder), seed)]
        found = identify(records, bench.known)
    parameters = {}
    for name in IDENTIFIED:
        if e := found.estimates.get(name):
            numbers = {"value": float(e.value), "std": float(e.std), "method": e.method}
            believed = {"truth": float(bench.truth[name]), "prior_std": bench.known.std(name)}
            parameters[name] = believed | numbers
    return {"seed": seed, "parameters": parameters, "warnings": list(found.warnings)}

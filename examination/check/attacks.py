"""Does identification ever state a wrong number without a word?

Benches and instruments of examination/attack_lab, which share no code with the package's physics,
are given a fault each; every identified number is then right within three standard errors, or a
warning is on that number, or it is silently wrong. Clean ones must raise no warning.

    ./bench check attacks [--only WORD] [--seeds 5] [--clean 50] [--processes 2] [--json FILE]
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from examination.attack_lab.cases import ATTACKS, Attack, Case, clean_bag, clean_tables
from sma_bench.errors import InputError
from sma_bench.identify import identify

LIMIT = 3.0
FALSE_ALARMS = 0.02
ROW = "{:9s} {:46s} {:>5s} {:>6s} {:>6s} {:>7s}  {}"
TITLES = ("attack", "", "right", "warned", "silent", "refused", "largest silent, or |z| when right")


def judge(case: Case) -> dict[str, Any]:
    """Of every number that is true or false: how many standard errors it is off, and what was
    said; or the line that the records were refused with."""
    try:
        found = identify(case.records, case.parameters, case.experiments)
    except InputError as error:
        return {"refused": str(error), "numbers": {}, "warnings": []}
    numbers = {
        name: {
            "truth": truth,
            "value": float(found.estimates[name].value),
            "std": float(found.estimates[name].std),
            "z": float((found.estimates[name].value - truth) / found.estimates[name].std),
            "warnings": list(found.doubts[name]),
        }
        for name, truth in case.truth.items() if name in found.estimates
    }
    return {"refused": "", "numbers": numbers, "warnings": list(found.warnings)}


def verdict(number: dict[str, Any]) -> str:
    if abs(number["z"]) < LIMIT:
        return "right"
    return "warned" if number["warnings"] else "silent"


def run_attack(attack: Attack, seeds: Sequence[int]) -> list[dict[str, Any]]:
    return [judge(attack.make(np.random.default_rng(7000 + seed), seed)) for seed in seeds]


def run_numbered(number: int, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Of ATTACKS, by its place: what an attack does to records cannot be sent to a process."""
    return run_attack(ATTACKS[number], seeds)


CLEAN = (clean_bag, clean_tables)


def run_clean(one: tuple[int, int]) -> dict[str, Any]:
    """A clean set: its kind, by its place in CLEAN, and its seed."""
    kind, seed = one
    return judge(CLEAN[kind](np.random.default_rng(9000 + seed), seed))


def row(attack: Attack, results: Sequence[dict[str, Any]]) -> tuple[str, int]:
    """A line of the table, and how many numbers are silently wrong."""
    every = [(name, n, verdict(n)) for r in results for name, n in r["numbers"].items()]
    count = {kind: sum(v == kind for _, _, v in every) for kind in ("right", "warned", "silent")}
    shown = [x for x in every if x[2] == ("silent" if count["silent"] else "right")]
    worst = max(shown, key=lambda x: abs(x[1]["z"]), default=None)
    said = f"{worst[0].rpartition('.')[2]} z {worst[1]['z']:+.1f}" if worst else ""
    refused = sum(bool(r["refused"]) for r in results)
    numbers = (str(count[k]) for k in ("right", "warned", "silent"))
    return ROW.format(attack.experiment, attack.name, *numbers, str(refused), said), count["silent"]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; 0 if nothing is silently wrong and clean records raise no alarm."""
    options = _options(argv)
    words = [f"{a.experiment} {a.name}" for a in ATTACKS]
    chosen = [k for k, word in enumerate(words) if options.only.lower() in word.lower()]
    print(f"{len(chosen)} attacks, {options.seeds} seeds each: every number right within "
          f"{LIMIT:g} standard errors, warned of, or silently wrong\n")
    print(ROW.format(*TITLES))
    started, silent, document = time.monotonic(), 0, {}
    clean = [(kind, seed) for kind in range(len(CLEAN)) for seed in range(options.clean)]
    alarms = []
    with get_context("spawn").Pool(options.processes) as pool:
        attacked = pool.imap(partial(run_numbered, seeds=range(options.seeds)), chosen)
        for number, results in zip(chosen, attacked, strict=True):
            line, wrong = row(ATTACKS[number], results)
            print(line, flush=True)
            silent += wrong
            document[words[number]] = results
        for (kind, seed), result in zip(clean, pool.imap(run_clean, clean), strict=True):
            wrong_here = [n for n, x in result["numbers"].items() if verdict(x) == "silent"]
            silent += len(wrong_here)
            if result["warnings"] or result["refused"] or wrong_here:
                alarms.append(result)
                print(f"clean {CLEAN[kind].__name__} {seed}:", *result["warnings"],
                      result["refused"],
                      *(f"{n} z {result['numbers'][n]['z']:+.1f}" for n in wrong_here),
                      sep="\n    ", flush=True)
    document["clean"] = alarms
    false = sum(bool(r["warnings"] or r["refused"]) for r in alarms)
    print(f"\nsilently wrong: {silent}; false warnings on {false} of {len(clean)} clean sets; "
          f"{time.monotonic() - started:.0f} s")
    if options.json:
        Path(options.json).write_text(json.dumps(document, indent=1))
    passed = silent == 0 and false <= FALSE_ALARMS * len(clean)
    print("PASSED" if passed else "FAILED")
    return 0 if passed else 1


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench check attacks", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", default="", metavar="WORD", help="attacks with this in the name")
    parser.add_argument("--seeds", type=int, default=5, help="of each attack (default 5)")
    parser.add_argument("--clean", type=int, default=50, help="clean sets of each kind (50)")
    parser.add_argument("--processes", type=int, default=2, help="at once (default 2)")
    parser.add_argument("--json", metavar="FILE", help="write every number and every warning")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())

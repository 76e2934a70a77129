"""Under faults nothing is lost and nothing falls over: every fault many times, as a table.

Hostile inputs, recorders killed, full disks, leaping clocks, foreign traffic, nodes killed and
started again in all orders, hours of a bench in virtual time, parsers fed with anything.
Each line says what was tried how often, what came of it and what is allowed. Some forty minutes
on two free cores; sizes by option, the same seed damages the same places.

    ./bench check reliability [SECTION ...] [--scale 0.1] [--json reliability.json]
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from examination.campaign.foreign_traffic import foreign_traffic, leaping_clocks
from examination.campaign.full_disk import full_disk
from examination.campaign.hostile_inputs import edited_inputs, hostile_inputs
from examination.campaign.killed_recorder import killed_recorder
from examination.campaign.outcome import Campaign, Outcome
from examination.campaign.restarted_nodes import restarted_nodes
from examination.campaign.soak import soak

CAMPAIGNS = (
    Campaign("hostile", "well-formed hostile inputs", 20_000, "inputs", hostile_inputs),
    Campaign("killed", "recorders killed while they record", 200, "writers", killed_recorder),
    Campaign("disk", "disks that fill up", 20, "disks", full_disk),
    Campaign("clocks", "/clock leaps at the recorder", 20, "leaps", leaping_clocks),
    Campaign("traffic", "foreign types, broken bytes", 500, "messages a topic", foreign_traffic),
    Campaign("restarts", "nodes killed and started again", 36, "orders", restarted_nodes),
    Campaign("soak", "memory over hours", 180, "minutes of the bench's time, 60 or more", soak),
    Campaign("parsers", "parsers fed with anything", 2000, "inputs a parser", edited_inputs),
)
ROW = "{:9} {:58.58} {:>7}  {:4} {}"


def main(argv: Sequence[str] | None = None) -> int:
    """0 when everything stayed within what is allowed."""
    options = _options(argv)
    outcomes: list[Outcome] = []
    print(ROW.format("section", "what", "tried", "", "found (allowed)"))
    for campaign in CAMPAIGNS:
        if options.sections and campaign.name not in options.sections:
            continue
        size = max(1, round(getattr(options, campaign.name) * options.scale))
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="sma_bench_reliability_") as folder:
            found = campaign.run(size, options.seed, Path(folder))
        for outcome in found:
            _show(outcome)
        outcomes += found
        print(f"{'':9} {campaign.name}: {time.monotonic() - started:.0f} s", flush=True)
    failed = sum(not outcome.met for outcome in outcomes)
    print(f"{len(outcomes) - failed} of {len(outcomes)} lines within what is allowed")
    if options.json:
        result = {"seed": options.seed, "outcomes": [asdict(o) for o in outcomes], "failed": failed}
        Path(options.json).write_text(json.dumps(result, indent=2) + "\n")
    return 1 if failed else 0


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="./bench check reliability", description=(__doc__ or "").split("\n\n")[0]
    )
    names = [campaign.name for campaign in CAMPAIGNS]
    parser.add_argument("sections", nargs="*", choices=[*names, []], metavar="SECTION",
                        help=f"of {', '.join(names)}; all unless given")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scale", type=float, default=1.0, help="multiplies every size")
    parser.add_argument("--json", metavar="FILE")
    for campaign in CAMPAIGNS:
        parser.add_argument(
            f"--{campaign.name}", type=int, default=campaign.size, metavar="N",
            help=f"{campaign.about}: {campaign.unit}, {campaign.size} unless given",
        )
    return parser.parse_args(argv)


def _show(outcome: Outcome) -> None:
    word = "ok" if outcome.met else "FAIL"
    found = f"{outcome.found} ({outcome.limit})"
    print(ROW.format(outcome.section, outcome.what, outcome.tried, word, found), flush=True)


if __name__ == "__main__":
    sys.exit(main())

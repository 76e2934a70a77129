"""Under faults nothing is lost and nothing falls over: every fault many times, as a table.

Hostile inputs, recorders killed, full disks, leaping clocks, foreign traffic, nodes killed and
started again in all orders, hours of a bench in virtual time, parsers fed with anything.
Each line says what was tried how often, what came of it and what is allowed. Some forty minutes
on two free cores; sizes by option, the same seed damages the same places.

    ./bench check reliability [--only SECTION ...] [--scale 0.1]
"""

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from examination.campaign.foreign_traffic import foreign_traffic, leaping_clocks
from examination.campaign.full_disk import full_disk
from examination.campaign.hostile_inputs import edited_inputs, hostile_inputs
from examination.campaign.killed_recorder import killed_recorder
from examination.campaign.outcome import Campaign
from examination.campaign.restarted_nodes import restarted_nodes
from examination.campaign.soak import soak
from examination.pieces import options_of

CAMPAIGNS = (
    Campaign("hostile", "well-formed hostile inputs", 20_000, "inputs", hostile_inputs),
    Campaign("killed", "recorders killed while they record", 20, "nodes", killed_recorder),
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
    options = options_of(
        "reliability", __doc__, argv, only=(tuple(c.name for c in CAMPAIGNS), "sections"),
        seed=(0, "of all"), scale=(1.0, "multiplies every size"),
        **{c.name: (c.size, f"{c.about}: {c.unit}") for c in CAMPAIGNS},
    )  # fmt: skip
    lines = failed = 0
    print(ROW.format("section", "what", "tried", "", "found (allowed)"))
    for campaign in CAMPAIGNS:
        if campaign.name not in options.only:
            continue
        size = max(1, round(getattr(options, campaign.name) * options.scale))
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="sma_bench_reliability_") as folder:
            for one in campaign.run(size, options.seed, Path(folder)):
                word, found = "ok" if one.met else "FAIL", f"{one.found} ({one.limit})"
                print(ROW.format(one.section, one.what, one.tried, word, found), flush=True)
                lines, failed = lines + 1, failed + (not one.met)
        print(f"{'':9} {campaign.name}: {time.monotonic() - started:.0f} s", flush=True)
    print(f"{lines - failed} of {lines} lines within what is allowed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

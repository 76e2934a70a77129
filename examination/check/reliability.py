"""Under faults nothing is lost and nothing falls over: every fault many times, as a table.

Hostile inputs, recorders killed, full disks, foreign traffic, nodes killed and started again in all
orders, hours of a bench in virtual time, parsers fed with anything.
Each line says what was tried how often, what came of it and what is allowed. Some forty minutes
on two free cores; sizes by option, the same seed damages the same places.

    ./bench check reliability [--only SECTION ...] [--scale 0.1]
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from examination.campaign import nodes
from examination.campaign.hostile_inputs import edited_inputs, full_disk, hostile_inputs
from examination.pieces import options_of

# Section: what, how often unless said otherwise, and what does it (size, seed, folder).
CAMPAIGNS = {
    "hostile": ("well-formed hostile inputs", 20_000, hostile_inputs),
    "killed": ("recorders killed while they record", 20, nodes.killed_recorder),
    "disk": ("disks that fill up", 20, full_disk),
    "traffic": ("messages a topic of foreign types and broken bytes", 500, nodes.foreign_traffic),
    "restarts": ("orders in which nodes are killed and started again", 36, nodes.restarted_nodes),
    "soak": ("minutes of the bench's time, 60 or more", 180, nodes.soak),
    "parsers": ("edited inputs a parser", 2000, edited_inputs)}
ROW = "{:9} {:58.58} {:>7}  {:4} {}"


def main(argv: Sequence[str] | None = None) -> int:
    """0 when everything stayed within what is allowed."""
    options = options_of("reliability", __doc__, argv, only=(tuple(CAMPAIGNS), "sections"),
                         seed=(0, "of all"), scale=(1.0, "multiplies every size"),
                         **{name: (size, what) for name, (what, size, _) in CAMPAIGNS.items()})
    lines = failed = 0
    print(ROW.format("section", "what", "tried", "", "found (allowed)"))
    for name in options.only:
        size = max(1, round(getattr(options, name) * options.scale))
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="sma_bench_reliability_") as folder:
            for one in CAMPAIGNS[name][-1](size, options.seed, Path(folder)):
                word, found = "ok" if one.met else "FAIL", f"{one.found} ({one.limit})"
                print(ROW.format(one.section, one.what, one.tried, word, found), flush=True)
                lines, failed = lines + 1, failed + (not one.met)
        print(f"{'':9} {name}: {time.monotonic() - started:.0f} s", flush=True)
    print(f"{lines - failed} of {lines} lines within what is allowed")
    return 1 if failed else 0

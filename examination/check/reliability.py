"""Reliability under faults: nothing may crash or be lost. Every fault many times, as a table.

Hostile inputs, foreign traffic, nodes killed and restarted in all orders, hours of a bench in
virtual time, parsers with random input. Each line shows what was tried, how often, the result and
the limit. Some forty minutes on two idle cores; the same seed makes the same faults.

    ./bench check reliability [--only SECTION ...] [--scale 0.1]
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from examination.campaign import nodes
from examination.campaign.inputs import edited_inputs, hostile_inputs
from examination.pieces import options_of

# Section: number of trials (before --scale), and the function (size, seed, folder).
CAMPAIGNS = {
    "hostile": (1000, hostile_inputs),  # inputs
    "traffic": (500, nodes.foreign_traffic),  # messages a topic
    "restarts": (36, nodes.restarted_nodes),  # orders
    "soak": (180, nodes.soak),  # minutes of the bench's time, 60 or more
    "parsers": (2000, edited_inputs)}  # inputs a parser
ROW = "{:9} {:58.58} {:>7}  {:4} {}"


def main(argv: Sequence[str] | None = None) -> int:
    """0 if everything stayed within the limits."""
    options = options_of("reliability", __doc__, argv, only=(tuple(CAMPAIGNS), "sections"),
                         seed=(0, "of all"), scale=(1.0, "multiplies every size"))
    lines = failed = 0
    print(ROW.format("section", "what", "tried", "", "found (allowed)"))
    for name in options.only:
        size, campaign = CAMPAIGNS[name]
        with tempfile.TemporaryDirectory(prefix="sma_bench_reliability_") as folder:
            for one in campaign(max(1, round(size * options.scale)), options.seed, Path(folder)):
                word, found = "ok" if one.met else "FAIL", f"{one.found} ({one.limit})"
                print(ROW.format(name, one.what, one.tried, word, found), flush=True)
                lines, failed = lines + 1, failed + (not one.met)
    print(f"{lines - failed} of {lines} lines within what is allowed")
    return 1 if failed else 0

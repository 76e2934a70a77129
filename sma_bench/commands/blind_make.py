"""sma-bench blind make: bags with effects that only a sealed file names."""

import argparse
import os
import time

from sma_bench.commands.output import add_json_option, write_json
from sma_bench.commands.progress_bar import progress
from sma_bench.progress import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--seed", type=int, required=True, metavar="S",
        help="1000 to 1999: development, 2000 to 2999: frozen test, others: open",
    )
    parser.add_argument("--n", type=int, default=200, metavar="N", help="cases (default 200)")
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, metavar="J",
        help="processes (default: one a core); the result does not depend on it",
    )
    add_json_option(parser, "the manifest of the set")


def run(args: argparse.Namespace) -> int:
    """Make the set; all of it appears, or nothing."""
    from sma_bench.blind.make import make

    started = time.monotonic()
    with progress("blind make") as report:
        cases = counted(report, args.n, "case")
        manifest = make(args.out, args.seed, args.n, args.jobs, cases)
    if args.json:
        write_json(args.json, {"set": args.out, **manifest})
    print(
        f"{args.out}: {args.n} cases of seed {args.seed} ({manifest['split']}) "
        f"in {time.monotonic() - started:.0f} s"
    )
    print(f"labels sealed, sha256 {manifest['sha256']}")
    return 0

"""sma-bench blind figures: for every effect the record with it and without it."""

import argparse

from sma_bench.commands.output import add_json_option, write_json
from sma_bench.commands.progress_bar import progress
from sma_bench.progress import in_turn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="of the rig and its drive (default 1)"
    )
    add_json_option(parser, "what was drawn")


def run(args: argparse.Namespace) -> int:
    """Draw all effects; all of them appear, or nothing."""
    from sma_bench.blind.figures import NAMES, write_page, write_symptom
    from sma_bench.blind.make import new_folder

    with new_folder(args.out) as folder, progress("blind figures") as report:
        seen = [
            write_symptom(folder, name, args.seed)
            for name in in_turn(NAMES, report, lambda name: name)
        ]
        write_page(folder, seen, args.seed)
    if args.json:
        write_json(args.json, {"folder": args.out, "seed": args.seed, "effects": list(NAMES)})
    print(f"{args.out}: {len(seen)} figures and README.md")
    return 0

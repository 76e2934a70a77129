"""sma-bench blind figures: for every effect the record with it and without it."""

import argparse

from rich.progress import track

from sma_bench.blind.figures import NAMES, write_page, write_symptom
from sma_bench.blind.make import new_folder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="of the rig and its drive (default 1)"
    )


def run(args: argparse.Namespace) -> int:
    """Draw all effects; all of them appear, or nothing."""
    with new_folder(args.out) as folder:
        seen = [
            write_symptom(folder, name, args.seed)
            for name in track(NAMES, description="effects", transient=True)
        ]
        write_page(folder, seen, args.seed)
    print(f"{args.out}: {len(seen)} figures and README.md")
    return 0

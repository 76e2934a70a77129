"""sma-bench blind make: bags with effects that only a sealed file names."""

import argparse
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from sma_bench.blind.make import make
from sma_bench.commands.output import write_json


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
    parser.add_argument("--json", metavar="FILE", help="write the set's manifest as JSON")


def run(args: argparse.Namespace) -> int:
    """Make the set; all of it appears, or nothing."""
    started = time.monotonic()
    console = Console(highlight=False, stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with _terminated_as_interrupted(), Progress(*columns, console=console) as bar:
        task = bar.add_task("cases", total=args.n)
        manifest = make(
            args.out, args.seed, args.n, args.jobs, lambda done: bar.update(task, completed=done)
        )
    if args.json:
        write_json(args.json, {"set": args.out, **manifest})
    print(
        f"{args.out}: {args.n} cases of seed {args.seed} ({manifest['split']}) "
        f"in {time.monotonic() - started:.0f} s"
    )
    print(f"labels sealed, sha256 {manifest['sha256']}")
    return 0


class Terminated(KeyboardInterrupt):
    """A polite kill. Python would end by SIGINT, whatever the exit code, had a plain
    KeyboardInterrupt passed through code that a library compiles from text."""


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """A polite kill tidies up as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        raise Terminated

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)

"""Long checks in pieces: work side by side in fresh processes, each result kept as it comes."""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sma_bench.parameters.yaml_file import write_text_atomically

PROCESSES = 2
Z_95 = 1.959964


def parser_of(name: str, description: str | None) -> argparse.ArgumentParser:
    """The parser of `./bench check NAME`, with the options of what is done in pieces."""
    parser = argparse.ArgumentParser(prog=f"bench check {name}", description=description)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--processes", type=int, default=PROCESSES, help="at once (default 2)")
    parser.add_argument(
        "--json", type=Path, metavar="FILE",
        help="keep every result in FILE as it comes; what is in it is not done again",
    )
    return parser


def in_pieces(
    run: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> list[Any]:
    """The result of every job, in the order of the jobs.

    Args:
        run: a function of a module, whose result is plain JSON.
        jobs: numbers, texts or tuples of them.
        options: of `parser_of`.
    """
    kept: dict[str, Any] = {}
    if options.json and options.json.is_file():
        kept = json.loads(options.json.read_text())
        if not isinstance(kept, dict):
            raise SystemExit(f"{options.json}: holds no results of this check")
    due = [job for job in jobs if str(job) not in kept]
    begun = time.monotonic()

    def keep(done: int, job: Any, result: Any) -> None:
        kept[str(job)] = result
        if options.json:
            write_text_atomically(options.json, json.dumps(kept, indent=1) + "\n")
        left = (time.monotonic() - begun) / done * (len(due) - done)
        if sys.stderr.isatty() or done % 5 == 0 or done == len(due):
            print(f"{done}/{len(due)}, {left:.0f} s left", file=sys.stderr, flush=True)

    if options.processes == 1 or len(due) == 1:
        for done, job in enumerate(due, 1):
            keep(done, job, run(job))
    else:
        # A fresh interpreter each: forked ones would inherit the threads of numpy and numba; and
        # linear algebra with threads of its own would only wait.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        with get_context("spawn").Pool(options.processes) as pool:
            for done, (job, result) in enumerate(
                pool.imap_unordered(partial(_labelled, run), due), 1
            ):
                keep(done, job, result)
    return [kept[str(job)] for job in jobs]


def _labelled(run: Callable[[Any], Any], job: Any) -> tuple[Any, Any]:
    return job, run(job)

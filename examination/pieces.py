"""The skeleton of a check: its options, its cases side by side, each result kept as it comes."""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from sma_bench.parameters.yaml_file import write_text_atomically

PROCESSES = 2
Z_95 = 1.959964
IN_PIECES = {
    "processes": (PROCESSES, "at once"),
    "json": (Path, "keep every result in this file as it comes; what is in it is not done again"),
}


def options_of(
    name: str, doc: str | None, argv: Sequence[str] | None, **own: tuple[Any, str]
) -> argparse.Namespace:
    """Options of `./bench check NAME`, of which `in_pieces` needs IN_PIECES.

    Args:
        own: default and help of each; False for a flag, several for a list, of texts the
            only ones that there are; a type where there is no default; ... for what must be given.
    """
    parser = argparse.ArgumentParser(prog=f"./bench check {name}", description=doc)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    for option, (default, text) in own.items():
        if default is ...:
            parser.add_argument(option, metavar=option.upper(), help=text)
            continue
        how: dict[str, Any] = {"type": type(default), "default": default}
        if default is False:
            how = {"action": "store_true"}
        elif isinstance(default, type):
            how = {"type": default}
        elif isinstance(default, tuple):
            how = {"type": type(default[0]), "default": default, "nargs": "+"}
            how |= {"choices": default} if isinstance(default[0], str) else {}
        elif default != "":
            text += f" (default {default})"
        parser.add_argument(f"--{option.replace('_', '-')}", help=text, **how)
    return parser.parse_args(argv)


def in_pieces(
    run: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> list[Any]:
    """The result of every job, in the order of the jobs.

    Args:
        run: a function of a module, whose result is plain JSON.
        jobs: numbers, texts or tuples of them.
        options: with IN_PIECES.
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
            found = pool.imap_unordered(partial(_labelled, run), due)
            for done, (job, result) in enumerate(found, 1):
                keep(done, job, result)
    return [kept[str(job)] for job in jobs]


def _labelled(run: Callable[[Any], Any], job: Any) -> tuple[Any, Any]:
    return job, run(job)


def print_coverage(deviations: Iterable[tuple[str, float]], limit: float) -> float:
    """A row a number, then of all: deviations from the truth in stated errors, the share of them
    within `limit`; that share of all."""
    found: dict[str, list[float]] = {}
    for name, z in deviations:
        found.setdefault(name, []).append(z)
    share = math.nan
    print(f"{'number':44s}{'n':>6s}{'inside':>8s}{'bias':>7s}{'rms z':>7s}")
    for name, own in [*found.items(), ("all", sum(found.values(), []))]:
        if own:
            share, rms = float(np.mean(np.abs(own) < limit)), math.sqrt(np.mean(np.square(own)))
            print(f"{name:44s}{len(own):6d}{share:8.1%}{np.median(own):+7.2f}{rms:7.2f}")
    return share

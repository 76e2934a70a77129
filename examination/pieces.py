"""Common parts of the checks: options, parallel cases with results stored as they come, tables."""

import argparse
import json
import math
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from scipy.stats import chi2

from sma_bench.parameters.yaml_file import write_text_atomically

Z_95 = 1.959964
_PATIENCE = 30.0
_SAVED_EVERY = 5.0  # s
AT_ONCE = {"processes": (2, "at once")}
IN_PIECES = AT_ONCE | {
    "json": (Path, "keep every result in this file as it comes; what is in it is not done again")}


def options_of(name: str, doc: str | None, argv: Sequence[str] | None,
               **own: tuple[Any, str]) -> argparse.Namespace:
    """Parsed options of `./bench check NAME`. `own`: (default, help) of each; default False: a
    flag; a tuple: several values, texts are the only choices; a type: no default; ...: the first
    argument; a list: arguments, each one of these."""
    prog = "./bench perf" if name == "perf" else f"./bench check {name}"
    parser = argparse.ArgumentParser(prog=prog, description=doc)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    for option, (default, text) in own.items():
        if default is ... or isinstance(default, list):
            several = {} if default is ... else {"nargs": "*", "choices": default, "default": []}
            parser.add_argument(option, metavar=option.upper(), help=text, **several)
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


def in_pieces(run: Callable[..., Any], jobs: Sequence[tuple],
              options: argparse.Namespace) -> list[Any]:
    """The results (plain JSON) of all jobs, which are arguments of a module's `run`, in order.
    `options` with AT_ONCE or IN_PIECES."""
    file, kept = getattr(options, "json", None), dict[str, Any]()
    if file and file.is_file():
        kept = json.loads(file.read_text())
        if not isinstance(kept, dict):
            raise SystemExit(f"{file}: holds no results of this check")
    due = [job for job in jobs if str(job) not in kept]
    workers = joblib.Parallel(min(options.processes, len(due)) or 1,
                              return_as="generator_unordered")
    begun = stored = time.monotonic()
    found = workers(joblib.delayed(_labelled)(run, job) for job in due)
    for done, (job, result) in enumerate(found, 1):
        kept[str(job)], now = result, time.monotonic()
        if now - stored > _SAVED_EVERY or done == len(due):
            stored = now
            if file:
                write_text_atomically(file, json.dumps(kept, indent=1) + "\n")
            left = (now - begun) / done * (len(due) - done)
            print(f"{done}/{len(due)}, {left:.0f} s left", file=sys.stderr, flush=True)
    return [kept[str(job)] for job in jobs]


def _labelled(run: Callable[..., Any], job: tuple) -> tuple[tuple, Any]:
    return job, run(*job)


def poisson_bound(count: int) -> float:
    """Upper 95 % limit of the mean of a Poisson distribution that gave this count."""
    return float(chi2.ppf(0.95, 2 * (count + 1)) / 2.0)


def print_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; columns whose title begins with > are flush right."""
    lines = [[title.lstrip(">") for title in head], *([str(cell) for cell in row] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = zip(head, line, widths, strict=True)
        shown = [c.rjust(w) if title[:1] == ">" else c.ljust(w) for title, c, w in cells]
        print("  ".join(shown).rstrip(), flush=True)


def print_coverage(deviations: Iterable[tuple[str, float]], limit: float) -> float:
    """Print a row per number and one for all: count, share within `limit`; returns that of all."""
    found: dict[str, list[float]] = {}
    for name, z in deviations:
        found.setdefault(name, []).append(z)
    share, rows = math.nan, []
    for name, own in [*found.items(), ("all", sum(found.values(), []))]:
        if own:
            share, rms = float(np.mean(np.abs(own) < limit)), math.sqrt(np.mean(np.square(own)))
            rows.append((name, len(own), f"{share:.1%}", f"{np.median(own):+.2f}", f"{rms:.2f}"))
    print_table(("number", ">n", ">inside", ">bias", ">rms z"), rows)
    return share


@contextmanager
def ros_node(name: str, namespace: str, **context: Any) -> Iterator[Any]:
    """A node of rclpy for a `with` block; arguments `context` are those of its own context."""
    import rclpy

    rclpy.init(args=[], **context)
    node = rclpy.create_node(name, namespace=namespace, **context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(**context)


def applies(rule: dict[str, Any], held: dict[str, Any]) -> bool:
    """True if each kind in `if` has one of the listed habits, and none in `but` does."""
    wanted, but = rule.get("if", {}), rule.get("but", {})
    has_none = all(held[kind] not in some for kind, some in but.items())
    return has_none and all(held[kind] in some for kind, some in wanted.items())


def without_exclusions(drawn: dict, habits: dict[str, list], rules: Iterable[dict]) -> dict:
    """The drawn habits, with excluded combinations changed as the rules say."""
    held = dict(drawn)
    for rule in rules:
        if applies(rule, held):
            held |= {kind: habits[kind][0] for kind in rule.get("plain", ())} | rule.get("then", {})
    return held


ROW = "{:44}{:>7}" + "{:>10}" * 5


def judged(name: str, doc: str | None, argv: Sequence[str] | None, what: str,
           judge: Callable[[int, int], dict[str, Any]], outcomes: Sequence[str],
           habits: dict[str, list]) -> list[dict[str, Any]]:
    """Judge files that are written with drawn habits: `judge(seed, number)` gives the habits of
    one, its outcome, why, whether it tells what it means, and maybe its kind. Prints the first
    wrong ones (the last two outcomes) and outcomes by habit and kind."""
    options = options_of(name, doc, argv, **{what: (200, "how many")}, seed=(1, "of all"),
                         **IN_PIECES)
    numbers = range(getattr(options, what))
    found = in_pieces(judge, [(options.seed, number) for number in numbers], options)
    wrong = [(number, one) for number, one in enumerate(found) if one["outcome"] in outcomes[-2:]]
    for number, one in wrong[:20]:
        odd = {kind: h for kind, h in one["habits"].items() if h != habits[kind][0]}
        print(f"{number} {one.get('kind', '')}: {one['why'][-300:]}\n    {odd}")
    kinds = sorted({one["kind"] for one in found if "kind" in one})
    groups = {**{f"{kind}: {habit}": [o for o in found if o["habits"].get(kind) == habit]
                 for kind, each in habits.items() for habit in each[1:]},
              **{f"a table of: {kind}": [o for o in found if o["kind"] == kind] for kind in kinds},
              "all": found,
              "that tell what they mean": [one for one in found if one["tells"]],
              "that do not": [one for one in found if not one["tells"]]}
    print(ROW.format(f"{name} with", what, *outcomes))
    for title, group in groups.items():
        if ends := [one["outcome"] for one in group]:
            print(ROW.format(title, len(ends), *map(ends.count, outcomes)))
    print(f"silently wrong {len(wrong)} of {len(found)} ({len(wrong) / len(found):.1%})")
    return found


# --- Limits of memory and time for a piece of a campaign.
class TooLong(Exception):
    """The work took longer than allowed."""


@contextmanager
def allowance(memory: int, seconds: float) -> Iterator[None]:
    """Raises MemoryError beyond `memory` additional bytes, TooLong beyond `seconds` of CPU time
    (user and system) or _PATIENCE times as much wall time. CPU time, because a busy machine is not
    a fault; wall time, because waiting on a pipe takes no CPU time. Main thread only, as it uses
    signals."""

    def too_long(number: int, _: object) -> None:
        waits = number == signal.SIGALRM
        raise TooLong(f"{'waits for' if waits else 'more than'} {seconds * (_PATIENCE**waits):g} s")

    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, hard = resource.getrlimit(resource.RLIMIT_AS)
    handlers = {n: signal.signal(n, too_long) for n in (signal.SIGPROF, signal.SIGALRM)}
    resource.setrlimit(resource.RLIMIT_AS, (mapped + memory, hard))
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, _PATIENCE * seconds)
    try:
        yield
    finally:
        for timer in (signal.ITIMER_PROF, signal.ITIMER_REAL):
            signal.setitimer(timer, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (before, hard))
        for number, handler in handlers.items():
            signal.signal(number, handler)

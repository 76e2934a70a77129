"""./bench blind: the withheld-effect check."""

import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from sma_bench.errors import InputError
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.results import write_result

# Modules that --help does not need are imported in the commands: cases import numba and scipy.

DIAGNOSE = (sys.executable, "-m", "sma_bench.cli", "diagnose")
LOADS = ("beam", "clamped", "force", "spring", "antagonist", "all")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; 0 on success, 2 on bad input with one line on standard error."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM cleans up, too
    try:
        blind.main(argv, "./bench blind", standalone_mode=False)
        return 0
    except (InputError, OSError, click.ClickException) as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        print(f"bench blind: {' '.join(text.split())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, click.Abort):
        print("bench blind: interrupted", file=sys.stderr)
        return 130


@click.group(help="Cases with withheld effects.")
def blind() -> None:
    pass


@blind.command("make", help="Make bags with hidden effects, which only a sealed file names.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), required=True,
              help="1000 to 1999, 3000 to 3999: development, 2000 to 2999: frozen, others: open")
@click.option("--n", type=click.IntRange(1, 9999), default=200, show_default=True, help="cases")
@click.option("--out", required=True, metavar="DIR", help="new folder")
@click.option("--load", type=click.Choice(LOADS), default="beam", help="what the wires pull")
@click.option("--jobs", type=click.IntRange(1, 64), default=os.cpu_count() or 1,
              help="processes; the result does not depend on it")
def make_cases(seed: int, n: int, out: str, load: str, jobs: int) -> None:
    from examination.blind.make import make
    manifest = make(out, seed, n, jobs, load)
    print(f"{out}: {n} cases of seed {seed} ({manifest['split']})")
    print(f"labels sealed, sha256 {manifest['sha256']}")


@blind.command("run", help="Run the diagnosis on every case.")
@click.argument("folder", metavar="DIR")
@click.option("--jobs", type=click.IntRange(1), default=2, help="cases at a time")
@click.option("--time-limit", type=click.FloatRange(0.0, min_open=True), default=120.0,
              help="s for a case, plus half of that for each further record")
def run_cases(folder: str, jobs: int, time_limit: float) -> None:
    from examination.blind.case_files import read_case_set
    from examination.blind.examination import Examinee, examine, open_cases
    cases = read_case_set(folder)
    waiting = open_cases(cases.names, cases.answers)
    failed = examine(Examinee(DIAGNOSE, time_limit), waiting, cases.folder, cases.answers, jobs)
    left = len(open_cases(cases.names, cases.answers))
    print(f"{folder}: {len(cases.names)} cases, {len(waiting)} asked, {failed} failed, {left} open")


@blind.command("score", help="Open the labels once all cases are answered; print all measures.")
@click.argument("folder", metavar="DIR")
@click.option("--jobs", type=click.IntRange(1), default=2, help="follow-ups at a time")
@click.option("--no-follow-up", is_flag=True, help="do not perform the suggested experiments")
@click.option("--ties-only", is_flag=True, help="perform only those that ambiguous answers suggest")
@click.option("--markdown", metavar="FILE", help="write the result as a page")
@click.option("--json", "result", metavar="FILE", help="write the result to FILE")
@click.option("--force", is_flag=True, help="replace outputs that exist")
def score_cases(folder: str, jobs: int, no_follow_up: bool, ties_only: bool, markdown: str | None,
                result: str | None, force: bool) -> None:
    from examination.blind.case_files import read_case_set
    from examination.blind.examination import Examinee, follow_up
    from examination.blind.score import handed_in, open_labels, page, score
    for path in (markdown, result):
        if path and Path(path).exists() and not force:
            message = "exists already, expected a new path; --force replaces it"
            raise InputError(f"{path}: {message}")
    cases = read_case_set(folder)
    handed_in(cases, cases.answers)
    labels = open_labels(cases)
    if not no_follow_up:
        follow_up(cases, labels, Examinee(DIAGNOSE), cases.answers, jobs, ties_only)
    scores = score(cases, labels, cases.answers)
    about = {"seed": cases.seed, "split": cases.split, "n": len(cases.names)}
    about["sha256"] = cases.sealed_sha256
    if result:
        write_result(result, {"set": about, "scores": {one.name: one.to_json() for one in scores}})
    path = Path(markdown or "results.md")
    text = page(cases, scores, path.name)
    print(text)
    if markdown:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, text)


@blind.command("features", help="Search development cases; store the inputs of the decision.")
@click.option("--seed", type=click.IntRange(3000, 3999), default=3000, show_default=True)
@click.option("--n", type=click.IntRange(1), default=800, show_default=True, help="cases")
@click.option("--out", required=True, metavar="FILE",
              help="a line for each case; an existing file is continued")
def keep_features(seed: int, n: int, out: str) -> None:
    from examination.blind.learn import keep_features
    keep_features(Path(out), seed, n)


@blind.command("learn", help="Fit the weights of the decision to stored features, cross-validated.")
@click.argument("features", metavar="[FILE...]", nargs=-1)
@click.option("--out", metavar="FILE", help="write the table of weights")
@click.option("--markdown", metavar="FILE", help="write the result as a page")
def learn_weights(features: tuple[str, ...], out: str | None, markdown: str | None) -> None:
    from examination.blind.learn import STORED, learn
    paths = [Path(path) for path in features] or [STORED]
    learn(paths, Path(out) if out else None, Path(markdown) if markdown else None)


if __name__ == "__main__":
    sys.exit(main())

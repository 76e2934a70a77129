"""sma-bench blind: the withheld-effect check; what examines and scores has files of its own."""

import argparse
import os
import time
from collections.abc import Callable
from typing import NamedTuple

from sma_bench.commands import blind_run, blind_score
from sma_bench.commands.blind_run import rivals
from sma_bench.commands.parser import command_parser, one_of
from sma_bench.commands.terminal import add_json_option, progress, results_apart, write_json
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.progress import counted, in_turn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: a sub-command and what is its own."""
    width = max(map(len, SHOWN))
    lines = "\n".join(f"  {name:{width}}  {command.text}" for name, command in SHOWN.items())
    parser.usage = "sma-bench blind COMMAND [options]"
    parser.epilog = (
        f"commands:\n{lines}\n\n{parser.epilog or ''}\n\n"
        "sma-bench blind COMMAND --help shows the options of a command."
    )
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND")
    parser.add_argument(
        "rest", nargs=argparse.REMAINDER, metavar="[options]", help=argparse.SUPPRESS
    )


def run(args: argparse.Namespace) -> int:
    """Hand over to the sub-command."""
    command = COMMANDS[args.command]
    parser = command_parser(f"blind {args.command}", command.text or None)
    command.add_arguments(parser)
    own = parser.parse_args(args.rest)
    with results_apart(own):
        return command.run(own)


# --- make: bags with effects that only a sealed file names.

def make_cases_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind make`."""
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


def make_cases(args: argparse.Namespace) -> int:
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


# --- figures: for every effect the record with it and without it.

def draw_figures_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind figures`."""
    parser.add_argument("--out", required=True, metavar="DIR", help="new folder")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="of the rig and its drive (default 1)"
    )
    add_json_option(parser, "what was drawn")


def draw_figures(args: argparse.Namespace) -> int:
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


# --- rival: a naive method in the place of the diagnosis.

def answer_as_rival_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `blind rival`: those of sma-bench diagnose after the rival's name."""
    parser.add_argument("rival", type=one_of(rivals))
    parser.add_argument("records", nargs="+", metavar="RECORD")
    parser.add_argument("--params", metavar="FILE", required=True)
    parser.add_argument("--hold-out", metavar="RECORD", nargs="+", default=[])
    add_json_option(parser, "the answer to the contract")
    parser.add_argument("--out", metavar="FILE", help="write the improved parameters")


def answer_as_rival(args: argparse.Namespace) -> int:
    """Answer one case."""
    from sma_bench.blind.rivals import rival_answer
    from sma_bench.records import read_record

    nominal = read_parameters(args.params)
    records = [read_record(path) for path in args.records]
    hold_out = [read_record(path) for path in args.hold_out]
    answer, improved = rival_answer(args.rival, records, hold_out, nominal)
    if args.out:
        comment = f"The rival {args.rival}: {answer['verdict']} {' '.join(answer['cause'])}"
        write_parameters(args.out, improved, comment.rstrip())
    if args.json:
        write_json(args.json, answer)
    print(answer["verdict"], *answer["cause"])
    return 0


class Command(NamedTuple):
    """A sub-command; one without a text is started by others, as a process of its own."""

    text: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


COMMANDS = {
    "make": Command(
        "bags with effects that only a sealed file names", make_cases_arguments, make_cases
    ),
    "run": Command(
        "put every case to the diagnosis, or to a naive rival",
        blind_run.add_arguments, blind_run.run,
    ),
    "score": Command(
        "open the labels and print every measure", blind_score.add_arguments, blind_score.run
    ),
    "figures": Command(
        "for every effect: the record with it and without it", draw_figures_arguments, draw_figures
    ),
    "rival": Command("", answer_as_rival_arguments, answer_as_rival),
}  # fmt: skip
# For people; the others are started by these.
SHOWN = {name: command for name, command in COMMANDS.items() if command.text}

"""./bench blind: the withheld-effect check."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from sma_bench.errors import InputError
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.parameters.yaml_file import write_text_atomically
from sma_bench.results import write_result

# What --help does without is loaded where it is needed: the cases bring numba and scipy along.

HERE = "examination.blind.command"
DIAGNOSE = (sys.executable, "-m", "sma_bench.cli", "diagnose")
DIAGNOSIS, BIC = "diagnosis", "bic"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command; 0 on success, 2 on bad input with one line on standard error."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a polite kill tidies up, too
    try:
        args = parser().parse_args(argv)
        args.run(args)
        return 0
    except (InputError, OSError) as error:
        print(f"bench blind: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("bench blind: interrupted", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def parser() -> argparse.ArgumentParser:
    """Of all sub-commands."""
    top = _Parser(prog="./bench blind", description="cases with withheld effects")
    commands = top.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    def command(run: Callable, text: str, name: str, **options: tuple[Any, str]) -> None:
        """Options by name: what add_argument takes or a default, and the help."""
        own = commands.add_parser(name, help=text, description=text)
        own.set_defaults(run=run)
        options["--json"] = ({"metavar": "FILE"}, "write the result to FILE")
        options["--force"] = ({"action": "store_true"}, "replace outputs that exist")
        for option, (how, text) in options.items():
            how = how if isinstance(how, dict) else {"type": type(how), "default": how}
            own.add_argument(option, help=text, **how)

    the_set = ({"metavar": "DIR"}, "folder that blind make has written")
    command(make_cases, "bags with effects that only a sealed file names", "make", **{
        "--seed": ({"type": int, "required": True},
                   "1000 to 1999: development, 2000 to 2999: frozen test, others: open"),
        "--n": (200, "cases (default 200)"),
        "--out": ({"required": True, "metavar": "DIR"}, "new folder"),
        "--load": ({"default": "beam", "choices": ("beam", "force", "spring", "antagonist")},
                   "what the wires pull against"),
        "--jobs": (os.cpu_count() or 1, "processes; the result does not depend on it"),
    })  # fmt: skip
    command(run_cases, "put every case to the diagnosis, or to a rival", "run", **{
        "set": the_set,
        "--rival": ({"choices": (BIC,)}, "a naive method instead of the diagnosis"),
        "--answers": ({"metavar": "DIR"}, "folder for the answers (default: DIR/answers/<who>)"),
        "--jobs": (2, "cases at a time"),
        "--time-limit": (120.0, "s for a case (half as long more a further record)"),
    })  # fmt: skip
    command(score_cases, "open the labels and print every measure", "score", **{
        "set": the_set,
        "--answers": ({"metavar": "DIR", "action": "append", "default": []},
                      "folder of answers (repeatable; default: all that lie in DIR/answers)"),
        "--jobs": (2, "follow-ups at a time"),
        "--no-follow-up": ({"action": "store_true"}, "do not perform what answers ask for"),
        "--markdown": ({"metavar": "FILE"}, "write the result page that a repository keeps"),
    })  # fmt: skip
    command(answer_as_rival, "answer one case as a rival does", "rival", **{
        "rival": ({"choices": (BIC,)}, "which one"),
        "records": ({"nargs": "+", "metavar": "RECORD"}, "bags"),
        "--params": ({"required": True, "metavar": "FILE"}, "what the lab believes"),
        "--hold-out": ({"metavar": "RECORD", "nargs": "+", "default": []}, "bags"),
        "--out": ({"metavar": "FILE"}, "write the improved parameters"),
    })  # fmt: skip
    return top


def make_cases(args: argparse.Namespace) -> None:
    """Make the set; all of it appears, or nothing."""
    from examination.blind.make import make

    manifest = make(args.out, args.seed, args.n, args.jobs, args.load)
    _write_json(args, {"set": args.out, **manifest})
    print(f"{args.out}: {args.n} cases of seed {args.seed} ({manifest['split']})")
    print(f"labels sealed, sha256 {manifest['sha256']}")


def run_cases(args: argparse.Namespace) -> None:
    """Ask what has no answer yet."""
    from examination.blind.case_files import Examination, read_case_set, write_examination
    from examination.blind.examination import Examinee, examine, open_cases

    for option, value in (("jobs", args.jobs), ("time-limit", args.time_limit)):
        if not value > 0:
            raise InputError(f"--{option} is {value:g}, expected more than 0")
    name = args.rival or DIAGNOSIS
    program = (sys.executable, "-m", HERE, "rival", name) if args.rival else DIAGNOSE
    cases = read_case_set(args.set)
    answers = Path(args.answers or cases.answers / name)
    write_examination(answers, Examination(name, program, args.time_limit, cases.sealed_sha256))
    waiting = open_cases(cases.names, answers)
    failed = examine(Examinee(program, args.time_limit), waiting, cases.folder, answers, args.jobs)
    left = len(open_cases(cases.names, answers))
    counts = {"cases": len(cases.names), "asked": len(waiting), "failed": failed, "open": left}
    _write_json(args, {"answers": str(answers), **counts})
    print(f"{answers}: {', '.join(f'{n} {what}' for what, n in counts.items())}")


def score_cases(args: argparse.Namespace) -> None:
    """Judge all complete answers; the labels stay sealed while one is missing."""
    from examination.blind.case_files import read_case_set
    from examination.blind.examination import Examinee, follow_up
    from examination.blind.page import page
    from examination.blind.score import followed_up, handed_in, open_labels, score

    _refuse_existing(args, args.markdown)
    cases = read_case_set(args.set)
    papers = handed_in(cases, [Path(folder) for folder in args.answers])
    labels = open_labels(cases)
    if not args.no_follow_up:
        for paper in papers:
            examinee = Examinee(paper.examination.program, paper.examination.time_limit)
            follow_up(cases, labels, examinee, paper.folder, args.jobs)
        papers += followed_up(papers)
    scores = score(cases, papers, labels)
    about = {"seed": cases.seed, "split": cases.split, "n": len(cases.names)}
    about["sha256"] = cases.sealed_sha256
    _write_json(args, {"set": about, "scores": {one.name: one.to_json() for one in scores}})
    path = Path(args.markdown or "results.md")
    text = page(cases, papers, scores, path.name)
    print(text)
    if args.markdown:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text_atomically(path, text)


def answer_as_rival(args: argparse.Namespace) -> None:
    """Answer one case."""
    from examination.blind.bic import bic_answer
    from sma_bench.records import read_record

    nominal = read_parameters(args.params)
    records, hold_out = ([read_record(p) for p in paths] for paths in (args.records, args.hold_out))
    answer, improved = bic_answer(records, hold_out, nominal)
    said = " ".join([answer["verdict"], *answer["cause"]])
    if args.out:
        _refuse_existing(args, args.out)
        write_parameters(args.out, improved, f"The rival {args.rival}: {said}")
    _write_json(args, answer)
    print(said)


def _write_json(args: argparse.Namespace, document: dict[str, Any]) -> None:
    if args.json:
        _refuse_existing(args, args.json)
        write_result(args.json, document)


def _refuse_existing(args: argparse.Namespace, path: str | None) -> None:
    if path and Path(path).exists() and not args.force:
        raise InputError(f"{path}: exists already, expected a new path; --force replaces it")


if __name__ == "__main__":
    sys.exit(main())

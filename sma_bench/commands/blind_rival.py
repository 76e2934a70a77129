"""sma-bench blind rival: a naive method in the place of the diagnosis, for the examination."""

import argparse

from sma_bench.blind.rivals import RIVALS, rival_answer
from sma_bench.commands.output import add_json_option, write_json
from sma_bench.parameters import read_parameters, write_parameters
from sma_bench.records import read_record


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: those of sma-bench diagnose after the rival's name."""
    parser.add_argument("rival", choices=RIVALS)
    parser.add_argument("records", nargs="+", metavar="RECORD")
    parser.add_argument("--params", metavar="FILE", required=True)
    parser.add_argument("--hold-out", metavar="RECORD", nargs="+", default=[])
    add_json_option(parser, "the answer to the contract")
    parser.add_argument("--out", metavar="FILE", help="write the improved parameters")


def run(args: argparse.Namespace) -> int:
    """Answer one case."""
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

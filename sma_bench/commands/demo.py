"""sma-bench demo: a simulated bench, identified and diagnosed through the real nodes.

Two acts (demo_acts): Table I of a wire, and a composite bench that hides an effect which the
diagnosis has to name.
"""

import time
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click

from sma_bench.commands.options import NEW, command, json_option, output
from sma_bench.commands.terminal import WorkState, output_console, write_json
from sma_bench.errors import InputError

_SEEDS = 2**31


@command(
    "demo --draw 3",
    "demo --out my_demo --draw 7 --json demo.json",
)
@output("--out DIR", NEW, "new folder (default: sma_bench_demo_<time>)")
@click.option(
    "--speed", type=float, default=40.0, metavar="X", help="at most X times real time (default 40)"
)
@click.option(
    "--draw",
    type=int,
    metavar="SEED",
    help="simulate a wire drawn at random around Table I instead of Table I itself, and hide "
    "the effect of this draw instead of one by the clock",
)
@click.option(
    "--paper",
    is_flag=True,
    help="Table I from the paper's own protocols, staircase and ramp, instead of the short "
    "quick_staircase and quick_ramp: a minute more",
)
@json_option("truth, estimates, diagnosis and the reports' paths")
@click.option(
    "--investigate",
    is_flag=True,
    help="instead of both acts, a bench in software, without ROS, whose first record leaves "
    "two causes: followed up until one is named (half a minute)",
)
def run(args: SimpleNamespace) -> int:
    """Both acts; 0 when Table I holds what the demo promises and the diagnosis is not confidently
    wrong, 1 when not."""
    from sma_bench.commands.demo_acts import (
        FITTED,
        QUICK,
        gap_act,
        investigation_act,
        planned,
        simulated_truth,
        table_act,
    )
    from sma_bench.commands.demo_stage import compiling_beside, make_folder

    console = output_console()
    if args.draw is not None and args.draw < 0:
        raise InputError(f"--draw is {args.draw}, expected 0 or more")
    out = Path(args.out or time.strftime("sma_bench_demo_%Y%m%d_%H%M%S"))
    make_folder(out)
    if args.investigate:
        act = investigation_act(console, out, args.draw or 0, args.command_line)
        if args.json:
            write_json(args.json, act)
        return 0 if act["holds"] else 1
    truth = simulated_truth(args.draw)
    fitted = FITTED if args.paper else QUICK
    first, second = planned(fitted, args.speed)
    state = WorkState(expected=first + second)
    share = first / (first + second)
    console.print("[bold]1. From a commanded volt to Table I[/]")
    seed = time.time_ns() % _SEEDS if args.draw is None else args.draw
    with compiling_beside() as compiler:
        first_act = table_act(console, out, fitted, args.speed, truth, share, state, compiler)
        console.print("\n[bold]2. The gap between simulation and bench[/]")
        second_act = gap_act(console, out / "simulated_gap", args.speed, seed, share, state)
    acts = {"table_one": first_act, "gap": second_act}
    console.print(f"{state.gone:.0f} s")
    if args.json:
        write_json(args.json, _document(out, acts))
    return 0 if all(act["holds"] for act in acts.values()) else 1


def _document(out: Path, acts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Truth, what was found, and where to read on."""
    kinds = {name: [act for act in acts if name in acts[act]] for name in ("truth", "report")}
    return {
        "synthetic": True,
        "folder": str(out),
        "holds": {name: act["holds"] for name, act in acts.items()},
        **{kind: {act: acts[act][kind] for act in given} for kind, given in kinds.items()},
        "estimates": acts["table_one"]["estimates"],
        **{key: acts["gap"][key] for key in ("diagnosis", "draw")},
    }

"""sma-bench demo: simulated benches, identified and diagnosed through the real nodes.

Two acts: Table I of a wire, and a composite bench that hides an effect which the diagnosis has to
name. A lab's file and two bags are all that the diagnosis sees.
"""

import time
from pathlib import Path
from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.commands.terminal import WorkState, output_console, progress, write_json
from sma_bench.errors import InputError

GONE = {
    "paper": "identify the bags of simulate --protocol staircase and --protocol ramp",
    "investigate": "investigate --simulated FILE plays it on any simulated bench",
    "hardware": "./bench check hardware shows it",
}
_SEEDS = 2**31


@options.command("demo")
def run(args: SimpleNamespace) -> int:
    """Both acts; 0 when Table I holds what the demo promises and the diagnosis is not confidently
    wrong, 1 when not."""
    from sma_bench.commands import demo_acts as acts
    from sma_bench.parameters import read_parameters, write_parameters
    from sma_bench.progress import COMPILING, part, shares

    for name, instead in GONE.items():
        if getattr(args, name):
            raise InputError(f"--{name} is gone: {instead}")
    if args.draw is not None and args.draw < 0:
        raise InputError(f"--draw is {args.draw}, expected 0 or more")
    truth, lab = acts.simulated_truth(args.draw), read_parameters(acts.lab_file())
    console = output_console()
    seed = time.time_ns() % _SEEDS if args.draw is None else args.draw
    out = Path(args.out or time.strftime("sma_bench_demo_%Y%m%d_%H%M%S"))
    acts.make_folder(out)
    plan = acts.planned(args.speed)
    between, state = shares(plan), WorkState(expected=sum(plan.values()))

    console.print("[bold]1. From a commanded volt to Table I[/]")
    with progress("demo", state) as report:
        steps = {step: part(report, *ends) for step, ends in between.items()}
        acts.wait_for_compiler(steps[COMPILING])
        answer, page = acts.identified(out, truth, args.speed, steps)
    estimates = answer["parameters"]
    holds = acts.print_table_one(console, out, answer, truth, page)

    console.print("\n[bold]2. The gap between simulation and bench[/]")
    console.print("Synthetic: a simulated bench that hides an effect from its lab, real nodes.")
    gap = out / "simulated_gap"
    acts.make_folder(gap)
    write_parameters(
        gap / "hidden.yaml", acts.hidden_bench(lab, seed), "The truth of the simulated bench."
    )
    with progress("demo", state) as report:
        steps = {step: part(report, *ends) for step, ends in between.items()}
        found = acts.diagnosed(gap, lab, args.speed, steps)
    hidden, pages = acts.print_gap(console, gap, found, seed)

    console.print(f"{state.gone:.0f} s")
    right = {"table_one": holds, "gap": not acts.confidently_wrong(found, hidden)}
    if args.json:
        write_json(args.json, {
            "synthetic": True, "folder": str(out), "holds": right,
            "truth": {
                "table_one": {name: truth[name] for name in acts.TABLE_ONE},
                "gap": {
                    "effect": acts.hidden_effect(hidden),
                    "numbers": dict(acts.hidden_numbers(hidden)),
                },
            },
            "report": {"table_one": str(page), "gap": str(pages)},
            "estimates": estimates, "diagnosis": found, "draw": seed,
        })  # fmt: skip
    return 0 if all(right.values()) else 1

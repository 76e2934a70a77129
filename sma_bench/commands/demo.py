"""sma-bench demo: simulated benches, identified and diagnosed through the real nodes."""

from types import SimpleNamespace

from sma_bench.commands import options
from sma_bench.errors import InputError


@options.command("demo")
def run(args: SimpleNamespace) -> int:
    """Both acts; 0 when Table I holds what the demo promises and the diagnosis is not confidently
    wrong, 1 when not."""
    from sma_bench.commands.demo_acts import play

    if args.draw is not None and args.draw < 0:
        raise InputError(f"--draw is {args.draw}, expected 0 or more")
    return play(args)

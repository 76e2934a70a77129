"""sma-bench run NODE [--ros-args ...]: the same entry points as `ros2 run sma_bench NODE`."""

import runpy
import sys
from types import SimpleNamespace

from sma_bench.commands import COMMANDS, options
from sma_bench.parameters.node_tables import NODE_TABLES

NETWORK_OPTION = "--network"


@options.command(
    "run",
    f"{COMMANDS['run']}\n\nnodes: {', '.join(sorted(NODE_TABLES))}",
    context_settings={
        "help_option_names": ["-h", "--help"],
        "ignore_unknown_options": True,
        "allow_interspersed_args": False,  # what follows NODE is the node's
    },
)
def run(args: SimpleNamespace) -> int:
    """Run a node until it ends. Raises InputError: no ROS 2 in this environment."""
    rest = list(args.rest)
    if network := rest[:1] == [NETWORK_OPTION]:
        from sma_bench.ros.processes import choose_discovery

        choose_discovery(network=True)
    sys.argv[1:] = [args.node, *rest[network:]]
    # As `python -m` would, and it ends this process: commands and nodes do not know of each other.
    with options.needs_ros("run"):
        runpy.run_module("sma_bench.nodes.start", run_name="__main__")
    return 0

"""sma-bench run NODE [--ros-args ...]: the same entry points as `ros2 run sma_bench NODE`."""

import runpy
import sys
from collections.abc import Sequence

from sma_bench.commands.parser import EXAMPLES, example_text
from sma_bench.errors import InputError
from sma_bench.parameters.node_tables import NODE_TABLES

NETWORK_OPTION = "--network"


def run(arguments: Sequence[str]) -> int:
    """Run a node until it ends.

    Raises:
        InputError: no such node, or no ROS 2 in this environment.
    """
    nodes = ", ".join(sorted(NODE_TABLES))
    if not arguments or arguments[0] in ("-h", "--help"):
        examples = example_text(EXAMPLES["run"])
        print(
            f"usage: sma-bench run NODE [{NETWORK_OPTION}] [--ros-args ...]\n\n"
            f"  {NETWORK_OPTION}  let other machines of the network reach the node; else this one\n"
            "             only, unless ROS_AUTOMATIC_DISCOVERY_RANGE is SUBNET\n\n"
            f"nodes: {nodes}\n\n{examples}"
        )
        return 0
    name, *rest = arguments
    network = rest[:1] == [NETWORK_OPTION]
    if name not in NODE_TABLES:
        raise InputError(f"run: no node {name!r}, expected one of: {nodes}")
    if network:
        from sma_bench.ros.processes import choose_discovery

        choose_discovery(network=True)
    sys.argv[1:] = [name, *rest[network:]]
    # As `python -m` would, and it ends this process: commands know of nodes as little as these of
    # commands.
    try:
        runpy.run_module("sma_bench.nodes.start", run_name="__main__")
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("sma_bench"):
            raise
        raise InputError(
            f"run: {error.name} is not installed: source a ROS 2 Jazzy setup file, or use ./bench"
        ) from None
    return 0

"""Commands for a running bench: start nodes, call services, show the dashboard."""

import re
import runpy
import signal
import sys
import time
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from sma_bench.border import MEGABYTE, read_json
from sma_bench.commands import COMMANDS, options
from sma_bench.commands.terminal import print_card, progress, say, write_json
from sma_bench.errors import InputError
from sma_bench.parameters.node_tables import NODE_TABLES

NETWORK_OPTION = "--network"
_LARGEST_ANSWER = 64 * MEGABYTE
_PRESENCE, _ANSWER = 10.0, 600.0  # s, timeouts for finding a node and for its answer
_NAME = re.compile(r"/?([A-Za-z_]\w*/)*[A-Za-z_]\w*|/", re.ASCII)


# All arguments after NODE are passed to the node.
@options.command("run", f"{COMMANDS['run']}\n\nnodes: {', '.join(sorted(NODE_TABLES))}",
                 ignore_unknown_options=True, allow_interspersed_args=False)
def run_run(args: SimpleNamespace) -> int:
    """Run a node until it ends. Raises InputError: ROS 2 is not installed."""
    rest = list(args.rest)
    if network := rest[:1] == [NETWORK_OPTION]:
        from sma_bench.ros.processes import choose_discovery

        choose_discovery(network=True)
    sys.argv[1:] = [args.node, *rest[network:]]
    # As `python -m` would; it ends this process. Commands do not import nodes.
    with options.needs_ros("run"):
        runpy.run_module("sma_bench.nodes.start", run_name="__main__")
    return 0


@options.command("call")
def run_call(args: SimpleNamespace) -> int:
    node, slash, service = args.service.strip("/").rpartition("/")
    if not slash:
        raise InputError(f"call: {args.service!r}, expected NODE/SERVICE, e.g. experiment/start")
    if not _NAME.fullmatch(args.service):
        raise InputError(f"call: {args.service!r} is not a ROS name, expected letters, digits, _ /")
    settings = dict(map(options.named_value, args.settings))
    with options.needs_ros("call"):
        from sma_bench.ros.bench_client import BenchClient

    def look() -> None:
        if found := client.progress(node):
            report(*found)

    name, namespace = f"{node}/{service}", options.namespace_of(args.namespace)
    with (progress(name) as report,
          BenchClient(namespace, look, options.ros_arguments(args)) as client):
        end = time.monotonic() + (args.patience or 0.0)
        client.follow(node)
        client.find(name, args.patience or _PRESENCE)
        if settings:
            client.set_parameters(node, settings)
        left = max(end - time.monotonic(), 0.0) if args.patience else _ANSWER
        answer = client.trigger(name, left)
    parsed: Any = answer
    with suppress(InputError):  # results are JSON themselves
        parsed = read_json(answer, "answer", _LARGEST_ANSWER)
    write_json(args.json, {"service": name, "answer": parsed})
    if isinstance(parsed, dict) and "card" in parsed:
        from sma_bench.diagnose.result import diagnosis_from
        from sma_bench.identify.result import identification_from

        read = diagnosis_from if "verdict" in parsed else identification_from
        print_card(read(parsed, name))
    else:
        say(answer.rstrip() or "done")
    return 0


@options.command("dashboard")
def run_dashboard(args: SimpleNamespace) -> int:
    """Serve until SIGINT or SIGTERM. InputError: no ROS 2, no tornado, or the port is in use."""
    import asyncio

    with options.needs_ros("dashboard"):
        from sma_bench.ros.dashboard import listening_node
    with options.needs_ros("dashboard", "apt install python3-tornado"):
        from sma_bench.dashboard.live_state import LiveState
        from sma_bench.dashboard.server import DashboardServer, is_loopback

    async def serve() -> None:
        loop = asyncio.get_running_loop()
        end: asyncio.Future[Any] = loop.create_future()

        def finish(error: Exception | None = None) -> None:
            if not end.done():
                end.set_exception(error) if error else end.set_result(None)

        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, finish)
        namespace = options.namespace_of(args.namespace)
        with listening_node(namespace, LiveState(),
                            lambda error: loop.call_soon_threadsafe(finish, error),
                            options.ros_arguments(args)) as node:
            namespace = node.get_namespace()  # --ros-args may have changed it
            server = DashboardServer(node, namespace, args.host, args.port)
            if not is_loopback(args.host):
                print("sma-bench: note: anyone on the network who has this address can see and "
                      "stop the bench; the connection is not encrypted", file=sys.stderr)
            print(f"dashboard of {namespace}, until Ctrl-C:\n{server.url}", flush=True)
            try:
                await end
            finally:
                await server.close()

    asyncio.run(serve())
    return 0

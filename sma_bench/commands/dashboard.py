"""sma-bench dashboard: a bench live in the browser, with a stop; for benches without Foxglove."""

import asyncio
import importlib
import signal
import sys
from types import SimpleNamespace
from typing import Any

from sma_bench.commands import options
from sma_bench.errors import InputError

_LARGEST_PORT = 65535


@options.command("dashboard")
def run(args: SimpleNamespace) -> int:
    """Serve until SIGINT or SIGTERM; 0 then. Raises InputError: no ROS 2 or no tornado here, a port
    that is taken, a namespace that cannot be."""
    if not 0 <= args.port <= _LARGEST_PORT:
        raise InputError(f"dashboard: --port is {args.port}, expected 0 to {_LARGEST_PORT}")
    with options.needs_ros("dashboard"):
        importlib.import_module("sma_bench.ros.dashboard")
    with options.needs_ros("dashboard", "apt install python3-tornado"):
        importlib.import_module("sma_bench.dashboard.server")
    return asyncio.run(_serve(args))


async def _serve(args: SimpleNamespace) -> int:
    from sma_bench.dashboard.live_state import LiveState
    from sma_bench.dashboard.server import DashboardServer, is_loopback
    from sma_bench.ros.dashboard import listening_node

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
        namespace = node.get_namespace()  # ROS's arguments may name another
        server = DashboardServer(node, namespace, args.host, args.port)
        if not is_loopback(args.host):
            print("sma-bench: note: others on the network who learn this address can see and stop "
                  "the bench; it is not encrypted", file=sys.stderr)
        print(f"dashboard of {namespace}, until Ctrl-C:\n{server.url}", flush=True)
        try:
            await end
        finally:
            await server.close()
    return 0

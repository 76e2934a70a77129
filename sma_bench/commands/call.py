"""sma-bench call NODE/SERVICE: what `ros2 service call` does, without a ROS 2 installation."""

import math
import re
import time
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from sma_bench.border import MEGABYTE, read_json
from sma_bench.commands import options
from sma_bench.commands.terminal import progress, say, write_json
from sma_bench.errors import InputError

_LARGEST_ANSWER = 64 * MEGABYTE
_PRESENCE, _ANSWER = 10.0, 600.0  # s within which a node has to be found, and to answer
_NAME = re.compile(r"/?([A-Za-z_]\w*/)*[A-Za-z_]\w*|/", re.ASCII)


@options.command("call")
def run(args: SimpleNamespace) -> int:
    node, slash, service = args.service.strip("/").rpartition("/")
    if not slash:
        raise InputError(f"call: {args.service!r}, expected NODE/SERVICE, e.g. experiment/start")
    if not _NAME.fullmatch(args.service):
        raise InputError(f"call: {args.service!r} is no ROS name, expected letters, digits, _, /")
    if args.patience is not None and not 0.0 < args.patience < math.inf:
        raise InputError(f"call: --patience is {args.patience:g} s, expected more than 0")
    answer = _call(args, node, service, dict(map(options.named_value, args.settings)))
    parsed: Any = answer
    with suppress(InputError):  # results are JSON themselves
        parsed = read_json(answer, "answer", _LARGEST_ANSWER)
    write_json(args.json, {"service": f"{node}/{service}", "answer": parsed})
    say(answer.rstrip() or "done")
    return 0


def _call(args: SimpleNamespace, node: str, service: str, settings: dict[str, Any]) -> str:
    with options.needs_ros("call"):
        from sma_bench.ros.bench_client import BenchClient
    with progress(f"{node}/{service}") as report:

        def look() -> None:
            if found := client.progress(node):
                report(*found)

        namespace = options.namespace_of(args.namespace)
        with BenchClient(namespace, look, options.ros_arguments(args)) as client:
            end = time.monotonic() + (args.patience or 0.0)
            client.follow(node)
            client.find(f"{node}/{service}", args.patience or _PRESENCE)
            if settings:
                client.set_parameters(node, settings)
            left = max(end - time.monotonic(), 0.0) if args.patience else _ANSWER
            return client.trigger(f"{node}/{service}", left)

"""Nodes as processes of a script, and who may reach them: only programs of this machine, unless
the user opens them to the network. No ROS.

Without SROS 2, anybody who reaches a bench may heat its wires. ROS's default is the whole subnet,
and the range LOCALHOST only stops a node from searching: a host that names this machine as a peer
still gets in. So a Fast DDS profile binds the sockets to 127.0.0.1, and the range is set to
SYSTEM_DEFAULT, as LOCALHOST would add sockets that are not bound, and shared memory."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

from sma_bench.errors import InputError
from sma_bench.installation import share_directory
from sma_bench.lifeline import tied_to_this_process

RANGE, PROFILE = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
THIS_MACHINE, NETWORK, BY_PROFILE = "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"
_PROFILES = (PROFILE, "FASTDDS_DEFAULT_PROFILES_FILE")  # its name in later releases
# Also on the network nodes use no shared memory; the profile says why.
TRANSPORTS, _SOCKETS = "FASTDDS_BUILTIN_TRANSPORTS", "UDPv4"
# Without it Fast DDS also reads a profile from the working directory, which may not be trusted.
_NO_OTHER_PROFILE = "SKIP_DEFAULT_XML_FILE"
_ONLY, _SERVER, _PEERS = "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS"
_MIDDLEWARE = "RMW_IMPLEMENTATION"
USERS_VARIABLES = (RANGE, _ONLY, _SERVER, _PEERS, TRANSPORTS, *_PROFILES)
_END_TIMEOUT = 8.0  # s for a node to end, after each of three signals
_PRIVATE_DOMAINS = range(120, 220)


def discovery_variables(network: bool,
                        environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Variables for a node: open to the network, else as the user has set them, else local."""
    def is_set(*names: str) -> bool:
        return any(environment.get(name) for name in names)

    sockets = {} if is_set(TRANSPORTS) else {TRANSPORTS: _SOCKETS}
    if network:
        return {RANGE: NETWORK} | sockets
    bound = environment.get(PROFILE) == _own_profile()  # by a parent process
    # Do the user's own variables ask for the network? ROS reads them in this order.
    only, chosen = environment.get(_ONLY), environment.get(RANGE)
    asked = is_set(_SERVER) or (chosen in (NETWORK, BY_PROFILE) if chosen else bool(only))
    if asked and only != "1" and not bound:
        return sockets
    if is_set(*_PROFILES) and not bound:  # the user's profile may not bind any socket
        return {} if is_set(RANGE, _ONLY) else {RANGE: THIS_MACHINE}
    variables = dict.fromkeys(_PROFILES, _own_profile()) | {_NO_OTHER_PROFILE: "1"}
    if chosen != "OFF":
        variables[RANGE] = BY_PROFILE
    return variables | ({_ONLY: ""} if only else {})


def choose_discovery(network: bool = False,
                     environment: MutableMapping[str, str] = os.environ) -> None:
    """Set them for this process before ROS starts; prints which variables have no effect."""
    variables = discovery_variables(network, environment)
    if PROFILE in variables:
        middleware = environment.get(_MIDDLEWARE, "")
        if environment.get(_PEERS):
            print(f"sma_bench: note: {_PEERS} has no effect, nodes are bound to this machine: "
                  f"{RANGE}={NETWORK} opens them", file=sys.stderr)
        if middleware and "fastrtps" not in middleware:
            print(f"sma_bench: note: {_MIDDLEWARE} is {middleware}: only Fast DDS is bound to this "
                  "machine by sma_bench", file=sys.stderr)
    if network and environment.get(PROFILE) == _own_profile():
        for name in (*_PROFILES, _NO_OTHER_PROFILE):
            environment.pop(name, None)
    environment.update(variables)


def private_ros_environment() -> None:
    """Isolate this process and its nodes from other benches: own domain, this machine only."""
    for name in USERS_VARIABLES:
        os.environ.pop(name, None)
    choose_discovery()
    os.environ["ROS_DOMAIN_ID"] = str(_PRIVATE_DOMAINS[os.getpid() % len(_PRIVATE_DOMAINS)])


def _own_profile() -> str:
    return str(share_directory() / "config" / "dds" / "this_machine.xml")


def parameter_arguments(parameters: Mapping[str, Any]) -> list[str]:
    """ROS arguments that set parameters."""
    given = [f"{key}:={json.dumps(value)}" for key, value in parameters.items()]  # valid YAML
    return [word for value in given for word in ("-p", value)]


class NodeProcesses(contextlib.AbstractContextManager["NodeProcesses"]):
    """Nodes of this package in one namespace; they end with the context or with this process."""

    def __init__(self, namespace: str, logs: Path) -> None:
        self._namespace, self._logs = namespace, logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __exit__(self, *_: object) -> None:
        for name in reversed(list(self._running)):
            self.end(name)

    def start(self, name: str, parameters: Mapping[str, Any],
              files: tuple[str | Path, ...] = ()) -> None:
        """Start a node with parameter files and, over them, single parameters."""
        command = [sys.executable, "-m", "sma_bench.nodes.start", name, "--ros-args"]
        command += ["-r", f"__ns:={self._namespace}"]
        command += [word for file in files for word in ("--params-file", str(file))]
        command += parameter_arguments(parameters)
        with open(self._logs / f"{name}.log", "ab") as log:
            self._running[name] = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                env=tied_to_this_process())

    def check(self) -> None:
        """InputError when a node has ended by itself, with the last line of its log."""
        for name, process in self._running.items():
            if process.poll() is not None:
                log = (self._logs / f"{name}.log").read_text(errors="replace").split("\n")
                last = next((line for line in reversed(log) if line.strip()), "no output")
                words = last.partition("]: ")[2] if last.startswith("[") else last
                raise InputError(f"node {name} ended: {words}")

    def pid(self, name: str) -> int:
        return self._running[name].pid

    def end(self, name: str) -> None:
        """End a node by SIGINT, then SIGTERM, then SIGKILL."""
        process = self._running.pop(name)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_END_TIMEOUT)

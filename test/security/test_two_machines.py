"""A second machine (a network namespace without shared memory) against a bench on this one."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from sma_bench.ros.processes import RANGE, USERS_VARIABLES

ROOT = Path(__file__).resolve().parents[2]
BENCH, STRANGER = "10.77.16.1", "10.77.16.2"
# All settings with which nodes are local to this machine, and none at all.
BOUND = {"default": {}, "range": {RANGE: "LOCALHOST"}, "only": {"ROS_LOCALHOST_ONLY": "1"},
         "peers": {"ROS_STATIC_PEERS": STRANGER}}  # fmt: skip
OPEN = {"open": {RANGE: "SUBNET"}}
NODE = [sys.executable, "-m", "sma_bench.nodes.start", "experiment"]
PATIENCE = 90.0
# Calls `stop` in every namespace that it finds, until all awaited ones have answered, and longer.
CALLER = """
import json, sys, time
import rclpy
from std_srvs.srv import Trigger
awaited, extra = set(sys.argv[1].split(",")), float(sys.argv[2])
rclpy.init()
node = rclpy.create_node("caller")
names = sys.argv[3].split(",")
clients = {name: node.create_client(Trigger, f"/{name}/experiment/stop") for name in names}
asked, due, answers, seen = [], dict.fromkeys(names, 0.0), {}, set()
end = time.monotonic() + 45.0
while (now := time.monotonic()) < end:
    rclpy.spin_once(node, timeout_sec=0.02)
    seen |= {namespace for _, namespace in node.get_node_names_and_namespaces()}
    for name, client in clients.items():
        # Again: an answer to a client that the server has not matched yet is lost.
        if name not in answers and now > due[name] and client.service_is_ready():
            asked.append((name, client.call_async(Trigger.Request())))
            due[name] = now + 1.0
    answers = {name: f.result().message for name, f in asked if f.done()}
    if awaited and awaited <= answers.keys():
        awaited, end = set(), time.monotonic() + extra
print(json.dumps([answers, sorted(name for name in names if f"/{name}" in seen)]))
"""


def ip(words):
    subprocess.run(["ip", *words.split()], check=True, capture_output=True, text=True, timeout=30)


@pytest.fixture
def two_machines():
    """Names of two connected network namespaces."""
    if shutil.which("ip") is None or shutil.which("unshare") is None:
        pytest.skip("no ip, unshare here (Debian packages iproute2, util-linux)")
    first, second = names = [f"sma{os.getpid()}{side}" for side in "ab"]
    try:
        try:
            for name in names:
                ip(f"netns add {name}")
            ip(f"link add {first} netns {first} type veth peer name {second} netns {second}")
            for name, address in zip(names, (BENCH, STRANGER), strict=True):
                ip(f"-n {name} addr add {address}/24 dev {name}")
                for device in ("lo", name):
                    ip(f"-n {name} link set {device} up")
            inside(second, ["true"], own_memory=True).wait(30.0)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no network namespaces here: {error.stderr.strip()}")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


def inside(namespace, command, variables=None, own_memory=False):
    """Start a program on one of the machines; of discovery only `variables` are set."""
    start = ["ip", "netns", "exec", namespace]
    if own_memory:
        mount = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"'
        start += ["unshare", "--mount", "sh", "-c", mount, "sh"]
    clean = {name: value for name, value in os.environ.items() if name not in USERS_VARIABLES}
    environment = {**clean, "PYTHONPATH": str(ROOT), **(variables or {})}
    return subprocess.Popen(start + command, env=environment, stdout=subprocess.PIPE,
                            stderr=subprocess.DEVNULL, text=True, cwd=ROOT)  # fmt: skip


def test_another_machine_neither_sees_nor_stops_a_bench_unless_it_was_opened(
    two_machines, ros_domain
):
    here, there = two_machines
    everything = {**BOUND, **OPEN}
    names, nodes = ",".join(everything), {}
    call = [sys.executable, "-c", CALLER]
    try:
        for name, variables in everything.items():
            arguments = ["--ros-args", "-r", f"__ns:=/{name}"]
            nodes[name] = inside(here, [*NODE, *arguments], variables)
        here_too = inside(here, [*call, names, "0", names])
        local, _ = json.loads(here_too.communicate(timeout=PATIENCE)[0])
        ended = {name: one.returncode for name, one in nodes.items() if one.poll() is not None}
        missing = everything.keys() - local.keys()
        assert not missing, f"programs of this machine reach all of them; ended: {ended}"
        peer = {"ROS_STATIC_PEERS": BENCH}
        stranger = inside(there, [*call, "open", "3", names], peer, own_memory=True)
        answers, seen = json.loads(stranger.communicate(timeout=PATIENCE)[0])
    finally:
        for node in nodes.values():
            node.kill()
            node.wait()
    assert answers == {"open": "aborted: stopped on request"}
    assert seen == ["open"]

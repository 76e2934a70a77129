"""Compares the SROS 2 policy with the nodes: every topic and service of each.

Creates every node in this process, for both rigs, lists what it publishes, subscribes, serves and
calls, and compares that with config/sros2/policy.xml. `--write` writes the policy from it.

    ./bench check policy [--write]
"""

import tempfile
from collections.abc import Sequence
from difflib import unified_diff
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import rclpy
import yaml

from examination.pieces import options_of
from sma_bench.hardware.thermal_image import regions_side_by_side
from sma_bench.nodes.start import node_class
from sma_bench.parameters import read_parameters
from sma_bench.parameters.node_tables import NODE_TABLES
from sma_bench.ros.processes import private_ros_environment

ROOT = Path(__file__).resolve().parents[2]
POLICY = ROOT / "config" / "sros2" / "policy.xml"
NAMESPACE = "/bench"
RIGS = ("wire_rig.yaml", "composite_rig.yaml")
DASHBOARD = "dashboard"
# Attribute in sros2's policy, by kind of topic or service.
KINDS = {"publish": ("topics", "topic"), "subscribe": ("topics", "topic"),
         "reply": ("services", "service"), "request": ("services", "service")}  # fmt: skip
_ADDED = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())
CONTRACT, LISTENERS = _ADDED["contract"], _ADDED["listeners"]
_CLOCK, _PICTURE = "/clock", (382, 288)
# Node -> kind of KINDS -> names, relative to the namespace or absolute.
Rules = dict[str, dict[str, set[str]]]


def nodes_rules() -> Rules:
    private_ros_environment()
    rules: Rules = {name: {kind: set() for kind in KINDS} for name in (*NODE_TABLES, DASHBOARD)}
    for name, rig in product(NODE_TABLES, RIGS):
        if name == "deflection_controller" and rig == RIGS[0]:
            continue  # there is no deflection of a single wire
        file = ROOT / "config" / rig
        channels = read_parameters(file)["bench.channels"]
        with tempfile.TemporaryDirectory() as folder:
            # Topics and services that every node needs.
            needed = {"recorder": {"output": Path(folder, "bag")},
                      "serial_bridge": {"port": "/dev/no_such_port"},
                      "ir_camera": {"image_width": _PICTURE[0], "image_height": _PICTURE[1],
                                    "regions": list(regions_side_by_side(len(channels), *_PICTURE))}
                      }.get(name, {})
            words = [word for key, value in needed.items() for word in ("-p", f"{key}:={value}")]
            rclpy.init(args=["--ros-args", "-r", f"__ns:={NAMESPACE}", "--params-file", str(file),
                             *words])  # fmt: skip
            node = node_class(name)()
            try:
                found = {"publish": {publisher.topic_name for publisher in node.publishers},
                         "subscribe": {s.topic_name for s in node.subscriptions} | {_CLOCK},
                         "reply": {service.service_name for service in node.services},
                         "request": {client.service_name for client in node.clients}}
            finally:
                node.close()
                node.destroy_node()
                rclpy.try_shutdown()
        # `*/power` of /bench/front_1/power, `~start` of /bench/experiment/start.
        own = f"{NAMESPACE}/{name}/"
        for kind, names in found.items():
            for absolute in names:
                parts = absolute.removeprefix(f"{NAMESPACE}/").split("/")
                shared = "/".join("*" if part in channels else part for part in parts)
                is_own = absolute.startswith(own)
                rules[name][kind].add("~" + absolute.removeprefix(own) if is_own else shared)
    for name in LISTENERS:
        rules[name]["subscribe"] |= set(CONTRACT)
    for kind, names in _ADDED[DASHBOARD].items():
        rules[DASHBOARD][kind] |= set(names)
    return rules


def policy_of(rules: Rules) -> str:
    """The policy file that allows exactly these names."""
    policy = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(policy, "enclaves")
    for node in sorted(rules):
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"{NAMESPACE}/{node}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        profile = ElementTree.SubElement(profiles, "profile", ns=NAMESPACE, node=node)
        for kind, (group, item) in KINDS.items():
            if names := sorted(rules[node][kind]):
                allowed = ElementTree.SubElement(profile, group, {kind: "ALLOW"})
                for name in names:
                    ElementTree.SubElement(allowed, item).text = name
    ElementTree.indent(policy)
    head = ('<?xml version="1.0" encoding="UTF-8"?>\n<!-- Topics and services of each node: '
            "docs/threats.md. Written from the nodes by ./bench check policy with its option "
            "write. -->\n")
    return head + ElementTree.tostring(policy, encoding="unicode") + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """0 if the policy allows exactly the names of the nodes."""
    options = options_of("policy", __doc__, argv, write=(False, "write the policy from the nodes"))
    wanted = policy_of(nodes_rules())
    if options.write:
        POLICY.write_text(wanted)
    texts = (text.splitlines() for text in (POLICY.read_text(), wanted))
    wrong = [*unified_diff(*texts, "allowed", "used", lineterm="")]
    print(*wrong, f"{len(NODE_TABLES) + 1} nodes, {len(wrong)} lines of difference", sep="\n")
    return 1 if wrong else 0

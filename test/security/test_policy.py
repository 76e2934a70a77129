"""The SROS 2 policy allows exactly what the contract and the nodes need."""

from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from examination.check import policy
from sma_bench.parameters.node_tables import NODE_TABLES  # noqa: E402

ALLOWED = {}
for profile in ElementTree.parse(policy.POLICY).getroot().iter("profile"):
    rules = ALLOWED.setdefault(profile.attrib["node"], {kind: set() for kind in policy.KINDS})
    for group in profile:
        for kind in group.attrib:
            rules[kind] |= {entry.text for entry in group}


@pytest.mark.slow
def test_every_node_may_do_what_it_does_and_no_more(ros_domain, as_any_process) -> None:
    assert policy.policy_of(policy.nodes_rules()) == policy.POLICY.read_text()


def test_the_policy_has_every_node_and_topic_and_nobody_may_do_everything() -> None:
    assert policy.policy_of(ALLOWED) == policy.POLICY.read_text()
    assert set(ALLOWED) == {*NODE_TABLES, policy.DASHBOARD}
    assert set(policy.CONTRACT) <= ALLOWED["recorder"]["subscribe"]
    commanders = {node for node, rules in ALLOWED.items() if "voltage_command" in rules["publish"]}
    assert commanders == {"experiment", "temperature_controller", "deflection_controller",
                          policy.DASHBOARD}  # fmt: skip
    rules = [rule for kinds in ALLOWED.values() for names in kinds.values() for rule in names]
    assert not [rule for rule in rules if not rule.replace("*", "").strip("/~")]

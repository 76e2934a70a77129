"""The SROS 2 policy allows exactly what the contract and the nodes need."""

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from examination.check import policy
from sma_bench.parameters.node_tables import NODE_TABLES  # noqa: E402


@pytest.mark.slow
def test_every_node_may_do_what_it_does_and_no_more(ros_domain, as_any_process) -> None:
    found = policy.nodes_rules()
    allowed = policy.read_policy()
    assert policy.missing_rules(found, allowed) == {}
    assert policy.missing_rules(allowed, found) == {}


def test_the_policy_has_every_node_and_topic_and_nobody_may_do_everything() -> None:
    allowed = policy.read_policy()
    assert set(allowed) == {*NODE_TABLES, policy.DASHBOARD}
    wanted = {"recorder": {"subscribe": set(policy.CONTRACT)}}
    assert policy.missing_rules(wanted, allowed) == {}
    commanders = {node for node, rules in allowed.items() if "voltage_command" in rules["publish"]}
    assert commanders == {"experiment", "temperature_controller", "deflection_controller",
                          policy.DASHBOARD}  # fmt: skip
    rules = [rule for kinds in allowed.values() for names in kinds.values() for rule in names]
    assert not [rule for rule in rules if not rule.replace("*", "").strip("/~")]
    # A missing rule is found.
    allowed["simulator"]["subscribe"].discard("voltage_command")
    wanted = {"simulator": {"subscribe": {"voltage_command"}}}
    assert policy.missing_rules(wanted, allowed) == wanted

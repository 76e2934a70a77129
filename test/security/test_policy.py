"""The SROS 2 policy lists what the contract and the nodes themselves have, and no more."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed")

from examination.check import policy
from sma_bench.parameters.node_tables import NODE_TABLES  # noqa: E402


@pytest.mark.slow
def test_every_node_may_do_what_it_does_and_no_more(ros_domain) -> None:
    found = policy.nodes_rules()
    allowed = policy.read_policy()
    assert policy.missing_rules(found, allowed) == {}
    assert policy.missing_rules(allowed, found) == {}


def test_every_topic_of_the_contract_is_recorded_and_every_node_has_a_profile() -> None:
    allowed = policy.read_policy()
    assert set(allowed) == {*NODE_TABLES, policy.DASHBOARD}
    wanted = {"recorder": {"subscribe": set(policy.CONTRACT)}}
    assert policy.missing_rules(wanted, allowed) == {}


def test_only_what_drives_may_command_and_nobody_may_do_everything() -> None:
    allowed = policy.read_policy()
    commanders = {node for node, rules in allowed.items() if "voltage_command" in rules["publish"]}
    assert commanders == {
        "experiment", "temperature_controller", "deflection_controller", policy.DASHBOARD,
    }  # fmt: skip
    rules = [rule for kinds in allowed.values() for names in kinds.values() for rule in names]
    assert not [rule for rule in rules if not rule.replace("*", "").strip("/~")]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('version="0.2.0"', 'version="0.1.0"'),
        ('publish="ALLOW"', 'publish="PERHAPS"'),
        ("<enclaves>", "<contexts>"),
        ("<topic>/rosout</topic>", "<service>/rosout</service>"),
    ],
)
def test_a_policy_that_sros2_would_refuse_is_refused(tmp_path: Path, old: str, new: str) -> None:
    text = policy.POLICY.read_text()
    assert old in text
    bad = text.replace(old, new).replace("</enclaves>", f"</{new[1:-1]}>" if "<c" in new else
                                         "</enclaves>")  # fmt: skip
    path = tmp_path / "policy.xml"
    path.write_text(bad)
    with pytest.raises(ValueError, match="expected"):
        policy.read_policy(path)


def test_a_rule_that_is_missing_is_found() -> None:
    allowed = policy.read_policy()
    allowed["simulator"]["subscribe"].discard("voltage_command")
    wanted = {"simulator": {"subscribe": {"voltage_command"}}}
    assert policy.missing_rules(wanted, allowed) == wanted

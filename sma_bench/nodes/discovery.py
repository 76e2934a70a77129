"""Who may find the nodes: programs of this machine alone, unless the user opens them. No ROS.

Without SROS 2, whoever finds a bench may heat its wires. ROS's own default is the whole subnet.
"""

import os
from collections.abc import Mapping, MutableMapping

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
THIS_MACHINE, NETWORK = "LOCALHOST", "SUBNET"
# Any of these is the user's own word about discovery.
_USERS_WORD = (RANGE, "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER")


def discovery_range(network: bool, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Variables to set for a node: open to the network, else what the user has set, else local."""
    if network:
        return {RANGE: NETWORK}
    if any(environment.get(name) for name in _USERS_WORD):
        return {}
    return {RANGE: THIS_MACHINE}


def choose_discovery(
    network: bool = False, environment: MutableMapping[str, str] = os.environ
) -> None:
    """Set them for this process; before ROS starts in it."""
    environment.update(discovery_range(network, environment))

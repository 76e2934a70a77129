"""ROS for nodes and commands: context, QoS, discovery, a client of a bench, its dashboard."""

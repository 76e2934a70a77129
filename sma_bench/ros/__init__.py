"""What nodes and commands know of ROS: its context and QoS, who may reach it, a bench's client."""

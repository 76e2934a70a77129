"""Thin ROS 2 nodes: messages in, a call into the other packages, messages out."""

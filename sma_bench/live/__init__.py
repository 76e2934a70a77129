"""A running bench without ROS: a run of a protocol or controller, its recording, a simulation."""

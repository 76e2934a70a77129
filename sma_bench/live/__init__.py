"""What a running bench does, without ROS: a run of a protocol or controller, its recording."""

"""A bench without hardware: the real firmware on an emulated Uno, wires at its pins. No ROS."""

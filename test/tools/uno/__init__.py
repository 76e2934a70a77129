"""A bench without hardware or ROS: real firmware on an emulated Uno, with simulated wires."""

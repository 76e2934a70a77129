"""What stands between a command and a hot wire: safety rules and instruments, without ROS."""

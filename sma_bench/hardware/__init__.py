"""Safety rules, the link to the device, its sensors, images of the infrared camera. No ROS."""

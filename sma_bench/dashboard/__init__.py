"""A live page of a bench in the browser: its contents, access to it, the stop. No ROS."""

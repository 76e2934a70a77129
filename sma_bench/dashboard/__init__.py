"""A live page of a bench in the browser: what is shown, who may see it, the stop. No ROS."""

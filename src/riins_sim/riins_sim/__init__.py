"""The simulated ship and its sensors. ROS lives in `nodes/` alone."""

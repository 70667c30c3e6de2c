"""The ROS nodes of this package: parameters in, messages out, no mathematics."""

"""Fusion of redundant single-axis inertial sensors. ROS lives in `node.py` alone."""

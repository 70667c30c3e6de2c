"""The federated navigation filter. ROS lives in `node.py` alone."""

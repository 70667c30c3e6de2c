"""What every RIINS node shares: parameters, running, QoS, message conversion. The only package of shared code that knows ROS."""

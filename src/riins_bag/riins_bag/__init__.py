"""Recording, reading, recovering and playing of rosbag2/MCAP bags. ROS lives in `nodes/` alone."""

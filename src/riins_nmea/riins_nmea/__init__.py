"""The bridge of the ship: NMEA 0183 out and in, heave and attitude at the IMU rate. ROS lives in `nodes/` alone."""

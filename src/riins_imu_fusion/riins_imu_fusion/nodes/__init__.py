"""Nodes beside `imu_fusion`, one file each."""

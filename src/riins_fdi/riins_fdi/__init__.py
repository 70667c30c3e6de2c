"""Fault detection for everything: parity space, innovation tests, the health machine. No ROS here."""

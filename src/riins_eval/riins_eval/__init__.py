"""Offline engine, importers, metrics, report and studies. No ROS here."""

"""Alignment: finding attitude from the IMU itself, at rest, swaying at a mooring, and (with riins_federated) under way.

Lives here: coarse, stationary, redundant (raw outputs of all sensors), swaying, and the observability of each model; plain arrays and masks.
Does not live here: alignment that needs aids or their health (riins_federated.alignment_*), nodes, recordings.
"""

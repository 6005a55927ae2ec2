"""Shared interface: samples, the rig and its calibration, recordings, tables and trajectories."""

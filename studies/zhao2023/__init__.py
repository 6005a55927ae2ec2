"""Zhao et al. 2023: odometry, terrain map and locomotion modes."""

"""Walks over ground, with gaits, cameras and light of many kinds, drawn from seeds."""

"""Sensor parts of a rig: one YAML file per part with the figures of its data sheet, and their reader."""

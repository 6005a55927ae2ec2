"""Faults between a sensor and the recorder."""

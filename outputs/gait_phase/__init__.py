"""Gait phase of each leg: run, files, scores, figures."""

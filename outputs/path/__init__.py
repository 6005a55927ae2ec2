"""Paths: run, files, scores, figures."""

"""Terrain maps: run, files, scores, figures."""

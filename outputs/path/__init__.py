"""Estimated paths of a foot or of a camera: run, files, scores, figures."""

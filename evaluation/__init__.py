"""Estimates compared with the truth: alignment, metrics, scores."""

"""Corruptions of good recordings: which are reported with their cause, and which change an estimate in silence."""

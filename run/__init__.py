"""Estimators of every kind on a recording, or on samples that arrive live."""

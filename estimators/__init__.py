"""The estimators: hardware modules that read streams and know nothing of the twin."""

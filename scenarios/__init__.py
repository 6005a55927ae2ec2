"""Scenarios: the catalogue, the runner, the scores, the report and the command line."""

"""The regression gate, which compares estimators with a baseline: statistics over walks, verdicts, output formats."""

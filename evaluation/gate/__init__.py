"""The gate: has an estimator become worse since a baseline? Statistics over walks, verdicts, what they are told in."""

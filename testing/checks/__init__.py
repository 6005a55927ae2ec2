"""The checks: each takes a `Subject` and raises `ConformanceError` if the estimator fails it."""

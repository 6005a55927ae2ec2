"""Speed and memory of the twin and the estimators: `python -m benchmarks.speed NAME`."""

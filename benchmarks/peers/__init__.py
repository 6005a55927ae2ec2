"""Programs of other visual odometries, each run by the benchmark's own Python environment on an RGB-D folder."""

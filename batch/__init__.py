"""Many independent jobs, such as walks: run here, on processes or on a cluster, with rows that a later run reuses."""

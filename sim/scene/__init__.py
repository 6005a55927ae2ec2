"""The scene of a walk as MJCF files, which MuJoCo loads without StrideTwin."""

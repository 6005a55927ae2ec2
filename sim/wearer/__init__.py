"""The person and the exoskeleton: sizes, bodies, joints, couplings."""

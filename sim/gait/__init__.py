"""The reference gait: route to footsteps, foot paths, pelvis and trunk path, and joint angles."""

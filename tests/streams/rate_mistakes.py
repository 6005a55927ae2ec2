"""Usual mistakes in the angular rates of a recording, for the tests of both checks that look for them."""

import numpy as np

DEGREE = np.pi / 180
RATE_MISTAKES = [
    (np.eye(3) / DEGREE, "the rates are in °/s"),
    (np.eye(3) * DEGREE, "the rates are in rad/s, and were taken for °/s"),
    (1000 * np.eye(3), "the rates are 1000 times too large"),
    (2 * np.eye(3), "the rates are twice too large"),
    (np.eye(3)[[1, 0, 2]], "the axes x, y, z of the forces are y, x, z of the rates"),
    (np.eye(3)[[1, 2, 0]], "the axes x, y, z of the forces are z, x, y of the rates"),
    (np.diag([1.0, -1.0, 1.0]), "the axes x, y, z of the forces are x, -y, z of the rates"),
    (-np.eye(3), "the axes x, y, z of the forces are -x, -y, -z of the rates"),
]
"""Matrices (3, 3) by which right rates are multiplied, and the cause that a check has to name."""

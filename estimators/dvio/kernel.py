"""The compiled functions that Python calls."""

from __future__ import annotations

from pathlib import Path

from stridetwin.estimators import cholesky, matrices
from stridetwin.estimators.compiled import cached
from stridetwin.estimators.dvio import imu_factors, landmarks, nav_state, patches, plane_cells, projection, solver

_called = cached(Path(__file__).parent, error_model="numpy")

inverse = _called(matrices.inverse)
integrate, increment_residual = _called(imu_factors.integrate), _called(imu_factors.increment_residual)
add_increment, plausible = _called(nav_state.add_increment), _called(nav_state.plausible)
pose_and_covariance = _called(nav_state.pose_and_covariance)
view, add_inertial = _called(projection.view), _called(imu_factors.add_inertial)
add_camera_factors = _called(landmarks.add_camera_factors)
solve, move, marginalize = _called(cholesky.solve), _called(solver.move), _called(solver.marginalize)
predict_observations, cull = _called(landmarks.predict_observations), _called(landmarks.cull)
parallax, rehost = _called(landmarks.parallax), _called(landmarks.rehost)
cornerness, pick, read_depth = _called(patches.cornerness_at), _called(patches.pick), _called(patches.read_depth)
cut, align, read_slope = _called(patches.cut), _called(patches.align), _called(patches.read_slope)
read_planes = _called(plane_cells.read_planes)

"""The compiled functions that Python calls."""

from __future__ import annotations

from pathlib import Path

from stridetwin.estimators import cholesky, matrices
from stridetwin.estimators.compiled import cached
from stridetwin.estimators.dvio import imu_factors, landmarks, nav_state, patches, plane_cells, projection, solver

_called = cached(Path(__file__).parent, error_model="numpy")

inverse, solve, move = _called(matrices.inverse), _called(cholesky.solve), _called(solver.move)
integrate, motion = _called(imu_factors.integrate), _called(imu_factors.motion)
add_increment, plausible = _called(nav_state.add_increment), _called(nav_state.plausible)
pose_covariance = _called(nav_state.pose_covariance)
view, add_inertial = _called(projection.view), _called(imu_factors.add_inertial)
predict_observations, parallax = _called(landmarks.predict_observations), _called(landmarks.parallax)
add_camera_factors, cull = _called(landmarks.add_camera_factors), _called(landmarks.cull)
cornerness, pick, read_depth = _called(patches.cornerness_at), _called(patches.pick), _called(patches.read_depth)
cut, align = _called(patches.cut), _called(patches.align)
read_planes = _called(plane_cells.read_planes)

"""The compiled functions that Python calls."""

from __future__ import annotations

from pathlib import Path

from stridetwin.estimators.dvio import imu_factors, landmarks, nav_state, patches, plane_cells, projection, solver
from stridetwin.streams.algebra import matrices
from stridetwin.streams.compiled import entry_kernel

_entry_kernel = entry_kernel(Path(__file__).parent, error_model="numpy")

inverse, solve, apply_step = (
    _entry_kernel(matrices.inverse),
    _entry_kernel(matrices.solve_damped),
    _entry_kernel(solver.apply_step),
)
integrate, imu_residual = _entry_kernel(imu_factors.integrate), _entry_kernel(imu_factors.write_imu_residual)
add_increment, is_plausible = _entry_kernel(nav_state.add_increment), _entry_kernel(nav_state.is_plausible)
pose_covariance = _entry_kernel(nav_state.pose_covariance)
update_views, add_imu_factors = _entry_kernel(projection.update_views), _entry_kernel(imu_factors.add_imu_factors)
predict_observations, parallax = _entry_kernel(landmarks.predict_observations), _entry_kernel(landmarks.parallax)
add_camera_factors, cull = _entry_kernel(landmarks.add_camera_factors), _entry_kernel(landmarks.cull)
cornerness, pick, read_depth = (
    _entry_kernel(patches.cornerness_at),
    _entry_kernel(patches.pick),
    _entry_kernel(patches.read_depth),
)
cut_patches, align = _entry_kernel(patches.cut_patches), _entry_kernel(patches.align)
read_planes = _entry_kernel(plane_cells.read_planes)

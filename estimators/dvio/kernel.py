"""The compiled functions that Python calls."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stridetwin.estimators.compiled import cached
from stridetwin.estimators.dvio import imu_factors, landmarks, nav_state, patches, plane_cells, planes, solver

_called = cached(Path(__file__).parent, error_model="numpy")


@_called
def integrate_into(zs, k, imu, start_ns, end_ns, bias, noise):  # type: ignore[no-untyped-def]
    """`imu_factors.integrate` into the `k`-th of an array, with its inverse covariance."""
    z = imu_factors.preintegration_at(zs, k)
    imu_factors.integrate(z, imu, start_ns, end_ns, bias, noise)
    z.weight[:] = np.linalg.inv(z.covariance)


integrate = _called(imu_factors.integrate)
propagate, plausible = _called(nav_state.propagate), _called(nav_state.plausible)
pose_and_covariance = _called(nav_state.pose_and_covariance)
minimise, marginalize_oldest = _called(solver.minimise), _called(solver.marginalize_oldest)
predict_observations, cull = _called(landmarks.predict_observations), _called(landmarks.cull)
parallax = _called(landmarks.parallax)
pick, read_depth = _called(patches.pick), _called(patches.read_depth)
cut, align, read_slope = _called(patches.cut), _called(patches.align), _called(patches.read_slope)
read_planes = _called(plane_cells.read_planes)
match_planes, add_plane = _called(planes.match_planes), _called(planes.add_plane)

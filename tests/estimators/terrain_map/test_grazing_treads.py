"""Stairs in a single image from in front, whose upper treads are seen at grazing angles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from stridetwin.estimators.terrain_map import TerrainMap
from stridetwin.streams.rig import Rig
from tests.estimators.terrain_map.scenes import FLOOR, RIG, Box, attitude, cast, depth, pose

WIDTH, HEIGHT, FOCAL = 512, 424, 365.3
NOISE_PER_M, RISER, TREAD, STEPS = 0.0015, 0.10, 0.28, 5
CAMERA = replace(
    RIG.cameras["/head/color"], width=WIDTH, height=HEIGHT, intrinsics=(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2)
)
STAIRS = [
    FLOOR,
    *(
        Box(x=(TREAD * k, TREAD * (k + 1 + (k == STEPS - 1)) + 0.01), y=(-0.4, 0.4), z=(-1.0, RISER * (k + 1)))
        for k in range(STEPS)
    ),
]


def see_stairs(eye_m, away_m, pitch_deg, seed):
    """The estimate from one image of a depth camera with time of flight, noise correlated over a few pixels."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u, float)], -1).reshape(-1, 3)
    eye, R = np.array([-away_m, 0.05, eye_m]), attitude(0.0, math.radians(pitch_deg))
    pixels = cast(STAIRS, eye, rays @ R.as_matrix().T).reshape(HEIGHT, WIDTH)
    pixels[pixels > 4.5] = 0.0
    noise = gaussian_filter(rng.standard_normal(pixels.shape), 1.5)
    pixels = np.round(pixels + NOISE_PER_M * pixels**2 * noise / noise.std(), 3)
    terrain_map = TerrainMap(Rig(cameras={"/head/color": CAMERA}))
    terrain_map.update(pose(0, eye, R))
    estimate = terrain_map.update(depth(0, pixels.astype(np.float32)))
    assert estimate is not None
    return estimate


@pytest.mark.parametrize(
    ("eye_m", "away_m", "pitch_deg"), [(0.9, 0.9, 30.0), (0.9, 1.2, 30.0), (1.1, 1.2, 25.0), (1.3, 0.9, 25.0)]
)
def test_one_image_shows_the_treads_at_grazing_angles(eye_m, away_m, pitch_deg):
    for seed in range(3):
        estimate = see_stairs(eye_m, away_m, pitch_deg, seed)
        assert sum(flight.steps for flight in estimate.stairs) in (STEPS - 1, STEPS)
        flight = max(estimate.stairs, key=lambda found: found.steps)
        assert flight.riser == pytest.approx(RISER, abs=0.004)
        assert flight.tread == pytest.approx(TREAD, abs=0.01)

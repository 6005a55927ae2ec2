"""Left and right exchanged: detected from images, named, and no false alarm."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.foot_to_foot.shoe_rig import LeftRightCheck, Shoes, shoes_of
from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.sensors.standard_rig import standard_rig
from stridetwin.streams.errors import StrideTwinError

CORNERS = 0.005 * np.array(
    [[x, y, 0.0] for x in (-2, -1, 0, 1, 2) for y in (-3.5, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.5)]
)


@pytest.fixture(scope="module")
def shoes() -> Shoes:
    config = TwinConfig(name="walk", route=Route(segments=(Level(length_m=3.0),)))
    return shoes_of(standard_rig(config))


def attitudes(rng: np.random.Generator, swing: float) -> np.ndarray:
    """(2, 3, 3) of two feet that point forward about, one of them pitched by up to `swing`."""
    pitch = np.zeros(2)
    pitch[rng.integers(2)] = rng.uniform(-0.3, 1.0) * swing
    return np.array([Rotation.from_euler("zy", [rng.normal(0, 0.1), p]).as_matrix() for p in pitch])


def observation(shoes: Shoes, t_ns: int, shoe: int, R: np.ndarray, rng: np.random.Generator) -> BoardObservation:
    """What the camera that really is on a shoe sees of the other's board, 0.3 m before it."""
    R_imu = Rotation.from_quat(shoes.mounts[:, 3:], scalar_first=True).as_matrix()
    R_camera_board = R_imu[shoe].T @ R[shoe].T @ R[1 - shoe] @ R_imu[2 + 1 - shoe]
    p = CORNERS @ R_camera_board.T + [0.02, -0.01, 0.3]
    rays = p[:, :2] / p[:, 2:] + rng.normal(0.0, 1e-4, (len(p), 2))
    return BoardObservation(topic="", t_ns=t_ns, points_in_board=CORNERS, rays=rays, ray_sd=np.full(len(p), 1e-4))


def agreements(shoes: Shoes, imus: int, cameras: int, swing: float, images: int = 100) -> list[bool]:
    """What is said of each image where IMUs and cameras may be exchanged."""
    rng, worn, said = np.random.default_rng(5), LeftRightCheck(shoes.mounts), []
    for k in range(images):
        R, camera = attitudes(rng, swing), int(rng.integers(2))
        seen = observation(shoes, k * 100_000_000, camera ^ cameras, R, rng)
        said.append(worn.agrees(seen, camera, R[::-1] if imus else R))
    return said


@pytest.mark.parametrize("swing", [0.0, 1.0])
def test_every_image_is_used_where_the_rig_is_right(shoes: Shoes, swing: float) -> None:
    assert all(agreements(shoes, 0, 0, swing))


@pytest.mark.parametrize(
    ("imus", "cameras", "words"),
    [(0, 1, "the cameras sit"), (1, 0, "the IMUs sit"), (1, 1, "IMUs and cameras sit")],
)
def test_an_exchange_is_named_in_a_walk(shoes: Shoes, imus: int, cameras: int, words: str) -> None:
    with pytest.raises(StrideTwinError, match=words):
        agreements(shoes, imus, cameras, 1.0)


@pytest.mark.parametrize("imus", [0, 1])
def test_no_image_of_exchanged_cameras_is_used(shoes: Shoes, imus: int) -> None:
    assert not any(agreements(shoes, imus, 1, 0.0, images=20))


def test_images_close_together_count_once(shoes: Shoes) -> None:
    rng, worn = np.random.default_rng(1), LeftRightCheck(shoes.mounts)
    R = attitudes(rng, 1.0)
    for k in range(1000):  # 50 ms in all
        assert not worn.agrees(observation(shoes, k * 49_000, 1, R, rng), 0, R)

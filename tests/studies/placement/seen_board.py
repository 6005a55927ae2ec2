"""A camera at rest, a board that goes wherever a test says, and a ball that may be in the way."""

import numpy as np

from stridetwin.sim.config import Level, Route
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.wearer.limbs import Limbs
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.rig import Board, CameraCalibration, Mount
from stridetwin.studies.placement.visibility import PosedWalk

OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # looks forward
FACING_BACK = np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
BOARD = Board(name="foot_r", mount=Mount(body="foot_r", T_body_sensor=FACING_BACK), squares=(6, 9), square_m=0.005)
BALL = {"kind": np.array([2]), "size": np.array([[0.03, 0, 0]]), "reach": np.array([0.03])}
EXPOSURE_S = 0.002


def camera(model="radtan", distortion=(0.0, 0.0, 0.0, 0.0), T=OPTICAL, body="foot_l"):
    return CameraCalibration(
        topic="/foot_l/camera",
        part="c",
        rate_hz=60,
        mount=Mount(body=body, T_body_sensor=T),
        width=800,
        height=600,
        intrinsics=(540.0, 540.0, 399.5, 299.5),
        distortion_model=model,
        distortion=distortion,
    )


def walk(p_board, v_board=None, ball=(0.0, 0.0, -9.0)):
    """A camera at rest at 0.5 m, a board wherever it is asked to be, and a ball."""
    n = len(p_board)
    zero, level = np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    still = {"t_ns": np.arange(n), "q_world_body": level, "v_body_in_world": zero, "w_body": zero}
    moving = still if v_board is None else still | {"v_body_in_world": v_board}
    limbs = Limbs(**BALL, p=np.tile(ball, (n, 1, 1)), R=np.tile(np.eye(3), (n, 1, 1, 1)))
    return PosedWalk(
        bodies={
            "foot_l": Track(p_body_in_world=zero + [0.0, 0.0, 0.5], **still),
            "foot_r": Track(p_body_in_world=np.asarray(p_board, float), **moving),
        },
        limbs=limbs,
        terrain=Terrain.from_route(Route(segments=(Level(length_m=8.0),))),
        ground=np.tile([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [2.0, 3.0, 0.0]], (n, 1, 1)),
    )

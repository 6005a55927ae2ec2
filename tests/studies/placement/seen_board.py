"""A camera at rest, a board that goes wherever a test says, and a ball that may be in the way."""

import numpy as np

from stridetwin.sim.config import Level, Route
from stridetwin.sim.wearer.limbs import Limbs
from stridetwin.sim.world.terrain import Terrain
from stridetwin.streams.rig import Board, CameraCalibration, Mount
from stridetwin.studies.placement.visibility import Moving, PosedWalk

OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # looks forward
FACING_BACK = np.array([[0.0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
BOARD = Board(name="foot_r", mount=Mount(body="foot_r", T_body_sensor=FACING_BACK), squares=(6, 9), square_m=0.005)
BALL = {"kind": np.array([2]), "size": np.array([[0.03, 0, 0]]), "reach": np.array([0.03])}
EXPOSURE_S = 0.002


def camera(model="radtan", distortion=(0.0, 0.0, 0.0, 0.0), T=OPTICAL, body="foot_l"):
    return CameraCalibration(
        topic="/foot_l/camera", part="c", rate_hz=60, mount=Mount(body=body, T_body_sensor=T), width=800, height=600,
        intrinsics=(540.0, 540.0, 399.5, 299.5), distortion_model=model, distortion=distortion,
    )  # fmt: skip


def walk(p_board, v_board=None, ball=(0.0, 0.0, -9.0)):
    """A camera at rest at 0.5 m, a board wherever it is asked to be, and a ball."""
    n = len(p_board)
    T = np.tile(np.eye(4), (n, 1, 1))
    still, moving = T.copy(), T.copy()
    still[:, 2, 3] = 0.5
    moving[:, :3, 3] = p_board
    zero = np.zeros((n, 3))
    limbs = Limbs(**BALL, p=np.tile(ball, (n, 1, 1)), R=np.tile(np.eye(3), (n, 1, 1, 1)))
    return PosedWalk(
        bodies={
            "foot_l": Moving(T_world_body=still, v=zero, w=zero),
            "foot_r": Moving(T_world_body=moving, v=zero if v_board is None else v_board, w=zero),
        },
        limbs=limbs,
        terrain=Terrain.from_route(Route(segments=(Level(length_m=8.0),))),
        ground=np.tile([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [2.0, 3.0, 0.0]], (n, 1, 1)),
    )

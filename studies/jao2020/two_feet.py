"""Runs every method of the foot-to-foot filter on the samples of one walk, and scores the paths.

The published methods get the relative positions that follow from the boards detected by our detector. All methods get
the initial poses of the feet.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Literal, TypedDict

import numpy as np
from scipy.spatial.transform import Rotation

from stridetwin.estimators.base import PROPOSED, Options
from stridetwin.estimators.foot_ins import FootInsPath, StartPose
from stridetwin.estimators.foot_to_foot import Aiding, FootToFoot, FootToFootEstimate, RelativePosition, follow
from stridetwin.outputs.alignment import Rigid, vertical_rotation
from stridetwin.outputs.parameters import parameter_keywords
from stridetwin.outputs.path.scores import CHI2_3_95, PathComparison, compare, nees_position
from stridetwin.outputs.truth import TruePath
from stridetwin.streams.rig import Mount, Rig
from stridetwin.streams.samples import Array, Block, Image, Imu, Range, Sample

FEET = ("l", "r")
MethodName = Literal["zupt", "zupt_relative_distance", "zupt_relative_position", "proposed"]
PUBLISHED: tuple[MethodName, ...] = ("zupt", "zupt_relative_distance", "zupt_relative_position")
"""Methods of Jao, Wang and Shkel 2020."""
COMPARED_METHODS: tuple[MethodName, ...] = (*PUBLISHED, "proposed")
"""Theirs, then ours."""
_NOT_ALIGNED = Rigid(R=np.eye(3), t=np.zeros(3))  # leaves a path as it is
_ROTATION_SD_RAD = 0.1  # rad that a foot may rotate between an image and the estimate that follows it

FootPaths = dict[str, FootInsPath]
"""Estimated path of each foot's IMU, by `l` and `r`."""


class MeasurementRecorder(FootToFoot):
    """Our filter, which also records the measurements that the published one would derive from the observed boards.

    Args:
        rig: The nominal rig.
        start: Pose of each foot's IMU at its first sample.

    Attributes:
        relative: Relative positions of the feet so far, as the published filter takes them.
        observations: Number of board observations.
    """

    def __init__(self, rig: Rig, start: Mapping[str, StartPose]) -> None:
        super().__init__(rig, start=start, **parameter_keywords(FootToFoot, PROPOSED))
        self.relative: list[RelativePosition] = []
        self.observations = 0
        self._rig = rig

    def update(self, sample: Imu | Image | Aiding) -> FootToFootEstimate | None:
        """Updates the filter with a sample and records the relative position that each board observation gives."""
        estimate = super().update(sample)
        for observation in estimate.observations if estimate else ():  # boards seen in this image
            assert estimate is not None
            self.observations += 1
            foot = self._rig.cameras[observation.topic].mount.body[len("foot_")]  # `l` of the body `foot_l`
            other_foot = "r" if foot == "l" else "l"
            T_imu_camera = _in_imu(self._rig, foot, self._rig.cameras[observation.topic].mount)
            T_other_board = _in_imu(self._rig, other_foot, self._rig.boards[f"foot_{other_foot}"].mount)
            # prior of the board's orientation: the rotation between the feet's IMUs by the filter's attitudes
            R_world = {f: Rotation.from_quat(e.pose.q_world_frame, scalar_first=True) for f, e in estimate.feet.items()}
            R_imu_other = (R_world[foot].inv() * R_world[other_foot]).as_matrix()
            relative = RelativePosition.of_observation(
                observation,
                T_imu_camera=T_imu_camera,
                T_other_board=T_other_board,
                R_camera_board=T_imu_camera[:3, :3].T @ R_imu_other @ T_other_board[:3, :3],
                rotation_sd=_ROTATION_SD_RAD,
            )
            self.relative += [relative] if relative else []  # None: the observation gives no position
        return estimate


def _in_imu(rig: Rig, foot: str, mount: Mount) -> Array:
    """(4, 4) pose of a part on a foot in the frame of that foot's IMU."""
    return np.asarray(np.linalg.inv(rig.imu(f"/foot_{foot}/imu").mount.T_body_sensor) @ mount.T_body_sensor)


def true_start(truth: Mapping[str, TruePath]) -> dict[str, StartPose]:
    """Poses of both IMUs at the first instant of their truth."""
    return {
        f: StartPose(p_imu_in_world=t.p_frame_in_world[0], q_world_imu=t.q_world_frame[0]) for f, t in truth.items()
    }


def run_every_method(
    rig: Rig, imus: Mapping[str, Block[Imu]], samples: Iterable[Sample], start: Mapping[str, StartPose]
) -> tuple[dict[str, FootPaths], int]:
    """Estimates the paths of both feet by each of `COMPARED_METHODS`.

    Args:
        rig: The nominal rig.
        imus: All samples of each foot, by `l` and `r`.
        samples: Samples of the IMUs with images and sonar ranges, in time order.
        start: Pose of each foot's IMU at its first sample.

    Returns:
        Paths by method and foot, and the number of board observations.
    """
    # our method runs first; meanwhile what the published ones get is recorded: relative positions and sonar ranges
    recorder = MeasurementRecorder(rig, start)
    echoes: list[Range] = []
    proposed = follow(recorder, _record_echoes(samples, echoes))
    paths: dict[str, FootPaths] = {
        method: FootToFoot(
            rig, options=Options(method=method), start=start, **parameter_keywords(FootToFoot, method)
        ).run(imus, [*recorder.relative, *echoes])
        for method in PUBLISHED
    }
    return paths | {"proposed": proposed}, recorder.observations


def _record_echoes(samples: Iterable[Sample], echoes: list[Range]) -> Iterator[Sample]:
    """Passes on the samples, and adds their sonar ranges to `echoes`."""
    for sample in samples:
        if isinstance(sample, Range):
            echoes.append(sample)
        yield sample


class FootScores(TypedDict):
    """Scores of the paths of both feet, see `score_paths` for each of them; lists are of left and right.

    The errors in `end_error_m` are lists themselves: x, y, z of the world.
    """

    end_error_m: list[list[float]]
    end_error_pct: list[float]
    end_nees: list[float]
    nees_mean: list[float]
    nees_within_95_pct: list[float]
    coverage_pct: list[float]
    feet_disagree_rms_m: float
    feet_disagree_max_m: float


def score_paths(paths: FootPaths, truth: Mapping[str, TruePath]) -> FootScores:
    """Scores of the paths of both feet, ready for JSON; lists are of the left and the right foot.

    Args:
        paths: Estimated path of each foot's IMU, by `l` and `r`.
        truth: True path of each.

    Returns:
        `end_error_m`: (3,) estimated minus true position at the end in world axes. `end_error_pct`: its horizontal
        size, relative to the horizontal distance that the foot has walked. `end_nees`, `nees_mean` and
        `nees_within_95_pct`: NEES of the position, at the end, mean, and share within its 95 % bound. `coverage_pct`:
        share of the truth's time before the last estimate, where the end is scored. `feet_disagree_rms_m` and
        `feet_disagree_max_m`: error of the right IMU's position relative to the left one, in the left one's heading.
    """
    # each foot's path beside its truth; not aligned, because the filter starts at the true poses
    in_world = {f: compare(paths[f].trajectory, truth[f], transform=_NOT_ALIGNED) for f in FEET}
    apart_m = feet_disagreement_m(in_world)
    scores: FootScores = {
        "end_error_m": [],
        "end_error_pct": [],
        "end_nees": [],
        "nees_mean": [],
        "nees_within_95_pct": [],
        "coverage_pct": [],
        "feet_disagree_rms_m": float(np.sqrt(np.mean(apart_m**2))),
        "feet_disagree_max_m": float(apart_m.max()),
    }
    for foot, compared in in_world.items():
        nees = nees_position(compared)  # (K,) NEES of the position along the path
        end_m = compared.error_m[-1]  # (3,) error at its end
        # horizontal distance that the foot has walked
        walked_m = np.linalg.norm(np.diff(compared.truth.p_frame_in_world[:, :2], axis=0), axis=1).sum()
        t_ns = truth[foot].t_ns  # stamps of the whole truth
        last_ns = compared.truth.t_ns[-1]  # stamp of the last estimate
        scores["end_error_m"].append(end_m.tolist())
        scores["end_error_pct"].append(100.0 * float(np.linalg.norm(end_m[:2]) / walked_m))
        scores["end_nees"].append(float(nees[-1]))
        scores["nees_mean"].append(float(nees.mean()))
        # up to the 95 % quantile of the chi-squared distribution with three degrees of freedom
        scores["nees_within_95_pct"].append(100.0 * float(np.mean(nees <= CHI2_3_95)))
        scores["coverage_pct"].append(100.0 * float((last_ns - t_ns[0]) / (t_ns[-1] - t_ns[0])))
    return scores


def feet_disagreement_m(in_world: Mapping[str, PathComparison]) -> Array:
    """(K,) m, error of the right IMU's position relative to the left one, at the K stamps that both paths have.

    The estimated relative position is rotated about the vertical so that the left IMU's heading is correct, because a
    common heading drift is no disagreement of the feet.

    Args:
        in_world: Estimate and truth of each foot's IMU in the world, by `l` and `r`.
    """
    left, right = in_world["l"], in_world["r"]
    # numbers of the common stamps in both paths
    _, in_left, in_right = np.intersect1d(left.estimate.t_ns, right.estimate.t_ns, return_indices=True)
    # (K, 3) m from the left IMU to the right one, in world axes
    estimated = right.estimate.p_frame_in_world[in_right] - left.estimate.p_frame_in_world[in_left]
    true = right.truth.p_frame_in_world[in_right] - left.truth.p_frame_in_world[in_left]
    q_est, q_true = (
        Rotation.from_quat(path.q_world_frame[in_left], scalar_first=True) for path in (left.estimate, left.truth)
    )
    # (K, 3, 3) from the estimated heading of the left foot to the true one
    turn = vertical_rotation((q_true * q_est.inv()).as_matrix())
    return np.asarray(np.linalg.norm(np.einsum("nij,nj->ni", turn, estimated) - true, axis=1))

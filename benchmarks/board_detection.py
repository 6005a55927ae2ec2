"""Detection of the other shoe's board in rendered images of the twin: detection rate, accuracy and CPU time.

`python -m benchmarks.board_detection [--json] [--seeds 1000 ...] [--scenarios level_20m ...] [--exposure-ms 2]`. Each
walk is simulated from its seed; images have the blur and the noise of the twin's camera. The detector gets a
prediction, as from a filter: the true pose with an error of 5 mm and 1 degree, and the motion in the image with an
error of 10 %. Every fourth image is also searched without a prediction. A detection is wrong if any corner is off by
more than a third of a square, and false if the board faces away from the camera or is outside the image. A board
counts as whole if all its corners are in the image with a margin, nothing hides any of them, and the camera views it
at less than 75 degrees from its normal.
"""

from __future__ import annotations

import copy
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.command import answer, command, show_summary
from stridetwin.estimators.checkerboard.detector import BoardDetector
from stridetwin.estimators.checkerboard.pattern import DistortionModel
from stridetwin.estimators.checkerboard.pose import BoardObservation, find_board_poses
from stridetwin.scenarios.scenario_file import load_scenario
from stridetwin.sim.parts.kinds import CameraPart
from stridetwin.sim.parts.library import load_part
from stridetwin.sim.parts.sensor_config import STANDARD, SensorConfig
from stridetwin.sim.playback import Motion
from stridetwin.sim.rendering.cameras import Cameras, FrameRequest
from stridetwin.sim.rendering.renderer import SensorView, mount_pose
from stridetwin.sim.twin import Twin
from stridetwin.sim.wearer.sensor_bodies import UPPERS
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array, Image

SCENARIOS = ("level_20m", "stair_up_down", "turns")
SEEDS = range(1000, 1002)
EXPOSURE_MS = 2.0
EVERY = 3
SEARCHED_EVERY = 4
PER_SQUARE_PX = (0.0, 3.0, 4.0, 5.0, 7.0, 99.0)
BLUR_SQUARES = (0.0, 0.25, 0.5, 1.0, 99.0)
GUESS_SD = (0.005, np.radians(1.0))
MOTION_SD = 0.1
WRONG_SQUARES = 1 / 3
HIDDEN_M = 0.005
STEEP_RAD = np.radians(75.0)
_SHUTTER = np.linspace(-0.5, 0.5, 9)  # instants of an exposure


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One image and its truth.

    Attributes:
        image: Grey image.
        depth: (H, W) m along the optical axis, in the middle of the exposure.
        board: Board to detect.
        camera: Its camera.
        T_camera_board: (9, 4, 4) true pose through the exposure.
    """

    image: Image
    depth: NDArray[np.float32]
    board: Board
    camera: CameraCalibration
    T_camera_board: Array

    def bare(self, pixels: Array, points_in_board: Array) -> bool:
        """Whether points (N, 3) of the board, at (N, 2) pixels, are unoccluded."""
        column, row = np.round(pixels).astype(int).T
        z = points_in_board @ self.middle[2, :3] + self.middle[2, 3]
        return bool((self.depth[row, column] > z - HIDDEN_M).all())

    @property
    def middle(self) -> Array:
        """(4, 4) pose in the middle of the exposure."""
        return self.T_camera_board[len(self.T_camera_board) // 2]


def frames(scenario: str, seed: int, exposure_ms: float, every: int = EVERY) -> Iterator[Frame]:
    """Images of both shoe cameras of one walk."""
    camera_part = load_part(STANDARD["foot_camera"])
    assert isinstance(camera_part, CameraPart)
    imager = replace(camera_part.imager, exposure_s=1e-3 * exposure_ms)
    fitting = SensorConfig(part=replace(camera_part, imager=imager), frames="full")
    config = load_scenario(scenario).config
    twin = Twin(replace(config, sensors=("foot_camera",), fittings={"foot_camera": fitting}), seed)
    step = every / 60.0
    t_ns = np.round(np.arange(step, twin.duration_s - step, step) * 1e9).astype(np.int64)
    shutter = np.round(_SHUTTER * exposure_ms * 1e6).astype(np.int64)
    motion = twin.player().motion(np.unique(t_ns[:, None] + shutter))
    boards = {f"/{foot}/camera": twin.rig.boards[other] for foot, other in (("foot_l", "foot_r"), ("foot_r", "foot_l"))}
    due = [_due(motion, twin.rig.cameras[topic], boards[topic], t) for t in t_ns.tolist() for topic in twin.rig.cameras]
    rows = motion.rows(np.array([d.t_ns for d in due]))
    model, data, uppers = copy.copy(twin.model), mujoco.MjData(twin.model), motion.upper_poses(rows)
    size = next((c.width, c.height) for c in twin.rig.cameras.values())
    with SensorView(model, *size) as view, Cameras(twin.model, twin.sensor_rig, twin.crowd, seed) as cameras:
        for i, (item, image) in enumerate(zip(due, cameras.frames(due, motion.qpos[rows], uppers))):
            assert isinstance(image, Image)
            camera, board = twin.rig.cameras[item.topic], boards[item.topic]
            for foot, on_foot in uppers.items():
                model.body(UPPERS[foot]).pos, model.body(UPPERS[foot]).quat = on_foot[i, :3], on_foot[i, 3:]
            data.qpos = motion.qpos[rows[i]]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            _, depth = view.frame(data, mount_pose(data, camera.mount), camera.intrinsics)
            T = _relative(motion, camera, board, motion.rows(item.t_ns + shutter))
            yield Frame(image=image, depth=depth, board=board, camera=camera, T_camera_board=T)


def _due(motion: Motion, camera: CameraCalibration, board: Board, t_ns: int) -> FrameRequest:
    """Views for the renderer."""
    row = motion.rows(np.array([t_ns]))
    tracks = [motion.carrier(carried.mount.body)[row] for carried in (camera, board)]
    twist = np.array([np.r_[track.v_body_in_world[0], track.w_body[0]] for track in tracks])
    return FrameRequest(t_ns=t_ns, topic=camera.topic, twist=twist)


def _relative(motion: Motion, camera: CameraCalibration, board: Board, rows: NDArray[np.int64]) -> Array:
    """(N, 4, 4) pose of a board in a camera."""
    T_world_camera, T_world_board = (
        motion.carrier(part.mount.body)[rows].to_sensor(part.mount.T_body_sensor).poses() for part in (camera, board)
    )
    return np.linalg.inv(T_world_camera) @ T_world_board


def case(frame: Frame, detector: BoardDetector, rng: np.random.Generator, search: bool) -> dict[str, Any] | None:
    """Result of the detector for one image; None if no board is visible and none was detected."""
    T, camera, square = frame.middle, frame.camera, frame.board.square_m
    size = np.array([camera.width, camera.height])
    true_px = detector.predict(T)
    inside = true_px is not None and ((true_px > 0) & (true_px < size - 1)).all(axis=1)
    searched, searched_ms = _timed(detector, frame.image, None, None) if search else (None, 0.0)
    if true_px is None or not np.any(inside):
        return {"in_view": False, "false": searched is not None, "searched_ms": searched_ms} if search else None
    ways = [camera.K @ pose[:3, 3] for pose in frame.T_camera_board[[0, -1]]]
    way_px = ways[1][:2] / ways[1][2] - ways[0][:2] / ways[0][2]
    shown = true_px.reshape(*(n - 1 for n in frame.board.squares[::-1]), 2)
    per_square = np.sqrt(abs(np.linalg.det(np.array([shown[4, 3] - shown[4, 2], shown[4, 2] - shown[3, 2]]))))
    cosine = abs(T[:3, 2] @ T[:3, 3]) / np.linalg.norm(T[:3, 3])
    margin = 1.6 * per_square  # the white margin must be in view as well
    whole = bool(((true_px > margin) & (true_px < size - 1 - margin)).all() and cosine > np.cos(STEEP_RAD))
    whole = whole and frame.bare(true_px, detector.points_in_board)
    guess = detector.predict(_disturbed(T, rng))
    told_px = way_px * rng.normal(1.0, MOTION_SD)
    guided, ms = _timed(detector, frame.image, true_px if guess is None else guess, told_px)
    result = {
        "in_view": True,
        "whole": whole,
        "per_square_px": float(per_square),
        "blur_squares": float(np.linalg.norm(way_px) / per_square),
        "ms": ms,
        "found": guided is not None,
        "wrong": False,
        "searched": searched is not None if search else None,
        "searched_ms": searched_ms,
    }
    for observation in (guided, searched):
        if observation is not None:
            miss = DistortionModel(camera).pixels(observation.rays) - true_px[_which(observation, detector)]
            result["wrong"] |= bool(np.linalg.norm(miss, axis=1).max() > WRONG_SQUARES * per_square)
    return result | (
        _errors(guided, true_px[_which(guided, detector)], T, camera, square) if guided is not None else {}
    )


def _timed(
    detector: BoardDetector, image: Image, guess: Array | None, way_px: Array | None
) -> tuple[BoardObservation | None, float]:
    """Detection and its CPU time in ms."""
    start = time.thread_time()
    observation = detector.detect(image, guess, motion_px=way_px)
    return observation, 1e3 * (time.thread_time() - start)


def _which(observation: BoardObservation, detector: BoardDetector) -> NDArray[np.intp]:
    """(M,) indices of the corners."""
    apart = np.linalg.norm(observation.points_in_board[:, None] - detector.points_in_board, axis=2)
    return apart.argmin(axis=1)


def _disturbed(T_camera_board: Array, rng: np.random.Generator) -> Array:
    T = T_camera_board.copy()
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, GUESS_SD[1], 3)).as_matrix() @ T[:3, :3]
    T[:3, 3] += rng.normal(0.0, GUESS_SD[0], 3)
    return T


def _errors(
    observation: BoardObservation, true_px: Array, T: Array, camera: CameraCalibration, square_m: float
) -> dict[str, Any]:
    """Errors of corners and pose of a detection."""
    miss, sd = DistortionModel(camera).pixels(observation.rays) - true_px, observation.ray_sd * camera.intrinsics[0]
    result: dict[str, Any] = {"miss_px": miss, "sd_px": sd}
    poses = find_board_poses(observation)
    if poses:
        likeliest = poses[0]
        shift = T[:3, 3] - likeliest.T_camera_board[:3, 3]
        turn = Rotation.from_matrix(T[:3, :3] @ likeliest.T_camera_board[:3, :3].T).as_rotvec()
        error, sight = np.concatenate([shift, turn]), T[:3, 3] / np.linalg.norm(T[:3, 3])
        result |= {
            "along_mm": 1e3 * abs(shift @ sight),
            "across_mm": 1e3 * np.linalg.norm(shift - sight * (shift @ sight)),
            "turn_deg": np.degrees(np.linalg.norm(turn)),
            "nees": error @ np.linalg.solve(likeliest.covariance, error) / 6,
        }
    return result


def summary(cases: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Figures of many images."""
    seen = [c for c in cases if c["in_view"]]
    whole = [c for c in seen if c["whole"]]
    usable = [c for c in whole if c["blur_squares"] < 0.5 and c["per_square_px"] >= 4.0]
    detections = [c for c in seen if c["found"]]
    posed = [c for c in detections if "nees" in c]
    miss, sd = (np.concatenate([c[key] for c in detections]) for key in ("miss_px", "sd_px"))
    searched = [c for c in whole if c["searched"] is not None]

    def rms(key: str) -> float:
        return float(np.sqrt(np.mean([c[key] ** 2 for c in posed])))

    return {
        "whole_board": len(whole),
        "detected_pct": _share([c["found"] for c in whole]),
        "detected_usable_pct": _share([c["found"] for c in usable]),
        "detected_partly_seen_pct": _share([c["found"] for c in seen if not c["whole"]]),
        "found_without_guess_pct": _share([c["searched"] for c in searched]),
        "found_without_guess_usable_pct": _share([c["searched"] for c in usable if c["searched"] is not None]),
        "wrong": sum(c["wrong"] for c in seen),
        "false": sum(c["false"] for c in cases if not c["in_view"]),
        "images_without_board": sum(not c["in_view"] for c in cases),
        "corners_mean": float(np.mean([len(c["miss_px"]) for c in detections])),
        "corner_bias_px": float(np.linalg.norm(miss.mean(axis=0))),
        "corner_sd_px": float(miss.std(axis=0).mean()),
        "corner_sd_estimated_px": float(np.sqrt((sd**2).mean())),
        "corner_nees_mean": float(((miss**2).sum(axis=1) / 2 / sd**2).mean()),
        "pose_nees_mean": float(np.mean([c["nees"] for c in posed])),
        "pose_nees_median": float(np.median([c["nees"] for c in posed])),
        "along_sight_rms_mm": rms("along_mm"),
        "across_sight_rms_mm": rms("across_mm"),
        "turn_rms_deg": rms("turn_deg"),
        "time_ms_mean": float(np.mean([c["ms"] for c in seen])),
        "time_ms_p95": float(np.percentile([c["ms"] for c in seen], 95)),
        "time_without_guess_ms_mean": float(np.mean([c["searched_ms"] for c in cases if c["searched_ms"] > 0])),
    }


def _share(flags: Sequence[bool]) -> float:
    return 100.0 * float(np.mean(flags)) if len(flags) else float("nan")


def table(cases: Sequence[dict[str, Any]]) -> list[dict[str, float]]:
    """Figures by size of a square and blur, for images that show the whole board."""
    rows = []
    for low, high in pairwise(PER_SQUARE_PX):
        for sharp, blurred in pairwise(BLUR_SQUARES):
            cases_in_bin = [
                c
                for c in cases
                if c["in_view"]
                and c["whole"]
                and low <= c["per_square_px"] < high
                and sharp <= c["blur_squares"] < blurred
            ]
            if not cases_in_bin:
                continue
            row = {"per_square_px": low, "blur_squares": sharp, "images": len(cases_in_bin)}
            row["detected_pct"] = _share([c["found"] for c in cases_in_bin])
            row["without_guess_pct"] = _share([c["searched"] for c in cases_in_bin if c["searched"] is not None])
            if any(c["found"] for c in cases_in_bin):
                miss, sd = (
                    np.concatenate([c[key] for c in cases_in_bin if c["found"]]) for key in ("miss_px", "sd_px")
                )
                row["corner_sd_px"] = float(miss.std(axis=0).mean())
                row["corner_sd_estimated_px"] = float(np.sqrt((sd**2).mean()))
            rows.append(row)
    return rows


def cases_of_walk(scenario: str, seed: int, exposure_ms: float, every: int = EVERY) -> list[dict[str, Any]]:
    """One case per image of one walk."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(98,)))
    detectors: dict[str, BoardDetector] = {}
    cases = []
    for i, frame in enumerate(frames(scenario, seed, exposure_ms, every)):
        if frame.image.topic not in detectors:
            detectors[frame.image.topic] = BoardDetector(frame.board, frame.camera)
            detectors[frame.image.topic].detect(frame.image)  # compiles
        result = case(frame, detectors[frame.image.topic], rng, i % SEARCHED_EVERY == 0)
        if result is not None:
            cases.append(result)
    return cases


def measure(scenarios: Sequence[str], seeds: Sequence[int], exposure_ms: float) -> dict[str, Any]:
    """All figures, in the form of an experiment's JSON."""
    by_scenario = {name: [c for s in seeds for c in cases_of_walk(name, s, exposure_ms)] for name in scenarios}
    everything = [c for cases in by_scenario.values() for c in cases]
    return {
        "experiment": "board_detection",
        "summary": {name: summary(cases) for name, cases in by_scenario.items()},
        "cases": table(everything),
    }


def show(result: dict[str, Any]) -> None:
    """Prints the summary, then a line for each case."""
    show_summary(32, "9.3f")(result)
    for row in result["cases"]:
        print("  ".join(f"{key} {value:7.3f}" for key, value in row.items()))


def main() -> int:
    """Command line."""
    parser = command(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="seeds of the walks (1000 and 1001)")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, help=f"names ({', '.join(SCENARIOS)})")
    parser.add_argument("--exposure-ms", type=float, default=EXPOSURE_MS, help="0 = no blur (2)")
    cv2.setNumThreads(1)
    return answer(parser, lambda a: measure(a.scenarios, a.seeds, a.exposure_ms), show)


if __name__ == "__main__":
    sys.exit(main())

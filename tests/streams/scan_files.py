"""Small scans as iPhone apps write them."""

from __future__ import annotations

import json

import av
import cv2
import numpy as np
from scipy.spatial.transform import Rotation

FRAMES, RATE_HZ = 12, 30.0
WIDTH, HEIGHT, SMALL = 64, 48, (16, 12)
K = (50.0, 51.0, 31.0, 23.5)
T = 100.0 + np.arange(FRAMES) / RATE_HZ
RNG = np.random.default_rng(2)
DEPTH_MM = RNG.integers(500, 3000, (FRAMES, SMALL[1], SMALL[0])).astype(np.uint16)
GREY = np.linspace(60, 200, FRAMES).astype(np.uint8)
P = np.column_stack([0.1 * np.arange(FRAMES), np.full(FRAMES, 1.5), np.zeros(FRAMES)])  # y up
R_YUP_OPTICAL = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # level, along -z
R_WORLD_OPTICAL = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""The same camera in a world with z up: it looks along y."""


def stray_scanner(folder, *, imu=True, video=True):
    (folder / "depth").mkdir()
    for i, mm in enumerate(DEPTH_MM):
        cv2.imwrite(str(folder / "depth" / f"{i:06d}.png"), mm)
    q = R_YUP_OPTICAL.as_quat()
    poses = [", ".join(map(repr, [*p, *q.tolist()])) for p in P.tolist()]
    rows = [f"{t:.6f}, {i:06d}, {pose}" for i, (t, pose) in enumerate(zip(T, poses))]
    (folder / "odometry.csv").write_text("\n".join(["timestamp, frame, x, y, z, qx, qy, qz, qw", *rows]) + "\n")
    (folder / "camera_matrix.csv").write_text(f"{K[0]}, 0.0, {K[2]}\n0.0, {K[1]}, {K[3]}\n0.0, 0.0, 1.0\n")
    if imu:
        # the phone held sideways, its right side down: the force is along -x of the device, an iPhone reports +1 g
        t = np.linspace(100.0, 100.39, 40)
        rows = [f"{s:.6f}, 1.0, 0.0, 0.0, 0.1, 0.2, 0.3" for s in t]
        (folder / "imu.csv").write_text(
            "\n".join(["timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z", *rows]) + "\n"
        )
    if video:
        with av.open(str(folder / "rgb.mp4"), "w") as container:
            stream = container.add_stream("mpeg4", rate=30)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            for grey in GREY:
                frame = av.VideoFrame.from_ndarray(np.full((HEIGHT, WIDTH, 3), grey, np.uint8), format="rgb24")
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    return folder


def record3d(folder, compress=bytes):
    (folder / "rgbd").mkdir()
    for i, mm in enumerate(DEPTH_MM):
        cv2.imwrite(str(folder / "rgbd" / f"{i}.jpg"), np.full((HEIGHT, WIDTH, 3), GREY[i], np.uint8))
        depth = mm.astype("<f4") / 1000
        depth[0, 0] = np.nan
        (folder / "rgbd" / f"{i}.depth").write_bytes(compress(depth.tobytes()))
    # ARKit's own camera looks along -z: here without rotation
    poses = [[0.0, 0.0, 0.0, 1.0, *p] for p in P.tolist()]
    metadata = {
        "w": WIDTH,
        "h": HEIGHT,
        "dw": SMALL[0],
        "dh": SMALL[1],
        "fps": RATE_HZ,
        "poses": poses,
        "K": [K[0], 0, 0, 0, K[1], 0, K[2], K[3], 1],
        "frameTimestamps": (T - T[0]).tolist(),
    }
    (folder / "metadata").write_text(json.dumps(metadata))
    return folder

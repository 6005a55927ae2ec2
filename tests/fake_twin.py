"""A walk on the level from a few formulas: the interface of the twin without the simulator."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np

from stridetwin.sim.config import Level, Route, TwinConfig
from stridetwin.sim.world.route import lay_out
from stridetwin.streams.rig import CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import (
    Block,
    Depth,
    FootPhase,
    Footprint,
    Image,
    Imu,
    Insole,
    Joints,
    Odometry,
    Point,
    Wrench,
)

STRIDE_S, STRIDE_M, SWING, STAND_S, STRIDES, G = 1.1, 1.2, 0.4, 1.0, 5, 9.8029
RATE_HZ, TRUTH_HZ, CAMERA_HZ = 120.0, 500.0, 10.0


class FakeTwin:
    """Same attributes and methods as the twin."""

    def __init__(self, config: TwinConfig, seed: int) -> None:
        self.config, self.seed = config, seed
        self.fell_at, self.size = None, SimpleNamespace(exo=None)
        self.total_mass_kg = config.person.mass_kg
        self.duration_s = 2 * STAND_S + (STRIDES + 1) * STRIDE_S
        route = Route(segments=(Level(length_m=STRIDES * STRIDE_M),))
        self.terrain = SimpleNamespace(layout=lay_out(route))
        cameras = {}
        if "head_camera" in config.sensors:
            cameras["/head/color"] = CameraCalibration(
                topic="/head/color",
                part="D455",
                rate_hz=CAMERA_HZ,
                mount=Mount(body="head"),
                width=64,
                height=48,
                intrinsics=(50.0, 50.0, 31.5, 23.5),
                depth_topic="/head/depth",
            )
        self.rig = Rig(
            imus={f"/foot_{f}/imu": _imu(f"/foot_{f}/imu") for f in "lr"},
            cameras=cameras,
            others={
                f"/foot_{f}/insole": OtherSensor(
                    topic=f"/foot_{f}/insole",
                    kind="insole",
                    part="A401",
                    rate_hz=100.0,
                    mount=Mount(body=f"foot_{f}"),
                )
                for f in "lr"
            },
        )

    def blocks(self):
        """Every topic at once, cut into pieces of half a second."""
        everything = [b for i, f in enumerate("lr") for b in self._foot(f, 0.5 * i)]
        everything += [self._joints(), self._footprints(), *self._pictures()]
        edges = np.arange(0, self.duration_s + 0.5, 0.5) * 1e9
        for a, b in pairwise(edges):
            yield [piece for block in everything if len(piece := _cut(block, a, b))]

    def film(self, fps, width, height):
        """A square that walks."""
        for t in np.arange(0, self.duration_s, 1 / fps):
            image = np.full((height, width, 3), 235, np.uint8)
            x = int(t / self.duration_s * (width - 40))
            image[height // 2 : height // 2 + 40, x : x + 40] = (11, 107, 203)
            yield t, image

    def _foot(self, foot, phase):
        rng = np.random.default_rng([self.seed, ord(foot)])
        side = 0.1 if foot == "l" else -0.1
        t = _times(self.duration_s, TRUTH_HZ)
        p, v, _, q, w = motion(t, phase, side)
        truth = Block(
            topic=f"/truth/foot_{foot}/imu/odometry",
            kind=Odometry,
            t_ns=_ns(t),
            columns={"p_frame_in_world": p, "v_frame_in_world": v, "q_world_frame": q, "angular_rate": w},
        )
        ti = _times(self.duration_s, RATE_HZ)
        _, _, a, qi, wi = motion(ti, phase, side)
        imu = Block(
            topic=f"/foot_{foot}/imu",
            kind=Imu,
            t_ns=_ns(ti),
            columns={
                "angular_rate": wi + rng.normal(0, 1e-3, wi.shape),
                "specific_force": _to_body(qi, a + np.array([0, 0, G])) + rng.normal(0, 1e-2, a.shape),
            },
        )
        load = np.where(_swinging(t, phase), 0.0, 370.0)
        force = np.column_stack([0 * t, 0 * t, load])
        ground = Block(
            topic=f"/truth/foot_{foot}/wrench",
            kind=Wrench,
            t_ns=_ns(t),
            columns={"force_in_world": force, "torque_in_world": 0 * force},
        )
        cop = Block(
            topic=f"/truth/foot_{foot}/cop",
            kind=Point,
            t_ns=_ns(t)[load > 0],
            columns={"p_in_world": (p + np.array([0.1, 0, -0.05]))[load > 0]},
        )
        phases = Block(
            topic=f"/truth/foot_{foot}/phase",
            kind=FootPhase,
            t_ns=_ns(t),
            columns={"phase": np.where(load > 0, 2, 0)},
        )
        ts = _times(self.duration_s, 100.0)
        cells = np.where(_swinging(ts, phase), 0.0, 90.0)[:, None] * [1.0, 0.9, 0.8, 0.4]
        insole = Block(topic=f"/foot_{foot}/insole", kind=Insole, t_ns=_ns(ts), columns={"force": cells})
        return [truth, imu, ground, cop, phases, insole]

    def _joints(self):
        t = _times(self.duration_s, TRUTH_HZ)
        names = tuple(f"{j}_{f}" for j in ("hip_flexion", "knee_flexion", "ankle_dorsiflexion") for f in "lr")
        wave = np.radians(15 + 20 * np.sin(2 * np.pi * t / STRIDE_S))[:, None] * np.ones(len(names))
        return Block(
            topic="/truth/joints",
            kind=Joints,
            t_ns=_ns(t),
            columns={"position": wave, "velocity": 0 * wave, "torque": 0 * wave},
            constants={"names": names},
        )

    def _footprints(self):
        prints = sorted(
            (STAND_S + (k + 0.5 * i + 0.2 + SWING) * STRIDE_S, f, (k + 1) * STRIDE_M, 0.1 - 0.2 * i)
            for i, f in enumerate("lr")
            for k in range(STRIDES)
        )
        n = len(prints)
        return Block(
            topic="/truth/footprints",
            kind=Footprint,
            t_ns=_ns(np.array([p[0] for p in prints])),
            columns={
                "foot": np.array([p[1] for p in prints]),
                "p_foot_in_world": np.array([(p[2], p[3], 0.0) for p in prints]),
                "q_world_foot": np.tile([1.0, 0, 0, 0], (n, 1)),
                "terrain": np.full(n, "level"),
                "mode": np.full(n, "LG"),
            },
        )

    def _pictures(self):
        if not self.rig.cameras:
            return []
        t = _times(self.duration_s, CAMERA_HZ)
        rows, columns = np.mgrid[:48, :64]
        colour = np.stack([(columns * 4 + 10 * k) % 256 + 0 * rows for k in range(len(t))])
        colour = np.repeat(colour.astype(np.uint8)[..., None], 3, -1)
        depth = np.stack([1.0 + 0.05 * rows + 0.001 * k for k in range(len(t))]).astype(np.float32)
        return [
            Block(topic="/head/color", kind=Image, t_ns=_ns(t), columns={"pixels": colour}),
            Block(topic="/head/depth", kind=Depth, t_ns=_ns(t), columns={"depth": depth}),
        ]


def motion(t, phase, side):
    """Position, velocity, acceleration, attitude (w, x, y, z) and rate of a foot that walks along x."""
    h = 1e-4
    p = _position(t, phase, side)
    before, after = _position(t - h, phase, side), _position(t + h, phase, side)
    pitch, pitch_rate = _pitch(t, phase), (_pitch(t + h, phase) - _pitch(t - h, phase)) / (2 * h)
    q = np.column_stack([np.cos(pitch / 2), 0 * t, np.sin(pitch / 2), 0 * t])
    rate = np.column_stack([0 * t, pitch_rate, 0 * t])
    return p, (after - before) / (2 * h), (after - 2 * p + before) / h**2, q, rate


def _cycle(t, phase):
    u = np.clip((t - STAND_S) / STRIDE_S - phase - 0.2, 0, STRIDES)
    k = np.minimum(np.floor(u), STRIDES - 1)
    return k, np.clip((u - k) / SWING, 0, 1)


def _swinging(t, phase):
    _, s = _cycle(t, phase)
    return (s > 0) & (s < 1)


def _position(t, phase, side):
    k, s = _cycle(t, phase)
    x = STRIDE_M * (k + s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3))
    return np.column_stack([x, np.full_like(t, side), 0.05 + 10 * (s * (1 - s)) ** 4 * 2.0])


def _pitch(t, phase):
    _, s = _cycle(t, phase)
    return 60 * (s * (1 - s)) ** 4 * np.sin(np.pi * (1 - 2 * s)) * 3


def _to_body(q, a):
    c, s = 1 - 2 * q[:, 2] ** 2, 2 * q[:, 0] * q[:, 2]
    return np.column_stack([c * a[:, 0] - s * a[:, 2], a[:, 1], s * a[:, 0] + c * a[:, 2]])


def _imu(topic):
    return ImuCalibration(
        topic=topic,
        part="ADIS16485",
        rate_hz=RATE_HZ,
        mount=Mount(body=topic.split("/")[1]),
        gyroscope_noise_density=1e-4,
        gyroscope_random_walk=1e-6,
        accelerometer_noise_density=1e-3,
        accelerometer_random_walk=1e-5,
        gyroscope_bias_sd=1e-4,
        accelerometer_bias_sd=1e-3,
    )


def _times(duration, rate):
    return np.arange(1, int(duration * rate) + 1) / rate


def _ns(t):
    return np.rint(t * 1e9).astype(np.int64)


def _cut(block, a, b):
    keep = (block.t_ns > a) & (block.t_ns <= b)
    columns = {n: c[keep] for n, c in block.columns.items()}
    return replace(block, t_ns=block.t_ns[keep], columns=columns)

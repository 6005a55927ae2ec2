"""Ground truth of the twin as streams under `/truth`; it never reaches an estimator."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES
from stridetwin.sim.kinematics.track import Track
from stridetwin.sim.playback import Loads, Motion
from stridetwin.sim.sensors.mount_slip import MountSlips
from stridetwin.sim.walk import Walk
from stridetwin.sim.world.bystanders import Crowd
from stridetwin.streams.algebra.arrays import to_quaternion
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import Block, FootPhase, Footprint, Joints, Odometry, Point, Sample, Wrench

RATE_HZ = 200.0  # of the ground truth
SWING, CONTACT, FLAT, HEEL_OFF = 0, 1, 2, 3  # phases of a foot
_FLAT_RAD = 0.01  # pitch below which a foot counts as flat


def truth(
    walk: Walk, rig: Rig, motion: Motion, loads: Loads, after_ns: int, until_ns: int, mount_slips: MountSlips
) -> Iterator[Block[Sample] | Sample]:
    """Ground truth: poses, joints, ground reactions and foot phases at the instants of `loads`, and footprints.

    Args:
        walk: The motion.
        rig: Rig with the true mounts; each IMU gets its own true path.
        motion: Motion at these instants, among others.
        loads: Loads at evenly spaced instants.
        after_ns: Footprints after this time.
        until_ns: Footprints up to this time.
        mount_slips: Slips of the sensor mounts.
    """
    t_ns = loads.t_ns
    rows = motion.rows(t_ns)
    for body in ("pelvis", "foot_l", "foot_r"):
        yield _odometry(f"/truth/{body}/odometry", motion.tracks[body][rows])
    for topic, imu in rig.imus.items():
        carrier = mount_slips.mount_track(topic, motion.carrier(imu.mount.body)[rows])
        yield _odometry(f"/truth{topic}/odometry", carrier.to_sensor(imu.mount.T_body_sensor))
    names = walk.coordinates.names[6:]  # of the hinges; the six coordinates of the root come before them
    yield Block(
        topic="/truth/joints",
        kind=Joints,
        t_ns=t_ns,
        columns={
            "position": np.column_stack([motion.angle[n][rows] for n in names]),
            "velocity": np.column_stack([motion.speed[n][rows] for n in names]),
            "torque": loads.joint_torque,
        },
        constants={"names": names},
    )
    for side in SIDES:
        load = loads.feet[side]
        yield _wrench(f"/truth/foot_{side}/wrench", t_ns, load.force, load.torque)
        on = load.loaded  # only then is there a centre of pressure
        if on.any():
            yield Block(
                topic=f"/truth/foot_{side}/cop",
                kind=Point,
                t_ns=t_ns[on],
                columns={"p_in_world": load.cop[on]},
            )
        yield Block(
            topic=f"/truth/foot_{side}/phase",
            kind=FootPhase,
            t_ns=t_ns,
            columns={"phase": foot_phase(walk, side, t_ns * 1e-9)},
        )
    yield _wrench("/truth/root_residual", t_ns, loads.residual_force, loads.residual_torque)
    yield from _footprints(walk, after_ns, until_ns)


def bystander_truth(crowd: Crowd, t_ns: NDArray[np.int64]) -> Iterator[Block[Odometry]]:
    """True pose of each bystander at (N,) instants: the middle of the hips, x forward."""
    for i, person in enumerate(crowd):
        yield _odometry(f"/truth/bystander_{i}/odometry", person.track(t_ns))


def foot_phase(walk: Walk, side: str, t: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(N,) phase of a foot at (N,) s, in the phases of Shim et al. 2019.

    0 swing; 1 contact, from touch-down until the foot is flat; 2 flat, with less than `_FLAT_RAD` of pitch either way;
    3 heel off.
    """
    steps = walk.steps[side]
    pitch = walk.pitch(side, t)
    # number of the last footstep that has begun, and the times of its touch-down and toe-off
    i = np.clip(np.searchsorted([s.t_touch for s in steps], t, side="right") - 1, 0, len(steps) - 1)
    touch = np.array([s.t_touch for s in steps])[i]
    off = np.array([s.t_off for s in steps])[i]
    # in stance, a foot that is not flat is in the phase of the nearer end
    phase = np.where(np.abs(pitch) < _FLAT_RAD, FLAT, np.where(t - touch < off - t, CONTACT, HEEL_OFF))
    # a recording may begin while the foot is in the air
    return np.where((t > off) | (t < touch), SWING, phase).astype(np.uint8)


def _odometry(topic: str, track: Track) -> Block[Odometry]:
    """Block of odometry samples on a topic, with the poses and velocities of a track at its instants."""
    return Block(
        topic=topic,
        kind=Odometry,
        t_ns=track.t_ns,
        columns={
            "p_frame_in_world": track.p_body_in_world,
            "q_world_frame": track.q_world_body,
            "v_frame_in_world": track.v_body_in_world,
            "angular_rate": track.w_body,
        },
    )


def _wrench(topic: str, t_ns: NDArray[np.int64], force: Any, torque: Any) -> Block[Wrench]:
    """Block of (N, 3) forces, N, and torques, N m, in world axes, at (N,) instants."""
    return Block(topic=topic, kind=Wrench, t_ns=t_ns, columns={"force_in_world": force, "torque_in_world": torque})


def _footprints(walk: Walk, after_ns: int, until_ns: int) -> Iterator[Footprint]:
    """Footprints with a touch-down after `after_ns` and up to `until_ns`, in order of time.

    The feet that stand at the start come first, with the stamps 0 and 1.
    """
    steps = walk.stances()
    standing = [s for s in steps if not np.isfinite(s.t_touch)]
    for step in steps:
        # the initial stance feet are reported first, one nanosecond apart: stamps increase within a topic
        t_ns = standing.index(step) if step in standing else round(step.t_touch * 1e9)
        if after_ns < t_ns <= until_ns:
            yield Footprint(
                topic="/truth/footprints",
                t_ns=t_ns,
                foot=step.foot,
                p_foot_in_world=step.p_foot_in_world,
                q_world_foot=to_quaternion(step.R_world_sole),
                terrain=step.terrain,
                mode=step.mode,
            )

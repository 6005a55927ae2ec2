"""Streams that a source has in another form: poses with velocities, and an IMU whose sensors are two streams."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.recording.index import Notes, Problem
from stridetwin.streams.samples import (
    LARGEST_NUMBER,
    Accelerometer,
    Array,
    Block,
    Imu,
    Odometry,
    Sample,
    Stamps,
    is_increasing,
)

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_UNIT = (0.9, 1.1)
"""Between these norms a quaternion counts as a rounded unit quaternion."""


def to_odometry(
    name: str,
    t_ns: Stamps,
    p: Array,
    q: Array,
    v: Array | None,
    notes: Notes,
    file: object,
    T_body_source: Array | None = None,
) -> Block[Odometry]:
    """Converts poses to a block of odometry; missing velocities are central differences.

    Args:
        name: Topic.
        t_ns: (N,) stamps.
        p: (N, 3) m, origin of the source's frame in the world.
        q: (N, 4) quaternions (w, x, y, z), source's frame to world; normalised here.
        v: (N, 3) m/s in the world, or None.
        notes: Collects problems.
        file: Name of the source in errors.
        T_body_source: (4, 4) pose of the source's frame in the wanted frame, m; `v` is then ignored, because it is the
            velocity of another point. None: the frames are equal.

    Returns:
        Position, attitude and velocity of the wanted frame in the world; angular rate in the wanted frame.

    Raises:
        ConfigError: A quaternion far from unit norm, unless lenient (its row is omitted).
    """
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(q, axis=1)
    sound = (norm > _UNIT[0]) & (norm < _UNIT[1])
    if not sound.all():
        at = int(np.argmin(sound))
        notes.add_error(ConfigError(file, f"row {at + 1}, quaternion", q[at].tolist(), "a unit quaternion"))
        t_ns, p, q, norm = t_ns[sound], p[sound], q[sound], norm[sound]
        v = None if v is None else v[sound]
    q = q / norm[:, None]
    from scipy.spatial.transform import Rotation  # takes long to import: only where it is needed

    if T_body_source is not None and len(q):  # the wanted frame: T_world_source T_source_body
        T_source_body = np.linalg.inv(T_body_source)
        rotation = Rotation.from_quat(q, scalar_first=True)
        p, v = p + rotation.apply(T_source_body[:3, 3]), None
        q = (rotation * Rotation.from_matrix(T_source_body[:3, :3])).as_quat(scalar_first=True)
    rates = np.zeros((2, len(t_ns), 3))
    velocity, angular_rate = rates  # views, which get the numbers below
    is_valid = is_increasing(t_ns) & (np.abs(p) <= LARGEST_NUMBER).all(axis=1)  # others are rejected or omitted later
    rising = np.flatnonzero(is_valid)
    if len(rising) > 1:
        attitude = Rotation.from_quat(q[rising], scalar_first=True)
        rates[:, rising] = _differentiate(t_ns[rising], p[rising], attitude)
    return Block(
        topic=name,
        kind=Odometry,
        t_ns=t_ns,
        columns={
            "p_frame_in_world": p,
            "q_world_frame": q,
            "v_frame_in_world": velocity if v is None else v,
            "angular_rate": angular_rate,
        },
    )


def _differentiate(t_ns: Stamps, p: Array, attitude: Rotation) -> Array:
    """Velocities and angular rates from the poses before and after each one (at the ends: from the pose itself).

    Args:
        t_ns: (N,) stamps that increase.
        p: (N, 3) m in the world.
        attitude: N rotations from the frame to the world.

    Returns:
        (2, N, 3): velocity in the world, m/s, and angular rate in the frame, rad/s.
    """
    i = np.arange(len(t_ns))
    before, after = np.maximum(i - 1, 0), np.minimum(i + 1, len(t_ns) - 1)  # (N,) numbers of the two poses
    span = (t_ns[after] - t_ns[before])[:, None] * 1e-9  # (N, 1) s between them
    rotation = (attitude[before].inv() * attitude[after]).as_rotvec()  # (N, 3) rad, from the one to the other
    return np.stack(((p[after] - p[before]) / span, rotation / span))


_LEAST_SHARE = 0.95
"""Share of the rates that must lie within the forces' time without a warning."""
_SLACK_PERIODS = 3
_GYRO = re.compile(r"gyro(?:scope)?(?:/sample)?|angular_(?:velocity|rate)", re.IGNORECASE)
"""What the topic of a stream of rates has in place of `accel` in that of the forces; RealSense adds `/sample`."""
_PAIRS = (
    ("gyroscope", "accelerometer"),
    ("gyro", "accel"),
    ("gyro", "acc"),
    ("angular_velocity", "linear_acceleration"),
    ("angular_rate", "acceleration"),
)
"""What topics of rates contain, and what those of the forces have in its place."""
_JOINED = "imu"
"""What the topic of the joined IMU has there."""


def join_gyro_and_accel(blocks: dict[str, Block[Sample]], notes: Notes) -> dict[str, Block[Sample]]:
    """Joins each pair of streams `.../gyro` and `.../accel` to one IMU, and reports that by a warning.

    A pair is joined only if the first has no forces and the second no rates. The force is interpolated linearly to
    the stamps of the rate. Of a pair whose stamps do not overlap, which is a problem, the
    forces alone are left when lenient.
    """
    result = dict(blocks)
    for topic, gyro in blocks.items():
        accel_topic = next((name for name in _name_accel_topics(topic) if name in blocks), None)
        if accel_topic is None or gyro.kind is not Imu or blocks[accel_topic].kind not in (Imu, Accelerometer):
            continue  # no stream of rates, or none of forces beside it
        accel = blocks[accel_topic]
        has_rates = "angular_rate" in accel.columns and accel.columns["angular_rate"].any()
        if gyro.columns["specific_force"].any() or has_rates or len(accel) < 2:
            continue  # one of them has numbers of the other, or there is nothing to interpolate between
        if not check_overlap(topic, gyro.t_ns, accel_topic, accel.t_ns, notes):
            forces = {"specific_force": accel.columns["specific_force"]}
            del result[topic]  # rates alone are no IMU
            result[accel_topic] = replace(accel, kind=Accelerometer, columns=forces)
            continue
        name = imu_name(topic)
        del result[topic], result[accel_topic]
        result[name] = join_at_gyro_stamps(name, gyro.as_kind(Imu), accel)
        notes.warn(f"{topic} and {accel_topic} are joined as {name}, the force interpolated to the stamps of the rate")
    return result


def _name_accel_topics(gyro_topic: str) -> Iterator[str]:
    """Yields the topics that the forces beside a stream of rates may have; none if its topic names no rates."""
    for rates, forces in _PAIRS:
        if rates in gyro_topic or rates.capitalize() in gyro_topic:
            yield gyro_topic.replace(rates, forces).replace(rates.capitalize(), forces.capitalize())


def check_overlap(gyro_name: str, gyro_ns: Stamps, accel_name: str, accel_ns: Stamps, notes: Notes) -> bool:
    """Whether the stamps of rates and forces overlap, so that the two streams can be joined.

    Stamps that do not overlap are reported as a problem with both spans; so is, as a warning, a part of the rates that
    has no forces.

    Args:
        gyro_name: What reports call the rates.
        gyro_ns: (N,) stamps of the rates.
        accel_name: What reports call the forces.
        accel_ns: (M,) stamps of the forces.
        notes: Collects the reports.
    """
    if not len(gyro_ns) or not len(accel_ns):
        return False
    first, last = int(accel_ns.min()), int(accel_ns.max())
    share = float(np.mean((gyro_ns >= first) & (gyro_ns <= last)))  # of the rates that have forces
    # forces may begin and end some of their periods later and earlier than the rates
    slack = _SLACK_PERIODS * (last - first) / max(1, len(accel_ns) - 1)
    is_covered = int(gyro_ns.min()) >= first - slack and int(gyro_ns.max()) <= last + slack
    spans = f"stamps from {_span_text(gyro_ns)}, those of {accel_name} from {_span_text(accel_ns)}"
    if share == 0.0:
        apart = "they do not overlap, so that rates and forces cannot be joined"
        what = f"{spans}: {apart}: expected stamps of one clock; record both with one driver, or correct one of them"
        notes.add_problem(Problem(gyro_name, None, what))
        return False
    if share < _LEAST_SHARE and not is_covered:
        left_out = f"{1 - share:.0%} of the rates have no forces and are left out"
        notes.warn(f"{gyro_name}: {spans}; {left_out}{_guess_clocks(gyro_ns, accel_ns, slack)}")
    return True


def _guess_clocks(gyro_ns: Stamps, accel_ns: Stamps, slack_ns: float) -> str:
    """The end of a report if rates and forces last equally long, as those of two clocks do; "" otherwise.

    A sensor that starts later, or loses its connection, moves one end of its stream alone.

    Args:
        gyro_ns: (N,) stamps of the rates.
        accel_ns: (M,) stamps of the forces.
        slack_ns: By how much the durations of one recording may differ.
    """
    at_start, at_end = int(gyro_ns.min() - accel_ns.min()), int(gyro_ns.max() - accel_ns.max())
    if abs(at_end - at_start) > slack_ns:
        return ""
    offset = f"{abs(at_start) * 1e-9:.3f} s {'later' if at_start > 0 else 'earlier'}"
    return f"; as both last equally long, the rates are probably stamped {offset}, by another clock"


def _span_text(t_ns: Stamps) -> str:
    """First and last of some stamps (N,) ns, in s."""
    return f"{t_ns.min() * 1e-9:.3f} to {t_ns.max() * 1e-9:.3f} s"


def imu_name(topic: str) -> str:
    """Topic of the IMU that a stream `.../gyro` is a part of: `.../imu`."""
    return _GYRO.sub(_JOINED, topic)


def join_at_gyro_stamps(name: str, gyro: Block[Imu], accel: Block[Sample]) -> Block[Imu]:
    """Joins two streams to one IMU, with the force interpolated linearly to the stamps of the rate.

    Args:
        name: Topic of the IMU.
        gyro: Stream whose rates are used.
        accel: Stream whose forces are used; at least two samples.

    Returns:
        A sample for each stamp of `gyro` from the first to the last stamp of `accel`.
    """
    accel = accel[is_increasing(accel.t_ns)]
    t, force = accel.t_ns, accel.columns["specific_force"]
    within = (gyro.t_ns >= t[0]) & (gyro.t_ns <= t[-1])
    # times of the rates and of the forces, s since the first force
    gyro_s: Array = (gyro.t_ns[within] - t[0]) * 1e-9
    accel_s: Array = (t - t[0]) * 1e-9
    columns = {
        "angular_rate": gyro.columns["angular_rate"][within],
        "specific_force": np.column_stack([np.interp(gyro_s, accel_s, force[:, k]) for k in range(3)]),
    }
    return Block(topic=name, kind=Imu, t_ns=gyro.t_ns[within], columns=columns)

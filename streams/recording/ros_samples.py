"""Small samples as ROS 2 messages: mapping of types and conversion of values.

Standard types wherever one exists, so that any robotics tool opens a recording without plugins. All differences between
ROS and us are converted here: quaternions are x, y, z, w in ROS, and an odometry's twist is given in the child frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.algebra.arrays import apply_quaternion
from stridetwin.streams.recording.cdr import MessageLayout, layout_of
from stridetwin.streams.recording.ros_types import serialise, typestore
from stridetwin.streams.rig import Rig
from stridetwin.streams.samples import (
    Accelerometer,
    Actuator,
    Ahrs,
    Array,
    Block,
    Encoder,
    FootPhase,
    Footprint,
    Imu,
    Insole,
    Interaction,
    Joints,
    Odometry,
    Point,
    Range,
    Sample,
    Wrench,
)

Columns = Mapping[str, NDArray[Any]]
Constants = Mapping[str, tuple[str, ...]]
Rows = NDArray[np.void]
TopicValues = Callable[[str, Rig, Constants], dict[str, object]]
"""Values that are equal in all messages of a topic, by dotted path: from topic, rig and the block's constants."""

# texts of a footprint; a Footprint message has the number of each here
FEET = ("l", "r")
TERRAINS = ("level", "stair", "ramp")
MODES = ("LG", "SA", "SD", "RA", "RD")
"""Locomotion modes: level ground, stair ascent and descent, ramp ascent and descent."""

_ABSENT = np.array([-1.0, 0, 0, 0, 0, 0, 0, 0, 0])
"""Covariance (3, 3), row by row, by which an Imu message says that it lacks a quantity: the first entry is -1."""


@dataclass(frozen=True)
class SampleMapping:
    """Mapping of one kind of small sample to a message type.

    Attributes:
        kind: The sample's type.
        typename: The message's type.
        write: Gives the fields of N messages, by dotted path, from a block's columns.
        read: Gives the columns of a block from the records of N messages.
        fixed: Values that are equal in all messages of the type, by dotted path.
        of_topic: Gives further values that are equal in all messages of a topic, by dotted path, from the topic, the
            rig and the block's constants.
        frame: Frame id in the header; "" for the sensor's own.
        constants: Gives the block's constants from a message's layout, which has its texts.
    """

    kind: type[Sample]
    typename: str
    write: Callable[[Columns], Mapping[str, NDArray[np.generic]]]
    read: Callable[[Rows], Mapping[str, NDArray[np.generic]]]
    fixed: Mapping[str, object] = field(default_factory=dict)
    of_topic: TopicValues = lambda *_: {}
    frame: str = ""
    constants: Callable[[MessageLayout], Constants] = lambda _: {}

    def collect_values(self, topic: str, rig: Rig, constants: Constants) -> dict[str, object]:
        """The values that are equal in all messages of a topic, by dotted path, such as the frame."""
        frame = {"header.frame_id": self.frame or frame_id(topic)}
        return {**frame, **self.fixed, **self.of_topic(topic, rig, constants)}

    def build_template(self, topic: str, rig: Rig, constants: Constants) -> tuple[bytes, MessageLayout]:
        """Builds a message of a topic with zeros for its numbers, and finds where these are.

        Returns:
            CDR bytes, and the layout of the numbers.
        """
        payload = serialise(self.typename, self.collect_values(topic, rig, constants))
        return payload, layout_of(payload, self.typename, typestore())


def fill_rows(rows: Rows, mapping: SampleMapping, block: Block[Sample]) -> None:
    """Writes a block's stamps and columns into message rows made from its topic's template.

    Args:
        rows: (N,) copies of the template as records, whose fields are named by dotted path; changed.
        mapping: Mapping of the block's kind.
        block: The N samples.
    """
    if "header.stamp.sec" in (rows.dtype.names or ()):  # the type has a header
        rows["header.stamp.sec"], rows["header.stamp.nanosec"] = np.divmod(block.t_ns, 1_000_000_000)
    for path, values in mapping.write(block.columns).items():
        rows[path] = values


def read_stamps(rows: Rows, log_time: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) ns: the stamps in the headers of message rows (N,), or the log times (N,) ns without stamps there."""
    if "header.stamp.sec" not in (rows.dtype.names or ()):  # a type without a header
        return log_time
    t = rows["header.stamp.sec"].astype(np.int64) * 1_000_000_000 + rows["header.stamp.nanosec"]
    return t if t.any() else log_time  # stamps that are all 0 were not set


def block_of(samples: Sequence[Sample]) -> Block[Sample]:
    """Collects one or more samples of one topic and kind in a block; tuples of texts become its constants."""
    first = samples[0]
    names = [f.name for f in fields(first) if f.name not in ("topic", "t_ns")]
    # tuples of texts, such as the names of joints, are the same in all samples of a topic
    constants = {n: getattr(first, n) for n in names if isinstance(getattr(first, n), tuple)}
    return Block(
        topic=first.topic,
        kind=type(first),
        t_ns=np.array([s.t_ns for s in samples], np.int64),
        columns={n: np.array([getattr(s, n) for s in samples]) for n in names if n not in constants},
        constants=constants,
    )


def frame_id(topic: str) -> str:
    """Frame id of a sensor's messages: the topic without its leading slash."""
    return topic.removeprefix("/")


def _conjugate(q: Array) -> Array:
    """Conjugates of unit quaternions (N, 4), (w, x, y, z): the inverse rotations."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def _to_xyzw(q: Array) -> Array:
    """Quaternions (N, 4) in ROS's order (x, y, z, w), from ours (w, x, y, z)."""
    return q[:, [1, 2, 3, 0]]


def _to_wxyz(q: Array) -> Array:
    """Quaternions (N, 4) in our order (w, x, y, z), from ROS's (x, y, z, w)."""
    return q[:, [3, 0, 1, 2]].astype(np.float64)


def _to_float64(values: NDArray[np.generic]) -> Array:
    """The values in double precision."""
    return values.astype(np.float64)


def _find_imu_covariances(topic: str, rig: Rig, _: object) -> dict[str, object]:
    """Covariances of an Imu message: noise density² × rate, (rad/s)² and (m/s²)²; empty for an IMU outside the rig."""
    if topic not in rig.imus:
        return {}
    imu = rig.imus[topic]
    return {
        "angular_velocity_covariance": np.eye(3).ravel() * imu.gyroscope_noise_density**2 * imu.rate_hz,
        "linear_acceleration_covariance": np.eye(3).ravel() * imu.accelerometer_noise_density**2 * imu.rate_hz,
    }


def _find_range_limits(topic: str, rig: Rig, _: object) -> dict[str, object]:
    """Field of view (rad) and range (m) of a Range message, from the rig; 0 if unknown."""
    parameters = rig.others[topic].parameters if topic in rig.others else {}
    # parameter of the rig by field of the message
    parameter_of = {"field_of_view": "field_of_view_rad", "min_range": "min_range_m", "max_range": "max_range_m"}
    return {field_name: parameters.get(parameter, 0.0) for field_name, parameter in parameter_of.items()}


def _read_range(rows: Rows) -> dict[str, NDArray[np.generic]]:
    """Distances in m; those out of range, which REP-117 marks by an infinity, become 0."""
    distance = _to_float64(rows["range"])
    return {"distance": np.where(np.isinf(distance), 0.0, distance)}  # REP-117: ±inf means out of range


def _make_encoder_values(topic: str, *_: object) -> dict[str, object]:
    """What all JointStates of one encoder share: the joint's name, from its topic, and room for one position."""
    return {"name": [joint_name(topic)], "position": np.zeros(1)}


def joint_name(topic: str) -> str:
    """Joint of a topic: `knee_l` of `/exo/knee_l/encoder`."""
    parts = topic.strip("/").split("/")
    return parts[-2] if len(parts) > 1 else parts[0]


def _make_joint_values(_: str, rig: Rig, constants: Constants) -> dict[str, object]:
    """The values that all JointStates of a topic share: the joints' names, and zeros in place of numbers.

    Only `constants["names"]` is used; topic and rig are arguments of every `TopicValues`.
    """
    names = list(constants["names"])
    zeros = np.zeros(len(names))
    return {"name": names, "position": zeros, "velocity": zeros, "effort": zeros}


def _read_joints(rows: Rows) -> dict[str, Array]:
    """Position, velocity and torque of joints; a quantity that the messages lack is 0."""
    position = _to_float64(rows["position"])
    others = {"velocity": _to_float64(rows["velocity"]), "torque": _to_float64(rows["effort"])}  # may be empty
    filled = {name: values if values.size else np.zeros_like(position) for name, values in others.items()}
    return {"position": position} | filled


def _name_child_frame(topic: str, *_: object) -> dict[str, object]:
    """The child frame of an Odometry message: that of the topic."""
    return {"child_frame_id": frame_id(topic)}


def _write_odometry(columns: Columns) -> dict[str, NDArray[np.generic]]:
    """Fields of Odometry messages, by dotted path; the velocity is rotated from the world to the child frame."""
    q = columns["q_world_frame"]
    return {
        "pose.pose.position": columns["p_frame_in_world"],
        "pose.pose.orientation": _to_xyzw(q),
        "twist.twist.linear": apply_quaternion(_conjugate(q), columns["v_frame_in_world"]),
        "twist.twist.angular": columns["angular_rate"],
    }


def _read_odometry(rows: Rows) -> dict[str, NDArray[np.generic]]:
    """Columns of odometry; the velocity is rotated from the child frame, as ROS has it, to the world."""
    q = _to_wxyz(rows["pose.pose.orientation"])
    return {
        "p_frame_in_world": _to_float64(rows["pose.pose.position"]),
        "q_world_frame": q,
        "v_frame_in_world": apply_quaternion(q, _to_float64(rows["twist.twist.linear"])),
        "angular_rate": _to_float64(rows["twist.twist.angular"]),
    }


def _to_codes(values: NDArray[np.generic], names: tuple[str, ...]) -> NDArray[np.uint8]:
    """(N,) index of each text (N,) in `names`, as a Footprint message has it."""
    return np.array([names.index(str(v)) for v in values], np.uint8)


def _write_footprint(columns: Columns) -> dict[str, NDArray[np.generic]]:
    """Fields of Footprint messages, by dotted path; the texts of foot, terrain and mode become numbers."""
    return {
        "foot": _to_codes(columns["foot"], FEET),
        "terrain": _to_codes(columns["terrain"], TERRAINS),
        "mode": _to_codes(columns["mode"], MODES),
        "pose.position": columns["p_foot_in_world"],
        "pose.orientation": _to_xyzw(columns["q_world_foot"]),
    }


def _read_footprint(rows: Rows) -> dict[str, NDArray[np.generic]]:
    """Columns of footprints from Footprint messages, whose numbers of foot, terrain and mode become texts.

    Raises:
        IndexError: A number stands for no text.
    """
    return {
        "foot": np.array([FEET[i] for i in rows["foot"]], object),
        "p_foot_in_world": _to_float64(rows["pose.position"]),
        "q_world_foot": _to_wxyz(rows["pose.orientation"]),
        "terrain": np.array([TERRAINS[i] for i in rows["terrain"]], object),
        "mode": np.array([MODES[i] for i in rows["mode"]], object),
    }


def _map_fields(
    kind: type[Sample],
    typename: str,
    paths: Mapping[str, str],
    *,
    fixed: Mapping[str, object] | None = None,
    of_topic: TopicValues = lambda *_: {},
    frame: str = "",
) -> SampleMapping:
    """The mapping of a sample whose columns are fields of the message under other names.

    Args:
        kind: The sample's type.
        typename: The message's type.
        paths: Dotted path of each column's field.
        fixed: Values that are equal in all messages, by dotted path.
        of_topic: Values that are equal in all messages of a topic.
        frame: Frame of the messages; "" stands for that of the topic.
    """
    return SampleMapping(
        kind,
        typename,
        lambda c: {path: c[name] for name, path in paths.items()},
        lambda rows: {name: _to_float64(rows[path]) for name, path in paths.items()},
        fixed=fixed or {},
        of_topic=of_topic,
        frame=frame,
    )


SAMPLE_MAPPINGS: dict[type[Sample], SampleMapping] = {
    small.kind: small
    for small in (
        _map_fields(
            Imu,
            "sensor_msgs/msg/Imu",
            {"angular_rate": "angular_velocity", "specific_force": "linear_acceleration"},
            fixed={"orientation.w": 1.0, "orientation_covariance": _ABSENT},
            of_topic=_find_imu_covariances,
        ),
        _map_fields(
            Accelerometer,
            "sensor_msgs/msg/Imu",
            {"specific_force": "linear_acceleration"},
            fixed={
                "orientation.w": 1.0,
                "orientation_covariance": _ABSENT,
                "angular_velocity_covariance": _ABSENT,
            },
        ),
        SampleMapping(
            Ahrs,
            "sensor_msgs/msg/Imu",
            lambda c: {"orientation": _to_xyzw(c["q_world_sensor"]), "angular_velocity": c["angular_rate"]},
            lambda r: {
                "q_world_sensor": _to_wxyz(r["orientation"]),
                "angular_rate": _to_float64(r["angular_velocity"]),
            },
            fixed={"linear_acceleration_covariance": _ABSENT},
        ),
        SampleMapping(
            Range,
            "sensor_msgs/msg/Range",
            lambda c: {"range": np.where(c["distance"] == 0.0, np.inf, c["distance"])},
            _read_range,
            of_topic=_find_range_limits,
        ),
        SampleMapping(
            Encoder,
            "sensor_msgs/msg/JointState",
            lambda c: {"position": c["angle"][:, None]},
            lambda r: {"angle": _to_float64(r["position"][:, 0])},
            of_topic=_make_encoder_values,
        ),
        SampleMapping(
            Joints,
            "sensor_msgs/msg/JointState",
            lambda c: {"position": c["position"], "velocity": c["velocity"], "effort": c["torque"]},
            _read_joints,
            of_topic=_make_joint_values,
            constants=lambda layout: {"names": tuple(layout.strings["name"])},
        ),
        SampleMapping(
            Odometry,
            "nav_msgs/msg/Odometry",
            _write_odometry,
            _read_odometry,
            of_topic=_name_child_frame,
            frame="world",
        ),
        _map_fields(
            Wrench,
            "geometry_msgs/msg/WrenchStamped",
            {"force_in_world": "wrench.force", "torque_in_world": "wrench.torque"},
            frame="world",
        ),
        _map_fields(Point, "geometry_msgs/msg/PointStamped", {"p_in_world": "point"}, frame="world"),
        SampleMapping(
            FootPhase,
            "std_msgs/msg/UInt8",
            lambda c: {"data": c["phase"]},
            lambda r: {"phase": r["data"].astype(np.int64)},
        ),
        _map_fields(Insole, "stridetwin_msgs/msg/Insole", {"force": "force"}),
        _map_fields(Interaction, "stridetwin_msgs/msg/Interaction", {"force": "force"}),
        _map_fields(
            Actuator,
            "stridetwin_msgs/msg/Actuator",
            {name: name for name in ("torque_command", "torque", "speed")},
        ),
        SampleMapping(Footprint, "stridetwin_msgs/msg/Footprint", _write_footprint, _read_footprint, frame="world"),
    )
}
_BY_TYPE = {small.typename: small for small in SAMPLE_MAPPINGS.values()}
"""The mapping of each message type; the last one where a type has several, which `find_mapping` tells apart."""


def find_mapping(typename: str, first: Rows) -> SampleMapping:
    """Finds the type of sample that a topic's messages are, from the first one by any writer.

    An Imu message with an acceleration and no angular rate is an accelerometer, one with an orientation and no
    acceleration an attitude reference, any other one an IMU. A joint state of one joint and nothing but its position is
    an encoder.

    Args:
        typename: ROS 2 type of the messages.
        first: (1,) the first message as a record, whose fields are named by dotted path.
    """
    if typename == "sensor_msgs/msg/Imu":  # -1 in a covariance means that the message lacks the quantity
        has_orientation = first["orientation_covariance"][0, 0] != -1.0
        has_force = first["linear_acceleration_covariance"][0, 0] != -1.0
        if first["angular_velocity_covariance"][0, 0] == -1.0 and has_force:
            return SAMPLE_MAPPINGS[Accelerometer]
        return SAMPLE_MAPPINGS[Ahrs if has_orientation and not has_force else Imu]
    if typename == "sensor_msgs/msg/JointState":
        one_angle = first["position"].shape[1] == 1 and not first["velocity"].size and not first["effort"].size
        return SAMPLE_MAPPINGS[Encoder if one_angle else Joints]
    return _BY_TYPE[typename]

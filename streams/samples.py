"""Sample types: measurements of the rig's sensors and ground truth, shared by simulator, recordings and estimators.

A sample belongs to a topic and has a stamp `t_ns`, integer nanoseconds on the recording's clock. Units are SI and
radians. Frames: world x forward, y left, z up; quaternions are Hamilton, scalar first (w, x, y, z).

`Block` holds N consecutive samples of one topic as columns, so that a producer can work on arrays; iterating over
it yields the samples.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from stridetwin.streams.errors import StrideTwinError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Mask = NDArray[np.bool_]
COMPONENTS = "components"
"""Key of a field's metadata: names of the vector's components, where they are neither axes nor joints."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """Measurement or ground truth of one topic at one instant.

    Attributes:
        topic: Topic, such as `/foot_l/imu`.
        t_ns: Time in integer nanoseconds on the recording's clock.
    """

    topic: str
    t_ns: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imu(Sample):
    """Inertial measurement in the sensor frame, the mean over the interval that ends at `t_ns`.

    Attributes:
        angular_rate: (3,) rad/s.
        specific_force: (3,) m/s²; +9.8 along the axis that points up at rest.
    """

    angular_rate: Array
    specific_force: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accelerometer(Sample):
    """Specific force alone, as from some RGB-D cameras without a gyroscope.

    Attributes:
        specific_force: (3,) m/s²; +9.8 along the axis that points up at rest.
    """

    specific_force: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Image(Sample):
    """Camera image.

    Attributes:
        pixels: (H, W) grey or (H, W, 3) RGB, uint8.
    """

    pixels: NDArray[np.uint8]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Depth(Sample):
    """Depth image.

    Attributes:
        depth: (H, W) float32, m along the optical axis; 0 = none.
    """

    depth: NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Range(Sample):
    """Sonar range.

    Attributes:
        distance: m; 0 = no echo.
    """

    distance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Insole(Sample):
    """Pressure insole.

    Attributes:
        force: (4,) N on the cells heel, lateral ball, medial ball, toe.
    """

    force: Array = field(metadata={COMPONENTS: ("heel", "lateral_ball", "medial_ball", "toe")})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ahrs(Sample):
    """Attitude and heading reference.

    Attributes:
        q_world_sensor: (4,) unit quaternion (w, x, y, z), sensor to world.
        angular_rate: (3,) rad/s in the sensor frame.
    """

    q_world_sensor: Array
    angular_rate: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encoder(Sample):
    """Joint encoder.

    Attributes:
        angle: rad, flexion positive.
    """

    angle: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Interaction(Sample):
    """Pair of force cells between cuff and limb.

    Attributes:
        force: (2,) N, front and back of the limb, each ≥ 0.
    """

    force: Array = field(metadata={COMPONENTS: ("front", "back")})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actuator(Sample):
    """Actuation module of one joint.

    Attributes:
        torque_command: N m, flexion positive.
        torque: measured, N m.
        speed: joint side, rad/s.
    """

    torque_command: float
    torque: float
    speed: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Odometry(Sample):
    """Truth: pose and velocity of a frame.

    Attributes:
        p_frame_in_world: (3,) m.
        q_world_frame: (4,) unit quaternion (w, x, y, z), frame to world.
        v_frame_in_world: (3,) m/s of the frame's origin, world axes.
        angular_rate: (3,) rad/s in the frame's own axes.
    """

    p_frame_in_world: Array
    q_world_frame: Array
    v_frame_in_world: Array
    angular_rate: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joints(Sample):
    """Truth: joint angles, speeds and torques.

    Attributes:
        names: (J) joint names, the same in every sample of a topic.
        position: (J,) rad.
        velocity: (J,) rad/s.
        torque: (J,) N m.
    """

    names: tuple[str, ...]
    position: Array
    velocity: Array
    torque: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wrench(Sample):
    """Truth: load of the ground on one foot.

    Attributes:
        force_in_world: (3,) N.
        torque_in_world: (3,) N m about the foot frame's origin, world axes.
    """

    force_in_world: Array
    torque_in_world: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Point(Sample):
    """Truth: a point, such as the centre of pressure under one foot (present only while the foot is loaded).

    Attributes:
        p_in_world: (3,) m.
    """

    p_in_world: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FootPhase(Sample):
    """Truth: phase of one foot.

    Attributes:
        phase: 0 swing, 1 heel (or first) contact, 2 foot flat, 3 heel off.
    """

    phase: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Footprint(Sample):
    """Truth: one footprint, sent when the foot touches down.

    Attributes:
        foot: `l` or `r`.
        p_foot_in_world: (3,) m, sole reference point where the foot rests flat.
        q_world_foot: (4,) unit quaternion (w, x, y, z) of the flat foot.
        terrain: Class of the ground under the foot: level, stair or ramp.
        mode: Locomotion mode of the step that ends here: LG, SA, SD, RA or RD.
    """

    foot: str
    p_foot_in_world: Array
    q_world_foot: Array
    terrain: str
    mode: str


S = TypeVar("S", bound=Sample)
SampleT = TypeVar("SampleT", bound=Sample, covariant=True)
LARGEST_NUMBER = 1e12
"""Larger numbers are no measurements, in whatever unit; their squares and sums would overflow."""
QUATERNION_NORM_ERROR = 0.1
"""How far the norm of an attitude in a file may be off 1: numbers of two decimals are within 0.02, and the sum of a
position or of angles is mostly beyond."""
LATEST_NS = 2**31 * 1_000_000_000
"""Stamps are below this; those of the ROS messages that hold them end there."""


def copy_sample(sample: S) -> S:
    """A sample with arrays of its own, for an estimator that keeps it: a caller may reuse the arrays after `update`."""
    values = ((f.name, getattr(sample, f.name)) for f in fields(sample))
    copies: dict[str, Any] = {name: value.copy() for name, value in values if isinstance(value, np.ndarray)}
    return replace(sample, **copies)


@dataclass(frozen=True, kw_only=True, eq=False)
class Block(Generic[SampleT]):
    """N consecutive samples of one topic as columns.

    Attributes:
        topic: Name of the stream.
        kind: Type of its samples.
        t_ns: (N,) int64, strictly increasing.
        columns: One array per field of `kind` (except topic and t_ns), leading axis N.
        constants: Fields that are the same in every sample (such as joint names).
    """

    topic: str
    kind: type[SampleT]
    t_ns: Stamps
    columns: Mapping[str, NDArray[Any]]
    constants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __iter__(self) -> Iterator[SampleT]:
        """Yields the samples one by one; their arrays are views of the block's columns."""
        names = list(self.columns)
        for i, t in enumerate(self.t_ns.tolist()):
            row = {n: self.columns[n][i] for n in names}
            yield self.kind(topic=self.topic, t_ns=t, **row, **self.constants)

    def __getitem__(self, index: slice | Mask) -> Block[SampleT]:
        """Some of the samples: a slice, or a copy of those of a (N,) mask."""
        columns = {name: values[index] for name, values in self.columns.items()}
        return replace(self, t_ns=self.t_ns[index], columns=columns)

    def split_columns(self) -> dict[str, NDArray[np.generic]]:
        """One (N,) array per number of a sample, in the order of the fields.

        A scalar keeps the name of its field. The components of a vector are named after it: `angular_rate_x`, `_y` and
        `_z` of three axes, `q_world_sensor_w`, `_x`, `_y` and `_z` of a quaternion, `force_heel` of an insole's cells,
        `position_hip_l` of joints; `_0`, `_1`, ... where the components have no names.
        """
        numbers: dict[str, NDArray[np.generic]] = {}
        for name, values in self.columns.items():
            if values.ndim == 1:  # a scalar field
                numbers[name] = values
                continue
            flat = values.reshape(len(self), math.prod(values.shape[1:]))  # (N, components)
            labels = self._component_names(name, flat.shape[1])
            numbers |= {f"{name}_{label}": flat[:, i] for i, label in enumerate(labels)}
        return numbers

    def _component_names(self, name: str, size: int) -> tuple[str, ...]:
        """Names of the `size` components of the field `name`.

        They are the names that the field declares in its metadata (`COMPONENTS`), else the joints' names, else those of
        the axes: w, x, y, z of a quaternion, or x, y, z. If their number is not `size`, the components are numbered.
        """
        declared = next((f.metadata.get(COMPONENTS, ()) for f in fields(self.kind) if f.name == name), ())
        axes = ("w", "x", "y", "z") if name.startswith("q_") else ("x", "y", "z")  # q_...: a quaternion
        names = tuple(declared or self.constants.get("names", ()) or axes)
        return names if len(names) == size else tuple(map(str, range(size)))

    def as_kind(self, kind: type[S]) -> Block[S]:
        """These samples as those of a kind, for a topic that must carry it.

        Raises:
            StrideTwinError: They are of another kind.
        """
        if not issubclass(self.kind, kind):
            raise StrideTwinError(f"{self.topic}: invalid {self.kind.__name__}: expected {kind.__name__}")
        return cast("Block[S]", self)

    @property
    def finite(self) -> Mask:
        """(N,) whether every number of a sample is finite, and no larger than `LARGEST_NUMBER`."""
        keep = np.ones(len(self), bool)
        for values in self.columns.values():
            if values.dtype.kind == "f":  # integers and texts are always valid
                keep &= (np.abs(values) <= LARGEST_NUMBER).all(axis=tuple(range(1, values.ndim)))
        return keep

    def describe_invalid(self) -> str:
        """What is wrong with the samples that are not `finite`, for a message."""
        floats = [values for values in self.columns.values() if values.dtype.kind == "f"]
        if all(np.isfinite(values).all() for values in floats):
            return f"a number beyond {LARGEST_NUMBER:g}"
        return "NaN or infinity"


def is_increasing(t_ns: Stamps, last: int = -1) -> Mask:
    """(N,) whether each of the stamps (N,) is after every previous stamp, and after `last`; all are in ns."""
    before = np.maximum.accumulate(np.concatenate(([last], t_ns)))[:-1]  # (N,) latest of the previous stamps and `last`
    return np.asarray(t_ns > before)

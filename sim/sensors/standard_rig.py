"""The standard rig: every sensor of the wearer, its mount, and its nominal calibration from the data sheet.

Data sheets give no random walks: the nominal one lets a bias vary by its in-run instability in 100 s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stridetwin.sim.choices import BODY_PLACES
from stridetwin.sim.config import SIDES, TwinConfig
from stridetwin.sim.exo_description import OnLink, OwnExo
from stridetwin.sim.parts.kinds import Imager, ImuPart, Part
from stridetwin.sim.parts.nominal import NOMINAL, nominal_rig
from stridetwin.sim.parts.sensor_config import (
    KIND,
    STANDARD_BACK_AHRS,
    STANDARD_BACK_IMU,
    Clock,
    Seat,
    SensorConfig,
    part_of,
)
from stridetwin.sim.wearer.exoskeleton import modules
from stridetwin.sim.wearer.imu_places import body_of, default_position, split_side
from stridetwin.streams.algebra.arrays import from_euler
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array

GROUPS = tuple(KIND)
EXO_GROUPS = ("ahrs", "exo_imu", "encoder", "interaction", "actuator")
_DEG = math.pi / 180
_WALK_S = 100.0  # time in which the nominal random walk of a bias equals its in-run instability

# places on the shoes, m in the foot's frame; a `Seat` counts aside towards the other foot
FOOT_IMU = (-0.030, 0.042, 0.060)  # forward, outward, up
FOOT_CAMERA = Seat(position_m=(-0.070, 0.045, 0.036), faces_rad=(27 * _DEG, 24 * _DEG), roll_rad=90 * _DEG)
FOOT_BOARD = Seat(position_m=(-0.074, -0.005, 0.066), faces_rad=(167 * _DEG, 2 * _DEG))
SONAR = Seat(position_m=(-0.030, 0.040, 0.050), faces_rad=(90 * _DEG, 0.0))
RGBD_PITCH_RAD = 25 * _DEG  # of the RGB-D camera, down
# body and position (m, forward, left, up) of the RGB-D camera, by its place
RGBD_MOUNT = {"head": ("head", (0.10, 0.0, 0.12)), "chest": ("torso", (0.14, 0.0, 0.30))}
# links of the built-in exoskeleton with an AHRS
_AHRS_PLACES = ("back", *(f"{part}_{side}" for part in ("thigh", "foot") for side in SIDES))
# D455 data sheet: the IMU relative to the imagers, optical axes.
_P_IMU_IN_RGBD = (-0.0302, 0.0074, 0.0160)

Calibration = ImuCalibration | CameraCalibration | OtherSensor


@dataclass(frozen=True, kw_only=True, eq=False)
class MountedSensor:
    """A sensor on the wearer.

    Attributes:
        group: Group of sensors, such as `foot_imu`.
        calibration: Topic, mount and nominal figures.
        part: True parameters.
        sensor_config: Differences of the group from the standard one.
    """

    group: str
    calibration: Calibration
    part: Part
    sensor_config: SensorConfig

    @property
    def clock(self) -> Clock:
        """Clock of the sensor."""
        return self.sensor_config.clock


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorRig:
    """All sensors of a walk.

    Attributes:
        rig: Their true calibration.
        sensors: Each sensor with its true parameters, by topic; that of a camera is its colour topic.
    """

    rig: Rig
    sensors: dict[str, MountedSensor]

    def nominal(self, seed: int) -> Rig:
        """Nominal rig, which estimators get on the walk with this seed."""
        return nominal_rig(
            self.rig, ((t, self.sensors[t].sensor_config.calibration_sd) for t in self.rig.cameras), seed
        )


def standard_rig(config: TwinConfig) -> Rig:
    """True calibration of a walk's rig; without exoskeleton, its sensors are omitted.

    Raises:
        ConfigError: An unknown group of sensors or an unknown place for the RGB-D camera.
    """
    return sensor_rig(config).rig


def sensor_rig(config: TwinConfig) -> SensorRig:
    """The sensors of a walk; without exoskeleton, its groups are omitted.

    Raises:
        ConfigError: An unknown group of sensors or an unknown place for the RGB-D camera.
    """
    for i, group in enumerate(config.sensors):
        if group not in GROUPS:
            raise ConfigError(config.name, f"sensors[{i}]", group, ", ".join(GROUPS))
    if config.rig_mount not in RGBD_MOUNT:
        raise ConfigError(config.name, "rig_mount", config.rig_mount, " or ".join(RGBD_MOUNT))
    used = set(config.sensors) - set(EXO_GROUPS if config.exo is None else ())  # groups
    sensors = {s.calibration.topic: s for group in GROUPS if group in used for s in _SENSORS[group](config)}
    calibrations = [s.calibration for s in sensors.values()]
    rig = Rig(
        imus={s.topic: s for s in calibrations if isinstance(s, ImuCalibration)},
        cameras={s.topic: s for s in calibrations if isinstance(s, CameraCalibration)},
        boards={b.name: b for b in _make_boards(config)} if "foot_camera" in used else {},
        others={s.topic: s for s in calibrations if isinstance(s, OtherSensor)},
    )
    return SensorRig(rig=rig, sensors=sensors)


def _own_exo(config: TwinConfig) -> OwnExo | None:
    """The custom exoskeleton of the wearer; None without one."""
    return config.exo.user_exo if config.exo is not None else None


def _group_config(config: TwinConfig, group: str) -> SensorConfig:
    """Configuration of a group of sensors: that of the scenario, or the standard one."""
    return config.fittings.get(group, SensorConfig())


def _select_part(config: TwinConfig, group: str, standard: str | Part | None = None) -> tuple[Any, Any, SensorConfig]:
    """True part and nominal part of a group of sensors, and the group's configuration.

    Args:
        config: Scenario.
        group: Group of sensors.
        standard: Default part: its name, or a part from the rig file of an exoskeleton; None for that of the group.
    """
    sensor_config = _group_config(config, group)
    if not isinstance(standard, Part):
        return *part_of(config.fittings, group, config.ideal, standard), sensor_config
    # a part from a rig file stands in for that of the group, unless the scenario names another one
    configs = (
        config.fittings if sensor_config.part else {**config.fittings, group: replace(sensor_config, part=standard)}
    )
    return *part_of(configs, group, config.ideal), sensor_config


def _make_imu(
    config: TwinConfig, group: str, topic: str, mount: Mount, standard: str | Part | None = None
) -> MountedSensor:
    """An IMU of a group, mounted on a body.

    Args:
        config: Scenario.
        group: Group of sensors.
        topic: Its topic.
        mount: Its mount.
        standard: Default part: its name, or a part from the rig file of an exoskeleton; None for that of the group.
    """
    part, nominal, sensor_config = _select_part(config, group, standard)
    if part is not nominal:  # an ideal part has no errors to draw
        sensor_config = replace(sensor_config, population=None)
    return MountedSensor(
        group=group, calibration=nominal_imu(topic, nominal, mount), part=part, sensor_config=sensor_config
    )


def nominal_imu(topic: str, part: ImuPart, mount: Mount) -> ImuCalibration:
    """Nominal calibration of an IMU, from the figures of its data sheet.

    The random walk of each bias is such that it varies by its in-run instability in 100 s.
    """
    gyroscope, accelerometer = part.gyroscope, part.accelerometer
    return ImuCalibration(
        topic=topic,
        part=part.description,
        rate_hz=part.rate_hz,
        mount=mount,
        gyroscope_noise_density=gyroscope.noise_density,
        gyroscope_random_walk=gyroscope.bias_instability / math.sqrt(_WALK_S),
        accelerometer_noise_density=accelerometer.noise_density,
        accelerometer_random_walk=accelerometer.bias_instability / math.sqrt(_WALK_S),
        gyroscope_bias_sd=gyroscope.turn_on_bias,
        accelerometer_bias_sd=accelerometer.turn_on_bias,
        # 0 stands for unknown
        gyroscope_range=gyroscope.range if math.isfinite(gyroscope.range) else 0.0,
        accelerometer_range=accelerometer.range if math.isfinite(accelerometer.range) else 0.0,
        gyroscope_scale_sd=gyroscope.scale_factor,
        gyroscope_misalignment_sd=gyroscope.misalignment,
        accelerometer_scale_sd=accelerometer.scale_factor,
    )


def foot_imu_position(config: TwinConfig, side: str) -> Array:
    """(3,) m, position of a shoe's IMU in the foot's frame; it is defined even if that IMU is off."""
    forward, outward, up = _group_config(config, "foot_imu").position_m or FOOT_IMU
    return np.array([forward, outward * _outward(side), up])


def _foot_imu_rotation(config: TwinConfig, side: str) -> Array:
    """(3, 3) rotation of a shoe's IMU in the foot's frame."""
    return _mirror_rotation(_group_config(config, "foot_imu").rotation_rad, side)


def _mirror_rotation(rotation_rad: tuple[float, float, float] | None, side: str) -> Array:
    """(3, 3) rotation of an IMU in the frame of its segment; None stands for none.

    Args:
        rotation_rad: Roll, pitch and yaw of the left one; roll and yaw change their signs in a mirror image.
        side: `r` for the mirror image.
    """
    if rotation_rad is None:
        return np.eye(3)
    roll, pitch, yaw = rotation_rad
    return from_euler(np.array([[yaw * _outward(side), pitch, roll * _outward(side)]]))[0]


def _foot_imus(config: TwinConfig) -> Iterator[MountedSensor]:
    """The IMUs of both shoes."""
    for side in SIDES:
        pose = _make_pose(_foot_imu_rotation(config, side), foot_imu_position(config, side))
        yield _make_imu(config, "foot_imu", f"/foot_{side}/imu", Mount(body=f"foot_{side}", T_body_sensor=pose))


def _body_imus(config: TwinConfig) -> Iterator[MountedSensor]:
    """The IMUs on segments of the body, in the order of `BODY_PLACES`."""
    worn = _group_config(config, "body_imu").places
    for place in BODY_PLACES:
        if worn is not None and place not in worn:
            continue
        own = SensorConfig() if worn is None else worn[place]
        _, side = split_side(place)
        position = np.array(default_position(place, config.person) if own.position_m is None else own.position_m)
        position[1] *= _outward(side or "l")  # in the middle of the body it counts to the left
        pose = _make_pose(_mirror_rotation(own.rotation_rad, side or "l"), position)
        mount = Mount(body=body_of(place), T_body_sensor=pose)
        # the place's own configuration stands in for that of the group
        of_place = replace(config, fittings={**config.fittings, "body_imu": own})
        yield _make_imu(of_place, "body_imu", f"/body/{place}/imu", mount)


def _head_imu(config: TwinConfig) -> Iterator[MountedSensor]:
    """The IMU of the RGB-D camera, on head or chest."""
    camera = _rgbd_mount(config)
    mount = Mount(body=camera.body, T_body_sensor=camera.T_body_sensor @ _make_pose(np.eye(3), _P_IMU_IN_RGBD))
    yield _make_imu(config, "head_imu", f"/{config.rig_mount}/imu", mount)


def _make_camera(
    config: TwinConfig, group: str, imu_group: str, place: str, mount: Mount, depth: bool
) -> MountedSensor:
    """A camera of a group.

    Args:
        config: Scenario.
        group: Group of the camera.
        imu_group: Group of the IMU to which its time shift refers; without it the camera has no IMU.
        place: Prefix of its topics, such as `head` or `foot_l`.
        mount: Its mount.
        depth: Whether it has depth.
    """
    part, nominal, sensor_config = _select_part(config, group)
    imager: Imager = nominal.imager
    # s, which turns stamps of the camera into those of the IMU: delay of the IMU's stamps minus that of the camera's
    timeshift_s = _nominal_shift(config, imu_group) - _nominal_shift(config, group)
    width, height = round(imager.width), round(imager.height)
    calibration = CameraCalibration(
        topic=f"/{place}/color" if depth else f"/{place}/camera",
        part=part.description,
        rate_hz=part.rate_hz,
        mount=mount,
        width=width,
        height=height,
        intrinsics=(imager.focal, imager.focal, (width - 1) / 2, (height - 1) / 2),
        distortion_model=imager.distortion_model,
        distortion=imager.distortion,
        depth_topic=f"/{place}/depth" if depth else "",
        imu_topic=f"/{place}/imu" if imu_group in config.sensors else "",
        timeshift_cam_imu_s=timeshift_s,
        readout_s=part.imager.rolling_s,
    )
    return MountedSensor(group=group, calibration=calibration, part=part, sensor_config=sensor_config)


def _nominal_shift(config: TwinConfig, group: str) -> float:
    """Constant delay of a group's stamps that its calibration knows, s."""
    clock = _group_config(config, group).clock
    return clock.shift_s if clock.calibrated else 0.0


def _foot_cameras(config: TwinConfig) -> Iterator[MountedSensor]:
    """The cameras of both shoes; each one sees the board on the other shoe."""
    seat = _group_config(config, "foot_camera").mount or FOOT_CAMERA
    for side in SIDES:
        position, forward = _shoe_place(seat, side)
        pose = _make_pose(_viewing_rotation(forward, seat.roll_rad * -_outward(side)), position)
        mount = Mount(body=f"foot_{side}", T_body_sensor=pose)
        yield _make_camera(config, "foot_camera", "foot_imu", f"foot_{side}", mount, depth=False)


def _shoe_place(seat: Seat, side: str) -> tuple[Array, Array]:
    """(3,) position, m, and (3,) viewing direction of a seat on a shoe, in the foot's frame.

    `seat` counts sideways towards the other foot, so that it holds for both shoes.
    """
    forward, inward, up = seat.position_m
    towards, upward = seat.faces_rad
    return np.array([forward, inward * -_outward(side), up]), _direction(towards * -_outward(side), upward)


def _rgbd(config: TwinConfig) -> Iterator[MountedSensor]:
    """The RGB-D camera on head or chest."""
    yield _make_camera(config, "head_camera", "head_imu", config.rig_mount, _rgbd_mount(config), depth=True)


def _rgbd_mount(config: TwinConfig) -> Mount:
    """Mount of the RGB-D camera: on head or chest, pitched down."""
    body, position = RGBD_MOUNT[config.rig_mount]
    sensor_config = _group_config(config, "head_camera")
    pitch = RGBD_PITCH_RAD if sensor_config.pitch_down_rad is None else sensor_config.pitch_down_rad
    seat = sensor_config.mount or Seat(position_m=position, faces_rad=(0.0, -pitch))
    rotation = _viewing_rotation(_direction(*seat.faces_rad), seat.roll_rad)
    return Mount(body=body, T_body_sensor=_make_pose(rotation, seat.position_m))


def _make_boards(config: TwinConfig) -> Iterator[Board]:
    """The checkerboards on both shoes: 6 by 9 squares of 5 mm, upright."""
    seat = _group_config(config, "foot_camera").board or FOOT_BOARD
    for side in SIDES:
        position, out = _shoe_place(seat, side)
        # axes of the board: z out of it, y as far up as possible
        up = np.array([0.0, 0.0, 1.0]) - out[2] * out
        up /= np.linalg.norm(up)
        pose = _make_pose(np.column_stack([np.cross(up, out), up, out]), position)
        mount = Mount(body=f"foot_{side}", T_body_sensor=pose)
        yield Board(name=mount.body, mount=mount, squares=(6, 9), square_m=0.005)


def _make_other_sensor(
    config: TwinConfig, group: str, kind: str, topic: str, mount: Mount, /, **more: Any
) -> MountedSensor:
    """A sensor that is neither IMU nor camera.

    Args:
        config: Scenario.
        group: Group of sensors.
        kind: Kind of `OtherSensor`.
        topic: Its topic.
        mount: Its mount.
        more: Further parameters of the calibration; `standard` is the default part, `named` replaces its description.
    """
    part, nominal, sensor_config = _select_part(config, group, more.pop("standard", None))
    calibration = OtherSensor(
        topic=topic,
        kind=kind,
        part=more.pop("named", nominal.description),
        rate_hz=nominal.rate_hz,
        mount=mount,
        parameters=NOMINAL[kind](nominal) | more,
    )
    return MountedSensor(group=group, calibration=calibration, part=part, sensor_config=sensor_config)


def _sonars(config: TwinConfig) -> Iterator[MountedSensor]:
    """The ultrasonic rangers of both shoes, which face the other foot."""
    seat = _group_config(config, "sonar").mount
    for side in SIDES:
        out = _outward(side)
        forward, aside, up = SONAR.position_m  # aside is towards the other foot
        # direction of the beam, exactly sideways, and its place, in the foot's frame; a mount of the scenario replaces
        # both
        inward, place = np.array([0.0, -out, 0.0]), np.array([forward, -aside * out, up])
        if seat is not None:
            place, inward = _shoe_place(seat, side)
        mount = Mount(body=f"foot_{side}", T_body_sensor=_make_pose(_rotation_with_x(inward), place))
        yield _make_other_sensor(config, "sonar", "range", f"/foot_{side}/sonar", mount)


def _insoles(config: TwinConfig) -> Iterator[MountedSensor]:
    """The pressure insoles of both shoes with the places of their four cells."""
    for side in SIDES:
        out = _outward(side)
        # heel, lateral ball, medial ball, toe: x and y in the foot's frame, m
        cells = [[0.000, 0.0], [0.125, 0.028 * out], [0.140, -0.024 * out], [0.200, -0.010 * out]]
        yield _make_other_sensor(
            config, "insole", "insole", f"/foot_{side}/insole", Mount(body=f"foot_{side}"), cells_m=cells
        )


def _ahrs(config: TwinConfig) -> Iterator[MountedSensor]:
    """The attitude references on the links of the exoskeleton."""
    own_exo = _own_exo(config)
    mounts = {place: Mount(body=f"exo_{place}") for place in _AHRS_PLACES}
    if own_exo is not None:
        mounts = {place: _link_mount(seat) for place, seat in own_exo.ahrs.items()}
    for place, mount in mounts.items():
        standard = STANDARD_BACK_AHRS if place == "back" else None
        yield _make_other_sensor(config, "ahrs", "ahrs", f"/exo/{place}/ahrs", mount, standard=standard)


def _exo_imus(config: TwinConfig) -> Iterator[MountedSensor]:
    """The inertial sensors inside the AHRSs, and those added to a custom exoskeleton."""
    own_exo = _own_exo(config)
    for place, (seat, part) in own_exo.imus.items() if own_exo is not None else ():
        yield _make_imu(config, "exo_imu", f"/exo/{place}/imu", _link_mount(seat), part)
    for place in _AHRS_PLACES if own_exo is None else ():
        standard = STANDARD_BACK_IMU if place == "back" else None
        yield _make_imu(config, "exo_imu", f"/exo/{place}/imu", Mount(body=f"exo_{place}"), standard)


def _encoders(config: TwinConfig) -> Iterator[MountedSensor]:
    """The encoders of the exoskeleton's joints; each is mounted on the body that its joint moves."""
    own_exo = _own_exo(config)
    # body that each joint moves, by joint
    moved = {f"knee_{side}": f"exo_shank_{side}" for side in SIDES}
    if own_exo is not None:
        moved = {name: own_exo.body_moved_by(name) for name in own_exo.encoders}
    for name, body in moved.items():
        yield _make_other_sensor(config, "encoder", "encoder", f"/exo/{name}/encoder", Mount(body=body))


def _interactions(config: TwinConfig) -> Iterator[MountedSensor]:
    """The force-cell pairs in the exoskeleton's cuffs."""
    own_exo = _own_exo(config)
    # (place, which is the limb; body of the exoskeleton)
    cuffs = [(f"{part}_{side}", f"exo_{part}_{side}") for part in ("thigh", "shank") for side in SIDES]
    if own_exo is not None:
        cuffs = [(cuff.body, cuff.link) for cuff in own_exo.cuffs if cuff.force_cells]
    for place, body in cuffs:
        yield _make_other_sensor(config, "interaction", "interaction", f"/exo/{place}/interaction", Mount(body=body))


def _actuators(config: TwinConfig) -> Iterator[MountedSensor]:
    """The actuation modules as sensors of torque and speed; joints without a module report zero torque."""
    mounted = {} if config.exo is None else modules(config.exo)  # modules by joint
    limits: dict[str, dict[str, Any]] = {
        name: {"torque_max_nm": float(m.torque_max_nm), "speed_max_radps": float(m.speed_max_radps)}
        for name, m in mounted.items()
    }
    own_exo = _own_exo(config)
    if own_exo is None:
        moved_parts = (("hip", "thigh"), ("knee", "shank"))  # joint, and the link that it moves
        moved = {f"{joint}_{s}": f"exo_{link}_{s}" for joint, link in moved_parts for s in SIDES}
    else:
        moved = {name: own_exo.body_moved_by(name) for name in mounted}
    for name, body in moved.items():
        more: dict[str, Any] = {"named": "actuation module" if name in mounted else "no actuation module"}
        if own_exo is not None:
            more = {"standard": own_exo.motors[name]}
        more |= limits.get(name, {})
        yield _make_other_sensor(config, "actuator", "actuator", f"/exo/{name}/actuator", Mount(body=body), **more)


# sensors of each group, from the scenario
_SENSORS = {
    "foot_imu": _foot_imus,
    "foot_camera": _foot_cameras,
    "sonar": _sonars,
    "insole": _insoles,
    "ahrs": _ahrs,
    "exo_imu": _exo_imus,
    "encoder": _encoders,
    "interaction": _interactions,
    "actuator": _actuators,
    "head_imu": _head_imu,
    "head_camera": _rgbd,
    "body_imu": _body_imus,
}


def _link_mount(seat: OnLink) -> Mount:
    """Mount on a link of a custom exoskeleton."""
    return Mount(body=seat.link, T_body_sensor=seat.T_link)


def _outward(side: str) -> float:
    """Sign of the outward direction along y: 1 for `l`, -1 for `r`."""
    return 1.0 if side == "l" else -1.0


def _make_pose(rotation: ArrayLike, position: ArrayLike) -> Array:
    """(4, 4) transform of a (3, 3) rotation and a (3,) position, m."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def _direction(left: float, up: float) -> Array:
    """(3,) unit vector in a body's frame: forward (x), turned by `left` rad to the left and by `up` rad upwards."""
    return np.array([math.cos(up) * math.cos(left), math.cos(up) * math.sin(left), math.sin(up)])


def _viewing_rotation(forward: Array, roll: float) -> Array:
    """(3, 3) rotation of an optical frame (x right, y down, z along the view), upright and then rolled.

    Args:
        forward: (3,) unit viewing direction in the body's frame, not vertical.
        roll: rad, clockwise as the camera sees it.
    """
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = math.cos(roll), math.sin(roll)
    return np.column_stack([cos * right + sin * down, cos * down - sin * right, forward])


def _rotation_with_x(axis: ArrayLike) -> Array:
    """(3, 3) rotation of a frame: x axis along the unit vector `axis`, not vertical, and y axis horizontal."""
    x = np.asarray(axis, dtype=float)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])

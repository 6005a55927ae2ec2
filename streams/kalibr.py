"""The rig as one Kalibr YAML file.

`cam0`, `cam1`, ... and `imu0`, `imu1`, ... follow Kalibr
(https://github.com/ethz-asl/kalibr/wiki/yaml-formats), so that its tools and everything built on them can read
the file. Values without a Kalibr key (mounts, parts, boards, other sensors) are under the key `stridetwin`. A plain
Kalibr calibration can be read, too: its body is then `imu0`, the IMU's own frame, and its camera rates are 0,
undeclared.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.files import whole_file
from stridetwin.streams.rig import Board, CameraCalibration, ImuCalibration, Mount, OtherSensor, Rig
from stridetwin.streams.samples import Array
from stridetwin.streams.yaml_file import FastDumper
from stridetwin.streams.yaml_node import Node, parse_node, read_node

KINDS = ("range", "insole", "ahrs", "encoder", "interaction", "actuator")
DISTORTIONS = ("radtan", "equidistant")
PLAIN_BODY = "imu0"
_OURS = "stridetwin"
_NOISE = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
_BEYOND_NOISE = ("gyroscope_bias_sd", "accelerometer_bias_sd", "gyroscope_range", "accelerometer_range")


def rig_to_yaml(rig: Rig) -> str:
    """A rig as YAML text."""
    document: dict[str, Any] = {}
    ours: dict[str, Any] = {}
    for i, camera in enumerate(rig.cameras.values()):
        document[f"cam{i}"] = {
            "camera_model": "pinhole",
            "intrinsics": _floats(camera.intrinsics),
            "distortion_model": camera.distortion_model,
            "distortion_coeffs": _floats(camera.distortion),
            "resolution": [int(camera.width), int(camera.height)],
            "rostopic": camera.topic,
            "timeshift_cam_imu": float(camera.timeshift_cam_imu_s),
        }
        if (T_cam_imu := _T_cam_imu(rig, camera)) is not None:
            document[f"cam{i}"]["T_cam_imu"] = T_cam_imu.tolist()
        ours[f"cam{i}"] = {
            "part": camera.part,
            "rate_hz": float(camera.rate_hz),
            "mount": _mount(camera.mount),
            "depth_topic": camera.depth_topic,
            "imu_topic": camera.imu_topic,
        }
    for i, imu in enumerate(rig.imus.values()):
        document[f"imu{i}"] = {
            "rostopic": imu.topic,
            "update_rate": float(imu.rate_hz),
            **{name: float(getattr(imu, name)) for name in _NOISE},
            "T_i_b": np.eye(4).tolist(),
        }
        ours[f"imu{i}"] = {
            "part": imu.part,
            "mount": _mount(imu.mount),
            **{name: float(getattr(imu, name)) for name in _BEYOND_NOISE},
        }
    ours["boards"] = {
        name: {
            "mount": _mount(b.mount),
            "squares": [int(n) for n in b.squares],
            "square_m": float(b.square_m),
        }
        for name, b in rig.boards.items()
    }
    ours["sensors"] = [
        {
            "topic": s.topic,
            "kind": s.kind,
            "part": s.part,
            "rate_hz": float(s.rate_hz),
            "mount": _mount(s.mount),
            "parameters": {k: np.asarray(v, float).tolist() for k, v in s.parameters.items()},
        }
        for s in rig.others.values()
    ]
    text: str = yaml.dump(
        document | {_OURS: ours}, Dumper=FastDumper, sort_keys=False, default_flow_style=None, width=120
    )  # fmt: skip
    return text


def write_rig(rig: Rig, path: str | Path) -> None:
    """Writes a rig as a YAML file, atomically."""
    with whole_file(path) as temporary:
        temporary.write_text(rig_to_yaml(rig), encoding="utf-8")


def rig_from_yaml(text: str, source: str) -> Rig:
    """A rig from YAML text.

    Args:
        text: The YAML.
        source: Name of the text in errors.

    Raises:
        StrideTwinError: The text is not YAML, or a value in it is invalid; names the key path and what is valid.
    """
    return _rig(parse_node(text, source))


def read_rig(path: str | Path, *more: str | Path) -> Rig:
    """A rig from a YAML file, or from Kalibr's two: camera chain and IMU.

    Raises:
        StrideTwinError: A file cannot be read, or a value in it is invalid; names file, key path and what is valid.
    """
    roots = [read_node(p) for p in (path, *more)]
    if len(roots) == 1:
        return _rig(roots[0])
    merged: dict[str, Any] = {}
    for root in roots:
        merged |= _sections(root).mapping()
    return _rig(Node(" + ".join(root.source for root in roots), "", merged))


def _rig(root: Node) -> Rig:
    root = _sections(root)
    has_ours = _OURS in root
    ours = root.at(_OURS, {})
    cams, imus = _numbered(root, "cam"), _numbered(root, "imu")
    ours.only([*cams, *imus, "boards", "sensors"])
    if not (cams or imus or has_ours):
        raise root.error(f"a Kalibr calibration with cam0, ..., imu0, ... or {_OURS}")
    inertial = [_imu(root.at(name), ours.at(name) if has_ours else None) for name in imus]
    rig = Rig(
        imus=_by_topic(root, inertial),
        boards={name: _board(name, ours.at("boards").at(name)) for name in ours.at("boards", {})} if has_ours else {},
        others=_by_topic(root, [_other(n) for n in ours.at("sensors", []).items()]),
    )
    cameras: list[CameraCalibration] = []
    previous: Array | None = None
    for name in cams:
        section = root.at(name)
        given = _given_T_cam_imu(section, previous)
        own = ours.at(name) if has_ours else None
        cameras.append(_camera(section, own, given, rig, inertial[0].topic if inertial else ""))
        previous = given
    return Rig(imus=rig.imus, cameras=_by_topic(root, cameras), boards=rig.boards, others=rig.others)


def _sections(root: Node) -> Node:
    """The root; Kalibr's flat imu.yaml is moved under `imu0`."""
    return Node(root.source, "", {"imu0": root.value}) if "update_rate" in root else root


def _numbered(root: Node, stem: str) -> list[str]:
    names = [k for k in root if re.fullmatch(rf"{stem}\d+", k)]
    return sorted(names, key=lambda k: int(k.removeprefix(stem)))


def _by_topic(root: Node, items: list[Any]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for item in items:
        if item.topic in table:
            raise ConfigError(root.source, "rostopic", item.topic, "a topic that no other sensor of its kind has")
        table[item.topic] = item
    return table


def _imu(node: Node, ours: Node | None) -> ImuCalibration:
    if ours is not None:
        ours.only(["part", "mount", *_BEYOND_NOISE])
    return ImuCalibration(
        topic=node.at("rostopic", f"/{node.path}").text(),
        part=ours.at("part", "").text() if ours else "",
        rate_hz=node.at("update_rate").number(0, above=True),
        mount=_read_mount(ours.at("mount")) if ours else Mount(body=PLAIN_BODY),
        **{name: node.at(name).number(0) for name in _NOISE},
        **{name: ours.at(name, 0.0).number(0) if ours else 0.0 for name in _BEYOND_NOISE},
    )


def _camera(node: Node, ours: Node | None, T_cam_imu: Array | None, rig: Rig, first_imu: str) -> CameraCalibration:
    node.at("camera_model").choice(("pinhole",))
    width, height = (n.integer(1) for n in _pair(node.at("resolution")))
    fu, fv, pu, pv = node.at("intrinsics").numbers(4)
    if fu <= 0 or fv <= 0:
        raise node.at("intrinsics").error("fu, fv, pu, pv with focal lengths above 0")
    k1, k2, k3, k4 = node.at("distortion_coeffs").numbers(4)
    if ours is None:
        mount = Mount(body=PLAIN_BODY, T_body_sensor=np.eye(4) if T_cam_imu is None else _inverse(T_cam_imu))
        imu_topic = first_imu
    else:
        ours.only(["part", "rate_hz", "mount", "depth_topic", "imu_topic"])
        imu_topic = ours.at("imu_topic", "").text()
        if imu_topic and imu_topic not in rig.imus:
            raise ours.at("imu_topic").error(f"'' or one of {', '.join(rig.imus) or 'no IMU at all'}")
        mount = _camera_mount(node, ours.at("mount"), T_cam_imu, rig.imus.get(imu_topic))
    return CameraCalibration(
        topic=node.at("rostopic").text(),
        part=ours.at("part", "").text() if ours else "",
        rate_hz=ours.at("rate_hz").number(0) if ours else 0.0,
        mount=mount,
        width=width,
        height=height,
        intrinsics=(fu, fv, pu, pv),
        distortion_model=node.at("distortion_model").choice(DISTORTIONS),
        distortion=(k1, k2, k3, k4),
        depth_topic=ours.at("depth_topic", "").text() if ours else "",
        imu_topic=imu_topic,
        timeshift_cam_imu_s=node.at("timeshift_cam_imu", 0.0).number(),
    )


def _camera_mount(node: Node, mount: Node, T_cam_imu: Array | None, imu: ImuCalibration | None) -> Mount:
    """A camera's mount, checked against Kalibr's T_cam_imu: they must agree, or the mount must be omitted."""
    if T_cam_imu is None or imu is None:
        return _read_mount(mount)
    derived = imu.mount.T_body_sensor @ _inverse(T_cam_imu)
    if "T_body_sensor" not in mount:
        mount.only(["body"])
        return Mount(body=mount.at("body").text(), T_body_sensor=derived)
    given = _read_mount(mount)
    if given.body != imu.mount.body or not np.allclose(given.T_body_sensor, derived, atol=1e-6):
        raise node.at("T_cam_imu").error(
            f"the transform from {mount.path}.T_body_sensor and the mount of {imu.topic}; "
            "omit the former to use T_cam_imu"
        )
    return given


def _given_T_cam_imu(node: Node, previous: Array | None) -> Array | None:
    if "T_cam_imu" in node:
        return node.at("T_cam_imu").transform()
    if "T_cn_cnm1" in node and previous is not None:
        return node.at("T_cn_cnm1").transform() @ previous
    return None


def _T_cam_imu(rig: Rig, camera: CameraCalibration) -> Array | None:
    if not camera.imu_topic:
        return None
    imu = rig.imu(camera.imu_topic)
    if imu.mount.body != camera.mount.body:
        raise ConfigError(camera.topic, "imu_topic", camera.imu_topic, f"an IMU on the same body, {camera.mount.body}")
    return _inverse(camera.mount.T_body_sensor) @ imu.mount.T_body_sensor


def _board(name: str, node: Node) -> Board:
    node.only(["mount", "squares", "square_m"])
    columns, rows = (n.integer(2) for n in _pair(node.at("squares")))
    return Board(
        name=name,
        mount=_read_mount(node.at("mount")),
        squares=(columns, rows),
        square_m=node.at("square_m").number(0, above=True),
    )


def _other(node: Node) -> OtherSensor:
    node.only(["topic", "kind", "part", "rate_hz", "mount", "parameters"])
    return OtherSensor(
        topic=node.at("topic").text(),
        kind=node.at("kind").choice(KINDS),
        part=node.at("part", "").text(),
        rate_hz=node.at("rate_hz").number(0, above=True),
        mount=_read_mount(node.at("mount")),
        parameters={k: _parameter(node.at("parameters").at(k)) for k in node.at("parameters", {})},
    )


def _parameter(node: Node) -> Any:
    return [_parameter(n) for n in node.items()] if isinstance(node.value, list) else node.number()


def _pair(node: Node) -> list[Node]:
    if not isinstance(node.value, list) or len(node.value) != 2:
        raise node.error("a list of 2 integers")
    return node.items()


def _read_mount(node: Node) -> Mount:
    node.only(["body", "T_body_sensor"])
    return Mount(body=node.at("body").text(), T_body_sensor=node.at("T_body_sensor").transform())


def _mount(mount: Mount) -> dict[str, Any]:
    return {"body": mount.body, "T_body_sensor": np.asarray(mount.T_body_sensor, float).tolist()}


def _inverse(T: Array) -> Array:
    R, p = T[:3, :3], T[:3, 3]
    inverse = np.eye(4)
    inverse[:3, :3], inverse[:3, 3] = R.T, -R.T @ p
    return inverse


def _floats(values: Any) -> list[float]:
    return [float(v) for v in values]

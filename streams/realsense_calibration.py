"""RealSense's factory calibration: the text of `rs-enumerate-devices -c`, and JSON with the fields of librealsense.

An extrinsic from X to Y takes points: p_Y = R p_X + t. The text prints R by rows; nine numbers in JSON are in
librealsense's order, by columns.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from stridetwin.streams.calibration_keys import Section
from stridetwin.streams.errors import ConfigError
from stridetwin.streams.foreign_calibration import Converted
from stridetwin.streams.samples import Array

_CHOICE = ("color", "rgb", "infrared1", "infrared", "left", "fisheye1", "depth")
"""Streams of which the first that has intrinsics is the camera."""
_IMUS = ("gyro", "imu", "motion", "accel")
"""Streams of which the first with a transform to the camera is the frame of the IMU."""
_NAMES = {"infra1": "infrared1", "infra2": "infrared2", "ir1": "infrared1", "ir2": "infrared2", "colour": "color"}
"""Our name of a stream, by that in a file."""
_NUMBER = r"[-+]?(?:\d{1,20}(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d{1,2})?"
"""A number, as `-1.5e-3`; finite, however long it is."""
_INTRINSIC = re.compile(r'^[ \t]*Intrinsic of "([^"]+)"[^\n]*\n((?:\s+[A-Za-z]+[^:\n]*:[^\n]*\n?)+)', re.MULTILINE)
"""A section `Intrinsic of "Color" / 640x480 / {RGB8}` and its lines such as `Fx: 600.1`."""
_EXTRINSIC = re.compile(
    r'Extrinsic from "([^"]+)"\s+To\s+"([^"]+)"\s*:\s*Rotation Matrix:\s*'
    rf"((?:{_NUMBER}\s+){{9}})\s*Translation Vector:\s*({_NUMBER})\s+({_NUMBER})\s+({_NUMBER})"
)
"""A section `Extrinsic from "Gyro" To "Color" :` with nine numbers of a rotation and three of a translation."""
_OTHER = re.compile(r'^[ \t]*Motion Intrinsic of "([^"]+)"', re.MULTILINE)
"""A section of an IMU, which is not used."""
_SHORT = {"width": "w", "height": "h"}
"""Short names of fields, by the long ones."""
_SEPARATE = ("k1", "k2", "p1", "p2", "k3")
"""Coefficients of radtan, each under a key of its own."""
_LENS_KEYS = frozenset(
    ("width", "height", "w", "h", "ppx", "ppy", "cx", "cy", "fx", "fy")
    + ("model", "distortion", "coeffs", "coefficients")
    + _SEPARATE
)
"""Fields of a lens."""
_LENS_NAMES = {"cx": "ppx", "cy": "ppy"}
"""librealsense's name of a field, by another one."""
_CENTRES = ({"ppx", "ppy", "fx", "fy"}, {"cx", "cy", "fx", "fy"})
"""Fields that intrinsics have, with either name of the centre."""
_MODELS = {"brown_conrady", "modified_brown_conrady", "inverse_brown_conrady"}


@dataclass(frozen=True)
class _Intrinsic:
    """The lens of a stream at one resolution: name of the stream, its section of a camera, and where it is."""

    stream: str
    section: Section
    path: str


@dataclass
class _Device:
    """What a file says of a device: lenses, T_to_from by (from, to), and the rest."""

    lenses: list[_Intrinsic] = field(default_factory=list)
    transforms: dict[tuple[str, str], Array] = field(default_factory=dict)
    unused: list[str] = field(default_factory=list)


def is_realsense_text(text: str) -> bool:
    """Whether a text is the output of `rs-enumerate-devices -c`."""
    return re.search(r'^[ \t]*Intrinsic of "', text, re.MULTILINE) is not None


def convert_realsense_text(text: str, source: str, sizes: Collection[tuple[int, int]]) -> Converted:
    """The camera of the output of `rs-enumerate-devices -c`, in Kalibr's words.

    Args:
        text: The output.
        source: Names the file in errors.
        sizes: (width, height) of the images that it shall describe; empty if unknown.

    Raises:
        ConfigError: A number is missing, or several resolutions are there and none is in `sizes`.
    """
    device = _Device()
    for name, body in _INTRINSIC.findall(text):
        fields = {
            key.strip().lower(): value.strip() for key, _, value in (line.partition(":") for line in body.split("\n"))
        }
        device.lenses.append(_read_text_lens(name, fields, source))
    for start, end, rotation, *translation in _EXTRINSIC.findall(text):
        R = np.array(rotation.split(), float).reshape(3, 3)
        device.transforms[_normalise_name(start), _normalise_name(end)] = _to_transform(R, np.array(translation, float))
    device.unused = [f'Motion Intrinsic of "{name}"' for name in _OTHER.findall(text)]
    return _to_sections(device, source, sizes)


def is_realsense_json(document: Mapping[str, object]) -> bool:
    """Whether plain data have intrinsics with librealsense's fields `ppx`, `ppy`, `fx`, `fy`, or `cx`, `cy`."""
    return any(_find_mappings(document, "", keys) for keys in _CENTRES)


def convert_realsense_json(
    document: Mapping[str, object], source: str, sizes: Collection[tuple[int, int]]
) -> Converted:
    """The camera of JSON with the fields of librealsense, in Kalibr's words.

    Intrinsics are mappings with `width, height, ppx, ppy, fx, fy, model, coeffs` under the name of the stream;
    extrinsics are mappings with `rotation` and `translation` under a key such as `gyro_to_color`, or with `from` and
    `to`.

    Args:
        document: Plain data of the file.
        source: Names the file in errors.
        sizes: (width, height) of the images that it shall describe; empty if unknown.

    Raises:
        ConfigError: A value is missing or invalid, or several resolutions are there and none is in `sizes`.
    """
    device = _Device()
    taken: set[str] = set()
    for path, node in [item for keys in _CENTRES for item in _find_mappings(document, "", keys)]:
        fields = {_LENS_NAMES.get(key.lower(), key.lower()): value for key, value in node.items()}
        device.lenses.append(_read_json_lens(path, fields, source))
        taken |= {f"{path}.{key}".removeprefix(".") for key in node if key.lower() in _LENS_KEYS}
    for path, node in _find_mappings(document, "", {"rotation", "translation"}):
        start, end = _read_ends(path, node)
        if not start:
            continue
        R, p = (
            _read_rotation(path, node["rotation"], source),
            _read_numbers(f"{path}.translation", node["translation"], 3, source),
        )
        device.transforms[start, end] = _to_transform(R, p)
        taken |= {f"{path}.{key}".removeprefix(".") for key in ("rotation", "translation", "from", "to")}
    leaves = [leaf for leaf in _list_leaves(document, "") if leaf.lower() not in {path.lower() for path in taken}]
    device.unused = [leaf for leaf in leaves if not any(path.startswith(f"{leaf}[") for path in taken)]
    return _to_sections(device, source, sizes)


def _to_sections(device: _Device, source: str, sizes: Collection[tuple[int, int]]) -> Converted:
    """The section of the device's camera, with its pose in the frame of the IMU if transforms lead there."""
    result = Converted()
    lens = _choose_lens(device.lenses, source, sizes)
    section = dict(lens.section)
    result.unused = [*(other.path for other in device.lenses if other is not lens), *device.unused]
    for imu in _IMUS:
        T_cam_imu = _find_transform(device.transforms, imu, lens.stream)
        if T_cam_imu is not None:
            section["T_cam_imu"] = T_cam_imu.tolist()
            break
    result.add("cam0", section, {"intrinsics": lens.path, "T_cam_imu": "extrinsics to the IMU"})
    return result


def _choose_lens(lenses: list[_Intrinsic], source: str, sizes: Collection[tuple[int, int]]) -> _Intrinsic:
    """The lens of the camera: of the first stream of `_CHOICE`, at the resolution of the images.

    Raises:
        ConfigError: There is no lens, or the resolution is not determined.
    """
    by_stream: dict[str, list[_Intrinsic]] = {}
    for lens in lenses:
        by_stream.setdefault(lens.stream, []).append(lens)
    stream = next((name for name in _CHOICE if name in by_stream), next(iter(by_stream), ""))
    candidates = by_stream.get(stream, [])
    image_sizes = [list(size) for size in sizes]
    fitting = [lens for lens in candidates if lens.section["resolution"] in image_sizes] or candidates
    resolutions = {str(lens.section["resolution"]) for lens in fitting}
    if not fitting:
        raise ConfigError(
            source, "", "no intrinsics", "the intrinsics of a camera, as rs-enumerate-devices -c prints them"
        )
    if len(resolutions) > 1:
        text = ", ".join("{} x {}".format(*lens.section["resolution"]) for lens in fitting)  # type: ignore[misc]
        images = f", that of the images ({', '.join(f'{w} x {h}' for w, h in sizes)})" if sizes else ""
        raise ConfigError(source, f"intrinsics of {stream}", text, f"one resolution{images}; delete the others")
    return fitting[0]


def _read_text_lens(name: str, fields: Mapping[str, str], source: str) -> _Intrinsic:
    """The lens of one paragraph `Intrinsic of "..."`, whose lines are `fields` by their word in lower case."""
    path = f'Intrinsic of "{name}"'
    numbers: dict[str, float] = {}
    for key in ("width", "height", "ppx", "ppy", "fx", "fy"):
        text = fields.get(key, "")
        if not re.fullmatch(_NUMBER, text):
            raise ConfigError(source, f"{path}: {key}", text, "a number")
        numbers[key] = float(text)
    texts = fields.get("coeffs", "").split()
    if not all(re.fullmatch(_NUMBER, text) for text in texts):
        raise ConfigError(source, f"{path}: coeffs", fields.get("coeffs", ""), "numbers")
    model = fields.get("distortion", "none").lower()
    return _make_lens(
        _normalise_name(name),
        f"{path} / {fields['width']}x{fields['height']}",
        numbers,
        model,
        [float(text) for text in texts],
    )


def _read_json_lens(path: str, fields: Mapping[str, object], source: str) -> _Intrinsic:
    """The lens of a mapping with librealsense's fields, by their names in lower case."""
    place = path or "intrinsics"
    numbers = {
        key: float(_read_numbers(f"{place}.{key}", [fields.get(key, fields.get(_SHORT.get(key, "")))], 1, source)[0])
        for key in ("width", "height", "ppx", "ppy", "fx", "fy")
    }
    separate = [fields.get(key, 0.0) for key in _SEPARATE] if set(_SEPARATE[:4]) <= set(fields) else []
    coefficients = fields.get("coeffs", fields.get("coefficients", separate))
    values = _read_numbers(f"{path}.coeffs", coefficients, None, source).tolist()
    model = (
        str(fields.get("model", fields.get("distortion", "radtan" if separate else "none")))
        .lower()
        .removeprefix("distortion.")
    )
    stream = _normalise_name(
        next((word for word in reversed(path.split(".")) if _normalise_name(word) in _CHOICE), path or "color")
    )
    return _make_lens(stream, path, numbers, model, values)


def _make_lens(
    stream: str, path: str, numbers: Mapping[str, float], model: str, coefficients: list[float]
) -> _Intrinsic:
    """The lens of a stream as a section of a camera; coefficients that are all 0 are no distortion."""
    model = model.replace("_", " ") if model in _MODELS or model == "kannala_brandt4" else model
    if not any(coefficients):
        model, coefficients = "none", []
    elif model == "kannala brandt4":
        coefficients = coefficients[:4]
    section: Section = {
        "camera_model": "pinhole",
        "intrinsics": [numbers[key] for key in ("fx", "fy", "ppx", "ppy")],
        "distortion_model": model,
        "distortion_coeffs": coefficients,
        "resolution": [int(numbers["width"]), int(numbers["height"])],
    }
    return _Intrinsic(stream, section, path)


def _normalise_name(name: str) -> str:
    """The name of a stream without case and blanks: `infrared1` of `Infrared 1` and `infra1`."""
    word = re.sub(r"[^a-z0-9]", "", name.lower().replace("intrinsics", "").replace("intrinsic", ""))
    return _NAMES.get(word, word)


def _read_ends(path: str, node: Mapping[str, object]) -> tuple[str, str]:
    """The streams that an extrinsic leads from and to; "" twice if neither its key nor `from` and `to` say so."""
    if isinstance(node.get("from"), str) and isinstance(node.get("to"), str):
        return _normalise_name(str(node["from"])), _normalise_name(str(node["to"]))
    match = re.fullmatch(
        r"(?:T_|extrinsics?_)?(.+?)_?(?:to|2)_?([^_].*?)(?:_extrinsics?)?", path.split(".")[-1], re.IGNORECASE
    )
    return (_normalise_name(match[1]), _normalise_name(match[2])) if match else ("", "")


def _read_rotation(path: str, node: object, source: str) -> Array:
    """(3, 3) rotation: three rows, or nine numbers by columns, as librealsense has them."""
    if isinstance(node, list) and len(node) == 3 and all(isinstance(row, list) for row in node):
        return np.array([_read_numbers(f"{path}.rotation", row, 3, source) for row in node])
    return _read_numbers(f"{path}.rotation", node, 9, source).reshape(3, 3).T


def _read_numbers(path: str, node: object, count: int | None, source: str) -> Array:
    """(count,) numbers of a list.

    Raises:
        ConfigError: It is no list of so many finite numbers.
    """
    items = node if isinstance(node, list) else []
    are_numbers = all(isinstance(n, (int, float)) and not isinstance(n, bool) and abs(n) < 1e300 for n in items)
    if not isinstance(node, list) or not are_numbers or (count is not None and len(items) != count):
        shown = node[0] if isinstance(node, list) and len(node) == 1 else node
        raise ConfigError(source, path, shown, "a number" if count == 1 else f"{count or ''} numbers".strip())
    return np.array(items, float)


def _find_mappings(node: object, path: str, keys: set[str]) -> list[tuple[str, Mapping[str, object]]]:
    """The mappings in plain data that have all of `keys`, in any case, with their dotted paths."""
    if isinstance(node, list):
        return [item for i, child in enumerate(node) for item in _find_mappings(child, f"{path}[{i}]", keys)]
    if not isinstance(node, Mapping):
        return []
    if keys <= {str(key).lower() for key in node}:
        return [(path, {str(key) if str(key).lower() not in keys else str(key).lower(): v for key, v in node.items()})]
    return [
        item
        for key, child in node.items()
        for item in _find_mappings(child, f"{path}.{key}" if path else str(key), keys)
    ]


def _list_leaves(node: object, path: str) -> list[str]:
    """Dotted paths of the values in nested mappings."""
    if not isinstance(node, Mapping):
        return [path]
    return [leaf for key, child in node.items() for leaf in _list_leaves(child, f"{path}.{key}" if path else str(key))]


def _to_transform(R: Array, p: Array) -> Array:
    """(4, 4) of a rotation and a translation."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def _find_transform(transforms: Mapping[tuple[str, str], Array], start: str, end: str) -> Array | None:
    """T_end_start (4, 4) along the transforms, in either direction; None if none lead there."""
    T_from_start = {start: np.eye(4)}  # streams reached so far
    queue = [start]
    while queue and end not in T_from_start:
        here = queue.pop(0)
        for (a, b), T_b_a in transforms.items():
            steps = ((a, b, T_b_a), (b, a, np.linalg.inv(T_b_a) if abs(np.linalg.det(T_b_a)) > 1e-9 else None))
            for first, second, T in steps:
                if first == here and second not in T_from_start and T is not None:
                    T_from_start[second] = T @ T_from_start[here]
                    queue.append(second)
    known = any(start in pair for pair in transforms)
    return T_from_start.get(end) if known else None

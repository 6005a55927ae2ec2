"""A camera's matrix and distortion as OpenCV, ROS and MATLAB write them, as a section of a Kalibr file.

Read are ROS's `camera_info` files and printed `CameraInfo` messages, OpenCV's calibrations (`camera_matrix`, or `K`,
`mtx`), MATLAB's `cameraParameters` or `cameraIntrinsics` as JSON, and Open3D's intrinsics. MATLAB counts pixels from 1,
and it and Open3D store the matrix by columns.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from stridetwin.streams.calibration_keys import Keys, has_no_effect
from stridetwin.streams.errors import FieldLocation
from stridetwin.streams.foreign_calibration import Converted, make_lens, to_whole
from stridetwin.streams.lenses import Intrinsics, bin_and_crop

_MATRICES = ("cameramatrix", "intrinsicmatrix", "k", "mtx", "cammtx")
"""Names of the matrix, in lower case without other signs, the most telling first."""
_COEFFICIENTS = ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distcoeff", "distortion", "dist", "d")
"""Names of the distortion coefficients, likewise."""
_MODELS = ("distortionmodel", "model", "type")
"""Names of the distortion model, likewise."""
_WIDTHS, _HEIGHTS = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
"""Names of the size of images, likewise, in two keys."""
_SIZES = ("imagesize", "resolution", "size")
"""Names of the size of images, likewise, in one key."""
_REGION = ("x_offset", "y_offset", "width", "height")
"""Keys of a region of interest: its first column and row, and its size, px."""
_FOCALS, _CENTRES, _RADIAL, _TANGENTIAL = "focallength", "principalpoint", "radialdistortion", "tangentialdistortion"
"""Names of MATLAB's properties."""
_REDUNDANT = ("intrinsicmatrix", "k")
"""What MATLAB writes beside the values from which it follows."""


def is_camera_matrix(document: dict[str, object]) -> bool:
    """Whether plain data are a camera's matrix with its distortion, or MATLAB's properties of a camera."""
    names = {_simplify(key) for key in document}
    return {_FOCALS, _CENTRES} <= names or any(
        _simplify(key) in _MATRICES and _count_numbers(value) == 9 for key, value in document.items()
    )


def convert_camera_matrix(document: dict[str, object], source: str, sizes: Collection[tuple[int, int]]) -> Converted:
    """The camera of plain data as Kalibr's section `cam0`, without the size of images where the file has none.

    Args:
        document: Plain data of the file.
        source: Names the file in errors.
        sizes: (width, height) of the images that it shall describe; empty if unknown.

    Raises:
        ConfigError: A value is missing or invalid.
    """
    keys = Keys(document, FieldLocation(source=source))
    names = {_simplify(key): key for key in keys}
    result = Converted()
    if {_FOCALS, _CENTRES} <= set(names):
        _convert_matlab(keys, names, result)
    else:
        _convert_matrix(keys, names, result, sizes)
    keys.drop("camera_name", "header")
    result.unused += [path for path in keys.list_unused() if not has_no_effect(document.get(path))]
    return result


def _convert_matrix(keys: Keys, names: dict[str, str], result: Converted, sizes: Collection[tuple[int, int]]) -> None:
    """Adds the camera of a matrix with its coefficients, for the part of the sensor that a CameraInfo says.

    Raises:
        ConfigError: The matrix has not nine numbers, or a value is missing or invalid.
    """
    key = next(names[name] for name in _MATRICES if name in names)
    K = keys.take_list(key)
    if len(K) != 9:
        raise keys.place.key(key).error(K, "9 numbers")
    if K[2] == K[5] == 0.0 and K[6] > 0.0:  # by columns
        K = [K[i] for i in (0, 3, 6, 1, 4, 7, 2, 5, 8)]
    if K[1]:
        result.notes.append(f"{key}: the skew of {K[1]:g} is not used")
    coefficients = _take_first(keys, names, _COEFFICIENTS)
    model_key = next((names[name] for name in _MODELS if name in names), "distortion_model")
    model = keys.take_text(model_key, "radtan" if coefficients else "none")
    intrinsics, size = (K[0], K[4], K[2], K[5]), _take_size(keys, names)
    if len(size) == 2 and "binningx" in names and (int(size[0]), int(size[1])) not in sizes:
        whole = (int(size[0]), int(size[1]))
        intrinsics, (width, height) = _crop_to_images(keys, names, intrinsics, whole)
        if (width, height) != whole:
            result.notes.append(f"binning and region of interest are used: images of {width} x {height}")
        size = [float(width), float(height)]
    else:
        keys.drop(*(names[name] for name in ("roi", "binningx", "binningy") if name in names))
    lens = make_lens("pinhole", list(intrinsics), model, coefficients)
    if size:
        lens["resolution"] = [to_whole(value) for value in size]
    places = {"intrinsics": key, "distortion_model": model_key, "resolution": "image_width, image_height"}
    result.add("cam0", lens, places)


def _crop_to_images(
    keys: Keys, names: dict[str, str], intrinsics: Intrinsics, whole: tuple[int, int]
) -> tuple[Intrinsics, tuple[int, int]]:
    """Intrinsics and size, px, of the images that a CameraInfo with binning and a region of interest describes.

    Args:
        keys: The CameraInfo.
        names: Its keys, by these in lower case without other signs.
        intrinsics: (fu, fv, pu, pv) of the whole sensor, px.
        whole: (width, height) of the whole sensor, px.

    Raises:
        ConfigError: A value is no number.
    """
    roi = keys.take_keys(names["roi"]) if "roi" in names else Keys({}, keys.place)
    column, row, width, height = (int(roi.take_number(name, 0.0)) for name in _REGION)
    binning = [int(keys.take_number(names.get(name, name), 0.0)) for name in ("binningx", "binningy")]
    roi.drop("do_rectify")
    return bin_and_crop(intrinsics, whole, (column, row), (width, height), binning)


def _convert_matlab(keys: Keys, names: dict[str, str], result: Converted) -> None:
    """Adds the camera of MATLAB's properties.

    Raises:
        ConfigError: Focal lengths or centre are not two numbers.
    """
    focal, centre = keys.take_list(names[_FOCALS]), keys.take_list(names[_CENTRES])
    if len(focal) != 2 or len(centre) != 2:
        raise keys.place.key(names[_FOCALS]).error(focal, "two focal lengths and two coordinates of the centre")
    radial = keys.take_list(names[_RADIAL]) if _RADIAL in names else []
    tangential = keys.take_list(names[_TANGENTIAL]) if _TANGENTIAL in names else []
    coefficients = [*radial[:2], *(tangential or [0.0, 0.0]), *radial[2:]] if radial else []
    lens = make_lens(
        "pinhole", [*focal, centre[0] - 1.0, centre[1] - 1.0], "radtan" if coefficients else "none", coefficients
    )
    rows_and_columns = keys.take_list(names["imagesize"]) if "imagesize" in names else []
    if len(rows_and_columns) == 2:
        lens["resolution"] = [to_whole(value) for value in reversed(rows_and_columns)]
    keys.drop(*(names[name] for name in _REDUNDANT if name in names))
    result.notes.append("MATLAB's centre, which counts pixels from 1, is 1 px less here")
    result.add("cam0", lens, {"intrinsics": names[_FOCALS], "resolution": names.get("imagesize", "ImageSize")})


def _take_size(keys: Keys, names: dict[str, str]) -> list[float]:
    """Width and height; empty if the file has none."""
    width, height = (next((names[n] for n in options if n in names), "") for options in (_WIDTHS, _HEIGHTS))
    if width and height:
        return keys.take_numbers((width, height))
    return _take_first(keys, names, _SIZES)


def _take_first(keys: Keys, names: dict[str, str], options: tuple[str, ...]) -> list[float]:
    """The numbers of the first of some keys that is there; empty without any."""
    key = next((names[name] for name in options if name in names), "")
    return keys.take_list(key) if key else []


def _simplify(key: str) -> str:
    """A key in lower case without other signs: `cameramatrix` of `Camera_Matrix`."""
    return re.sub(r"[^a-z0-9]", "", key.lower())


def _count_numbers(node: object) -> int:
    """How many numbers a matrix has: rows, a flat list, or OpenCV's `data`; -1 if it has others than numbers."""
    if isinstance(node, dict):
        return _count_numbers(node.get("data"))
    if not isinstance(node, list):
        return 1 if isinstance(node, (int, float)) and not isinstance(node, bool) else -1
    counts = [_count_numbers(item) for item in node]
    return -1 if -1 in counts else sum(counts)

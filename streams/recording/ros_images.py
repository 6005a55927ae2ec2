"""Images and camera calibrations as ROS 2 messages."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.store import Typestore

from stridetwin.streams.bounded_images import check_pixels, decode_image
from stridetwin.streams.recording.ros_samples import frame_id
from stridetwin.streams.recording.ros_types import RosMessage, deserialise, serialise
from stridetwin.streams.rig import CameraCalibration, Rig
from stridetwin.streams.samples import Depth, Image

# message types
COMPRESSED = "sensor_msgs/msg/CompressedImage"
RAW = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGES = (COMPRESSED, RAW)
"""Message types of images."""
_FIELDS = {COMPRESSED: ("format", "data"), RAW: ("encoding", "width", "height", "is_bigendian", "step", "data")}
"""Fields of an image that are read, by the type of its message."""
DEPTH_ENCODINGS = ("16UC1", "32FC1")
"""ROS's names of depth in mm of 16 bits, and of depth in m as float32."""
_PNG_HEAD = 26
"""Bytes of a PNG up to its bits per number and its kind of colour, 0 for grey."""
_INFO_PERIOD_NS = 1_000_000_000
"""Time after which a camera's intrinsics are written again."""
# NumPy type of a number and numbers per pixel, by ROS's name of an encoding
_PIXELS = {
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "8UC4": ("u1", 4),
    "yuv422": ("u1", 2),
    "uyvy": ("u1", 2),
    "yuv422_yuy2": ("u1", 2),
    "yuyv": ("u1", 2),
    "bayer_rggb8": ("u1", 1),
    "bayer_bggr8": ("u1", 1),
    "bayer_gbrg8": ("u1", 1),
    "bayer_grbg8": ("u1", 1),
    "16UC1": ("u2", 1),
    "mono16": ("u2", 1),
    "32FC1": ("f4", 1),
}


_TO_RGB = {
    "bgr8": cv2.COLOR_BGR2RGB,
    "8UC3": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
    "8UC4": cv2.COLOR_BGRA2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY,
    "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2,
    "yuyv": cv2.COLOR_YUV2RGB_YUY2,
    "bayer_rggb8": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2RGB,
}
"""OpenCV's conversion to RGB by ROS's name of an encoding, for those that need one."""


def _header(topic: str, t_ns: int) -> dict[str, object]:
    """The fields of a message's header: stamp, and the topic as frame."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return {"header.stamp.sec": sec, "header.stamp.nanosec": nanosec, "header.frame_id": frame_id(topic)}


def encode_pixels(pixels: NDArray[np.uint8], quality: int | None) -> NDArray[np.uint8]:
    """The bytes of an image file: a JPEG of the given quality (0 to 100), or for None a lossless PNG.

    Args:
        pixels: (H, W) grey or (H, W, 3) RGB.
        quality: Quality of the JPEG; None for a PNG.

    Returns:
        (B,) the file's bytes.
    """
    # OpenCV takes colours as BGR
    pixels = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), np.uint8)
    if quality is None:
        _, data = cv2.imencode(".png", pixels)
    else:
        _, data = cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, quality))
    return np.asarray(data, np.uint8).ravel()


def encode_image(sample: Image, quality: int | None, data: NDArray[np.uint8] | None = None) -> bytes:
    """The CDR bytes of a CompressedImage.

    Args:
        sample: The image.
        quality: 0 to 100 for JPEG; None for a lossless PNG.
        data: The encoded pixels (`encode_pixels`), if they are known already.
    """
    data = encode_pixels(sample.pixels, quality) if data is None else data
    form = "png" if quality is None else "jpeg"
    return serialise(COMPRESSED, _header(sample.topic, sample.t_ns) | {"format": form, "data": data})


def encode_depth(sample: Depth, encoding: str) -> bytes:
    """The CDR bytes of an Image with depth.

    Args:
        sample: Depth in m; 0 is none.
        encoding: `16UC1` (mm as in the RealSense driver; 65.535 m and more become 0) or `32FC1` (m).
    """
    if encoding == "16UC1":
        # rounds to 16 bits in one step, where more becomes 65535; NaN gives 0
        mm = np.asarray(cv2.multiply(sample.depth, 1000.0, dtype=cv2.CV_16U))  # type: ignore[call-overload]
        _, in_range = cv2.threshold(mm, 65534, 0, cv2.THRESH_TOZERO_INV)  # above 65534: 0
        pixels: NDArray[np.generic] = np.asarray(in_range, "<u2")
    else:
        pixels = np.ascontiguousarray(sample.depth, "<f4")
    return _encode_raw_message(sample, pixels, encoding)


def encode_raw_image(sample: Image) -> bytes:
    """The CDR bytes of an Image with every pixel of a colour or grey image as it is."""
    return _encode_raw_message(
        sample, np.ascontiguousarray(sample.pixels), "mono8" if sample.pixels.ndim == 2 else "rgb8"
    )


def _encode_raw_message(sample: Image | Depth, pixels: NDArray[np.generic], encoding: str) -> bytes:
    """The CDR bytes of an Image message.

    Args:
        sample: The image, for topic and stamp.
        pixels: (H, W) or (H, W, 3), contiguous, in the type that the encoding means.
        encoding: ROS's name of the type and the order of the numbers, such as `rgb8`.
    """
    height, width = pixels.shape[:2]
    values = {
        "height": height,
        "width": width,
        "encoding": encoding,
        "step": pixels.nbytes // height,  # bytes of a row
        "data": pixels.reshape(-1).view(np.uint8),
    }
    return serialise(RAW, _header(sample.topic, sample.t_ns) | values)


def encode_camera_info(camera: CameraCalibration, topic: str, t_ns: int) -> bytes:
    """The CDR bytes of a CameraInfo with a camera's intrinsics, under ROS's names, for the image topic `topic`.

    Its matrices are listed row by row: k (3, 3) of the camera, r (3, 3) of the rectification, which is none, and p
    (3, 4) of the projection. Our `radtan` is ROS's `plumb_bob`, whose fifth coefficient k3 is then 0.
    """
    fu, fv, pu, pv = camera.intrinsics
    is_radtan = camera.distortion_model == "radtan"
    values = {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob" if is_radtan else camera.distortion_model,
        "d": np.array([*camera.distortion, 0.0] if is_radtan else camera.distortion),
        "k": camera.K.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.array([fu, 0, pu, 0, 0, fv, pv, 0, 0, 0, 1.0, 0]),
    }
    return serialise(CAMERA_INFO, _header(topic, t_ns) | values)


class CameraInfos:
    """Decides when a camera's intrinsics are written beside its images: with the first one, then once a second.

    Args:
        rig: Calibration of the cameras; may be replaced later.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._next_ns: dict[str, int] = {}  # stamp from which on the intrinsics are due again, by topic

    def find_due_camera(self, topic: str, t_ns: int) -> CameraCalibration | None:
        """The camera of a topic of images or depth, if its intrinsics are due with the image at `t_ns`; else None.

        If they are, they count as written, and are due again a second later.
        """
        by_depth_topic = {camera.depth_topic: camera for camera in self.rig.cameras.values() if camera.depth_topic}
        camera = by_depth_topic.get(topic, self.rig.cameras.get(topic))
        if camera is None or t_ns < self._next_ns.get(topic, 0):
            return None
        self._next_ns[topic] = t_ns + _INFO_PERIOD_NS
        return camera


def detect_image_kind(payload: bytes, typename: str, store: Typestore) -> type[Image] | type[Depth]:
    """Whether a topic carries colour (or grey) images or depth, from the encoding in its first message.

    Args:
        payload: CDR bytes of the first message.
        typename: `COMPRESSED` or `RAW`.
        store: Definitions of the types.

    Raises:
        ValueError: The bytes are not a message of this type.
    """
    message = _deserialise_image(store, payload, typename)
    if typename == COMPRESSED:
        return Depth if "compressedDepth" in message.format or _is_16_bit(message) else Image
    # 16 bits of grey (mono16) are taken as depth in mm
    return Depth if message.encoding in (*DEPTH_ENCODINGS, "mono16") else Image


def read_image_message(payload: bytes, typename: str, store: Typestore, topic: str, t_ns: int) -> Image | Depth:
    """Decodes a CompressedImage or Image message.

    Args:
        payload: CDR bytes.
        typename: `COMPRESSED` or `RAW`.
        store: Definitions of the types.
        topic: Topic of the sample.
        t_ns: Stamp of the sample.

    Returns:
        Colour (RGB) or grey pixels of 8 bits, or depth in m with 0 for none.

    Raises:
        ValueError: The encoding is not supported, or the data is damaged.
    """
    message = _deserialise_image(store, payload, typename)
    if typename == COMPRESSED and "compressedDepth" in message.format:
        return Depth(topic=topic, t_ns=t_ns, depth=_decode_compressed_depth(message))
    if typename == COMPRESSED:
        pixels = decode_image(bytes(message.data))
        if pixels is not None and pixels.dtype == np.uint16 and pixels.ndim == 2:
            return Depth(topic=topic, t_ns=t_ns, depth=_mm_to_metres(pixels))
        if pixels is None or pixels.dtype != np.uint8:
            raise ValueError(f"an image of format {message.format!r} that cannot be decoded to 8 bits")
        pixels_8bit = pixels.view(np.uint8)
        return Image(topic=topic, t_ns=t_ns, pixels=pixels_8bit if pixels.ndim == 2 else rgb_from_bgr(pixels_8bit))
    if message.encoding not in _PIXELS:
        raise ValueError(f"encoding {message.encoding!r} is not read: expected {', '.join(_PIXELS)}")
    check_pixels(message.width, message.height)
    code, channels = _PIXELS[message.encoding]
    dtype = np.dtype(code).newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * dtype.itemsize  # without the padding at the end of a row
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.step)[:, :row_bytes]
    raw = np.ascontiguousarray(rows).view(dtype)  # (H, W × channels)
    if dtype.kind == "f":  # depth in m, where NaN and infinity mean none
        return Depth(topic=topic, t_ns=t_ns, depth=np.where(np.isfinite(raw), raw, 0).astype(np.float32))
    if dtype.itemsize == 2:  # depth in mm
        return Depth(topic=topic, t_ns=t_ns, depth=_mm_to_metres(raw))
    pixels = raw if channels == 1 else raw.reshape(message.height, message.width, channels)
    if message.encoding in _TO_RGB:
        pixels = np.asarray(cv2.cvtColor(np.asarray(pixels, np.uint8), _TO_RGB[message.encoding]))
    return Image(topic=topic, t_ns=t_ns, pixels=np.asarray(pixels, np.uint8))


def _deserialise_image(store: Typestore, payload: bytes, typename: str) -> RosMessage:
    """The message of an image.

    Raises:
        ValueError: The definition of its type, which a file brings along, lacks a field of an image.
    """
    message = deserialise(store, payload, typename)
    lacking = [name for name in _FIELDS[typename] if not hasattr(message, name)]
    if lacking:
        raise ValueError(f"an image without {', '.join(lacking)}")
    return message


def _is_16_bit(message: RosMessage) -> bool:
    """Whether a CompressedImage is a PNG of 16 bits of grey, as which depth is sent without a transport of its own."""
    data = bytes(message.data[:_PNG_HEAD])
    return data.startswith(b"\x89PNG") and data[_PNG_HEAD - 2 :] == b"\x10\x00"


def _mm_to_metres(mm: NDArray[np.generic]) -> NDArray[np.float32]:
    """Depth in m from mm; 65535 means none, as 0 does."""
    return np.where(mm == 65535, 0, mm).astype(np.float32) / np.float32(1000.0)


def _decode_compressed_depth(message: RosMessage) -> NDArray[np.float32]:
    """Decodes depth (H, W), m, 0 for none, from the format of ROS' compressed_depth_image_transport.

    Its data are 12 bytes of parameters and a PNG of 16 bits. The parameters are a number of 4 bytes, which is not used,
    and a and b as float32. For `16UC1` the PNG contains mm; for `32FC1` it contains an inverse depth, a / z + b.

    Raises:
        ValueError: The PNG is damaged, or has other than 16 bits or one channel.
    """
    data = np.asarray(message.data, np.uint8)
    raw = decode_image(bytes(data[12:])) if len(data) > 12 else None
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2:
        raise ValueError(f"an image of format {message.format!r} that cannot be decoded to 16 bits")
    if not message.format.startswith("32FC1"):
        return _mm_to_metres(raw)
    a, b = data[4:12].view("<f4")
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = np.float32(a) / (raw.astype(np.float32) - np.float32(b))
    is_none = (raw == 0) | ~np.isfinite(depth) | (depth < 0)
    return np.where(is_none, 0, depth).astype(np.float32)


def rgb_from_bgr(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W, 3) RGB of a colour image (H, W, 3) BGR or (H, W, 4) BGRA, as OpenCV reads them."""
    code = cv2.COLOR_BGRA2RGB if bgr.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(bgr, code))

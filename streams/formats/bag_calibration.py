"""Calibrations in a bag: intrinsics in CameraInfo, mounts in /tf_static.

Distortion models with more than four terms are approximated by `radtan` within the image.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from itertools import takewhile
from pathlib import PurePosixPath

import numpy as np

from stridetwin.streams.formats.assumed_calibration import BODY, GIVE, read_first_image_size
from stridetwin.streams.formats.frame_intrinsics import choose_frame
from stridetwin.streams.formats.transform_tree import TransformTree
from stridetwin.streams.lenses import MOST_TERMS, Intrinsics, bin_and_crop, fit_radtan
from stridetwin.streams.plausible import mean_rate
from stridetwin.streams.recording.imported import ImageStream
from stridetwin.streams.recording.index import Notes
from stridetwin.streams.recording.ros_types import RosMessage
from stridetwin.streams.rig import CameraCalibration, Mount, Rig
from stridetwin.streams.samples import Array, Block, Imu, Sample

CALIBRATIONS = frozenset(["sensor_msgs/msg/CameraInfo"])
TRANSFORMS = frozenset(["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"])
# our name of a distortion model, by its name in a CameraInfo in lower case
_MODELS = {"plumb_bob": "radtan", "rational_polynomial": "radtan", "": "radtan", "equidistant": "equidistant"}
_MODELS |= {"fisheye": "equidistant", "radtan": "radtan", "none": "radtan"}
# names in RealSense's own .bag files; the ROS driver publishes all but the last as plumb_bob
_MODELS |= {f"{kind}brown conrady": "radtan" for kind in ("", "modified ", "inverse ")}
_MODELS |= {"kannala brandt4": "equidistant"}
_RECTIFIED = re.compile(r"(?<![a-z])rect(?:ified)?(?![a-z])")  # of image_rect, image_rect_color, rectified/image
_BEYOND = 1e-6  # coefficients after the fourth below this count as 0


class BagCalibration:
    """Collects the calibrations in a bag's messages, and builds a rig of its cameras from them.

    Attributes:
        assumed: What is assumed in a camera's calibration, as text by topic.
    """

    def __init__(self, notes: Notes) -> None:
        """Begins without calibrations; `notes` collects what cannot be used."""
        self._notes = notes
        self.assumed: dict[str, str] = {}
        self._infos: dict[str, RosMessage] = {}  # CameraInfo, by the common beginning of the camera's topics
        self._frames = TransformTree()

    def add_camera_info(self, topic: str, *messages: RosMessage) -> None:
        """Adds a camera's intrinsics; those of an uncalibrated camera (focal length 0) are reported and not used.

        Args:
            topic: Topic of the messages, such as `/camera/camera_info`.
            messages: CameraInfo of ROS 1 or ROS 2, at least one. Of several that differ, one is used, and reported.
        """
        intrinsics = [_read_intrinsics(message) for message in messages]
        # those of a calibrated camera
        sound = [
            (message, values)
            for message, values in zip(messages, intrinsics)
            if np.isfinite(values).all() and min(values[0], values[1], message.width, message.height) > 0
        ]
        if not sound:
            self._notes.warn(f"{topic}: not calibrated (a focal length of {intrinsics[0][0]:g} px)")
            return
        if len(sizes := {(message.width, message.height) for message, _ in sound}) > 1:
            text = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
            self._notes.warn(f"{topic}: calibrations of images of several sizes, {text}; the first one is used")
            sound = sound[:1]
        chosen = choose_frame(topic, np.array([values for _, values in sound]), self._notes)
        # RealSense's own files: .../Color_0/info/camera_info next to .../Color_0/image/data
        self._infos[topic.removesuffix("/camera_info").removesuffix("/info")] = sound[chosen][0]

    def add_transforms(self, message: RosMessage) -> None:
        """Adds the static transforms T_parent_child of a TFMessage; those without a unit quaternion are ignored."""
        for stamped in message.transforms:
            r, p = stamped.transform.rotation, stamped.transform.translation
            q = np.array([r.w, r.x, r.y, r.z])
            if 0.9 < float(np.linalg.norm(q)) < 1.1:  # else it is no rotation
                T = np.eye(4)
                from scipy.spatial.transform import Rotation  # takes long to import

                T[:3, :3] = Rotation.from_quat(q, scalar_first=True).as_matrix()
                T[:3, 3] = p.x, p.y, p.z
                self._frames.add(stamped.header.frame_id, stamped.child_frame_id, T)

    def build_rig(
        self, blocks: Mapping[str, Block[Sample]], images: Mapping[str, ImageStream], frames: Mapping[str, str]
    ) -> Rig:
        """Builds a rig of the cameras that have a CameraInfo.

        Args:
            blocks: Small streams by topic. The frame of the IMU whose topic has most in common with a camera's is taken
                as the frame of the body.
            images: Image streams by topic.
            frames: Frame that each topic's messages name.

        Returns:
            The cameras by topic. Without a chain of transforms to the IMU, a camera is assumed at the IMU with its
            orientation, which `assumed` says.
        """
        imus = [topic for topic, block in blocks.items() if block.kind is Imu]
        cameras: dict[str, CameraCalibration] = {}
        for topic, stream in images.items():
            info = self._find_info(topic)
            if info is None:
                continue
            # the IMU whose topic has the longest beginning in common with the camera's
            imu = max(imus, key=partial(_count_common_parts, topic), default="")
            T_imu_camera = self._frames.find_transform(frames.get(imu, ""), frames.get(topic, "")) if imu else None
            if imu and T_imu_camera is None:
                self._add_assumption(topic, "no mount in /tf_static; assumed at the IMU with the same orientation")
            pose = np.eye(4) if T_imu_camera is None else T_imu_camera
            cameras[topic] = self._to_camera(topic, stream, info, pose, imu)
        return Rig(cameras=cameras)

    def _find_info(self, topic: str) -> RosMessage | None:
        """The CameraInfo whose topic is the longest beginning of an image's topic; None without one."""
        near = [base for base in self._infos if topic == base or topic.startswith(base + "/")]
        return self._infos[max(near, key=len)] if near else None

    def _add_assumption(self, topic: str, text: str) -> None:
        """Adds a text to what is assumed of a camera."""
        self.assumed[topic] = f"{self.assumed[topic]}; {text}" if topic in self.assumed else text

    def _to_camera(self, topic: str, stream: ImageStream, info: RosMessage, T: Array, imu: str) -> CameraCalibration:
        """A camera from its CameraInfo.

        Args:
            topic: Topic of the images; a name such as `image_rect` says that they are rectified.
            stream: The images, whose stamps give the rate.
            info: The CameraInfo.
            T: (4, 4) pose of the optical frame in the IMU's frame, m.
            imu: Topic of that IMU; "" without one.
        """
        intrinsics, size = self._fit_to_images(topic, stream, info, _read_intrinsics(info))
        d = _read_field(info, "d")
        model = _MODELS.get(info.distortion_model.lower())
        if _RECTIFIED.search(topic.lower()):
            rectified = self._read_rectified_intrinsics(topic, info, _read_intrinsics(info))
            intrinsics, _ = self._fit_to_images(topic, stream, info, rectified)
            model, four = "radtan", np.zeros(4)
        else:
            model, four = self._find_distortion(topic, info.distortion_model, model, d, intrinsics, size)
        return CameraCalibration(
            topic=topic,
            part="",
            rate_hz=mean_rate(stream.t_ns),
            mount=Mount(body=BODY, T_body_sensor=T),
            width=size[0],
            height=size[1],
            intrinsics=intrinsics,
            distortion_model=model,
            distortion=tuple(float(v) for v in four),  # type: ignore[arg-type]
            imu_topic=imu,
        )

    def _fit_to_images(
        self, topic: str, stream: ImageStream, info: RosMessage, intrinsics: Intrinsics
    ) -> tuple[Intrinsics, tuple[int, int]]:
        """Intrinsics and size of the images where these are a part of the sensor, or have joined pixels.

        A CameraInfo has those of the whole sensor beside its binning and region of interest. Images of that whole size,
        or of neither size, leave them as they are.

        Args:
            topic: Topic of the images.
            stream: The images.
            info: The CameraInfo.
            intrinsics: (fu, fv, pu, pv) in pixels of the whole sensor.
        """
        whole = int(info.width), int(info.height)
        roi = getattr(info, "roi", None)
        if roi is None:  # a definition without these fields
            return intrinsics, whole
        offset, part = (int(roi.x_offset), int(roi.y_offset)), (int(roi.width), int(roi.height))
        binning = int(info.binning_x), int(info.binning_y)
        fitted, size = bin_and_crop(intrinsics, whole, offset, part, binning)
        if size == whole or read_first_image_size(stream) != size:
            return intrinsics, whole
        width, height = size
        self._notes.warn(
            f"{topic}: images of {width} x {height} by the binning and region of interest of its CameraInfo"
        )
        return fitted, size

    def _read_rectified_intrinsics(self, topic: str, info: RosMessage, raw: Intrinsics) -> Intrinsics:
        """Intrinsics (fu, fv, pu, pv) in pixels of rectified images: those of the matrix P, or `raw` without one."""
        P = _read_field(info, "p")  # (12,) the matrix (3, 4) row by row
        if len(P) == 12 and np.isfinite(P).all() and P[0] > 0 and P[5] > 0:
            return float(P[0]), float(P[5]), float(P[2]), float(P[6])
        self._add_assumption(
            topic, f"its CameraInfo has no P for rectified images; K is used without distortion; {GIVE}"
        )
        return raw

    def _find_distortion(
        self,
        topic: str,
        model_name: str,
        model: str | None,
        d: Array,
        intrinsics: Intrinsics,
        size: tuple[int, int],
    ) -> tuple[str, Array]:
        """The distortion model of ours for the one that a CameraInfo names.

        Args:
            topic: Topic that assumptions are reported for.
            model_name: The CameraInfo's name of the model.
            model: Our name of it; None for an unknown one.
            d: Coefficients, any number of them.
            intrinsics: (fu, fv, pu, pv) in pixels.
            size: (width, height) in pixels.

        Returns:
            Name of our model and its (4,) coefficients. A rational model is fitted by `fit_radtan`; of an unsupported
            one the first four are used. Both are reported as assumptions.
        """
        sound = np.nan_to_num(d, posinf=0.0, neginf=0.0)  # numbers that are not finite as 0
        four = np.zeros(4)  # the first four coefficients
        four[: len(d[:4])] = sound[:4]
        what = f"distortion {model_name!r} with {len(d)} coefficients"
        has_more_terms = bool(np.any(np.abs(sound[4:]) > _BEYOND))
        if model == "radtan" and has_more_terms and np.isfinite(d).all() and not np.any(sound[MOST_TERMS:]):
            fitted, worst = fit_radtan(intrinsics, sound[:MOST_TERMS], size)
            if np.isfinite(worst):
                self._add_assumption(topic, f"{what} is fitted by radtan, up to {worst:.2g} px off; {GIVE}")
                return model, fitted
        if (model is None and np.any(d)) or has_more_terms or not np.isfinite(d).all():
            self._add_assumption(
                topic, f"{what} is not supported; its first four are used as {model or 'radtan'}; {GIVE}"
            )
        return model or "radtan", four


def _read_intrinsics(info: RosMessage) -> Intrinsics:
    """The intrinsics in the camera matrix of a CameraInfo, (9,) row by row."""
    K = _read_field(info, "k")
    return float(K[0]), float(K[4]), float(K[2]), float(K[5])


def _read_field(info: RosMessage, name: str) -> Array:
    """A field of a CameraInfo as an array, named by the capital letter in ROS 1; empty if it is missing."""
    return np.asarray(getattr(info, name) if hasattr(info, name) else getattr(info, name.upper(), ()), float)


def _count_common_parts(first: str, second: str) -> int:
    """How many parts two topics have in common from their beginning on; a slash before the first part counts as one."""
    pairs = zip(PurePosixPath(first).parts, PurePosixPath(second).parts)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

"""Leaf files: left parts of the wearer as MJCF, mirrored to the right and attached to a model."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from stridetwin.assets import mjcf


def read_leaf(name: str) -> mujoco.MjSpec:
    """Model of a leaf file of the package's assets, by its name."""
    return mujoco.MjSpec.from_string(mjcf(name))


def attach(
    parent: mujoco.MjsBody,
    part: mujoco.MjSpec,
    body: str,
    pos: ArrayLike = (0.0, 0.0, 0.0),
    side: str = "",
    prefix: str = "",
) -> None:
    """Attaches a body of a leaf to a body of a model, `pos` m from its origin.

    Args:
        parent: Body of the model.
        part: The leaf, which is used up.
        body: Its body.
        pos: (3,) m.
        side: `l`, or `r` for its mirror image, is appended to all names; none for a part in the middle.
        prefix: Begins all names.
    """
    if side == "r":
        _mirror(part)
    frame = parent.add_frame(pos=np.asarray(pos, dtype=float))
    with silence_prefix_warnings():
        frame.attach_body(part.body(body), prefix, f"_{side}" if side else "")


@contextmanager
def silence_prefix_warnings() -> Iterator[None]:
    """Silences MuJoCo's warnings about an empty prefix within a `with` block.

    Names are unique without a prefix, by the suffix of their side.
    """
    warn = mujoco.get_mju_user_warning()  # the handler until now
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
            yield
    finally:
        mujoco.set_mju_user_warning(warn)


def _mirror(spec: mujoco.MjSpec) -> None:
    """Reflects a left leaf on the sagittal plane (y → −y), in place.

    Positions are polar vectors; axes of rotation and vector parts of quaternions are axial, so that their x and z
    change sign.
    """
    for frame in spec.frames:  # of parts that are attached to this one
        frame.pos = np.asarray(frame.pos) * [1, -1, 1]
        frame.quat = np.asarray(frame.quat) * [1, -1, 1, -1]
    for body in spec.bodies[1:]:
        body.pos = np.asarray(body.pos) * [1, -1, 1]
        body.quat = np.asarray(body.quat) * [1, -1, 1, -1]
        body.ipos = np.asarray(body.ipos) * [1, -1, 1]
        for geom in body.geoms:
            geom.pos = np.asarray(geom.pos) * [1, -1, 1]
            geom.quat = np.asarray(geom.quat) * [1, -1, 1, -1]
            # two points, from and to; NaN where a pose is given
            geom.fromto = np.asarray(geom.fromto) * [1, -1, 1, 1, -1, 1]
        for joint in body.joints:
            joint.pos = np.asarray(joint.pos) * [1, -1, 1]
            joint.axis = np.asarray(joint.axis) * [-1, 1, -1]

"""MJCF text of a model whose numbers are exact.

`MjSpec.to_xml` writes six digits; here each number of a pose, size, inertia, joint or mesh gets as many as it takes to
read the same one back. It also repeats the defaults of attached models under one name, which MuJoCo refuses to read,
and keeps the frames that attached them: both go, as every element has its own values.
"""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from stridetwin.sim.wearer.leaves import silence_prefix_warnings

_OF_MODEL = {
    "body": {"pos": "body_pos", "quat": "body_quat"},
    "inertial": {"pos": "body_ipos", "quat": "body_iquat", "mass": "body_mass", "diaginertia": "body_inertia"},
    "geom": {"pos": "geom_pos", "quat": "geom_quat", "size": "geom_size"},
    "joint": {"pos": "jnt_pos", "axis": "jnt_axis", "range": "jnt_range"},
    "site": {"pos": "site_pos", "quat": "site_quat"},
    "camera": {"pos": "cam_pos", "quat": "cam_quat", "fovy": "cam_fovy"},
    "light": {"pos": "light_pos", "dir": "light_dir"},
}
"""Attributes by element, and the compiled model's arrays of their values, a row per element."""
_OF_SPEC = {
    "material": {"rgba": "rgba", "texrepeat": "texrepeat"},
    "mesh": {"vertex": "uservert", "normal": "usernormal", "texcoord": "usertexcoord"},
    "joint": {
        "damping": "damping",
        "armature": "armature",
        "frictionloss": "frictionloss",
        "actuatorfrcrange": "actfrcrange",
    },
    "geom": {"rgba": "rgba"},
    "key": {"qpos": "qpos", "ctrl": "ctrl", "mpos": "mpos", "mquat": "mquat"},
}
"""Attributes by element, and those of the spec's elements."""
_POSE = {"pos": "0 0 0", "quat": "1 0 0 0"}
"""Attributes of poses, and their defaults."""


def exact_xml(spec: mujoco.MjSpec, model: mujoco.MjModel) -> Element:
    """Root element `mujoco` of a model's MJCF, with exact numbers.

    Args:
        spec: The model; its textures and meshes are files of `spec.assets`, built in, or (meshes) inline.
        model: The same, compiled.

    Raises:
        ValueError: MuJoCo writes elements in another order than the model has them.
    """
    with silence_prefix_warnings():
        root = ElementTree.fromstring(spec.to_xml())
    for defaults in root.findall("default"):  # MuJoCo refuses to read them, and every element has its own values
        root.remove(defaults)
    world, assets = find_section(root, "worldbody"), find_section(root, "asset")
    _dissolve_frames(world)
    bodies = [*world.iter("body")]
    for body in bodies:
        if body.find("inertial") is None and not body.get("mocap"):  # MuJoCo would guess it from shapes without mass
            body.insert(0, Element("inertial", mass="0", diaginertia="0 0 0"))
    # by tag: each element with its row in the compiled model's arrays; body 0 is the world
    rows = {
        "body": list(enumerate(bodies, 1)),
        "inertial": [(i, inertial) for i, body in enumerate(bodies, 1) for inertial in body.findall("inertial")],
        **{kind: list(enumerate(world.iter(kind))) for kind in ("geom", "joint", "site", "camera", "light")},
    }
    _check_order(rows["body"] + rows["geom"], [*spec.bodies[1:], *spec.geoms])
    for kind, arrays in _OF_MODEL.items():
        for row, node in rows[kind]:
            _rewrite(node, {name: getattr(model, array)[row] for name, array in arrays.items()})
    # by tag: the element that contains these elements, and the spec's items in the same order
    listed = {
        "material": (assets, spec.materials),
        "mesh": (assets, spec.meshes),
        "joint": (world, spec.joints),
        "geom": (world, spec.geoms),
        "key": (root, spec.keys),
    }
    for kind, (parent, items) in listed.items():
        for node, item in zip(parent.iter(kind), items, strict=True):
            _rewrite(node, {name: getattr(item, attribute) for name, attribute in _OF_SPEC[kind].items()})
    for node, geom in zip(world.iter("geom"), spec.geoms, strict=True):
        if node.get("type") == "mesh":  # its compiled pose is that of the mesh's centre
            _rewrite(node, {"pos": geom.pos, "quat": geom.quat})
    return root


def format_numbers(values: ArrayLike) -> str:
    """Numbers as text: the fewest digits that read back as the same float32 or float64."""
    positive_zeros = np.ravel(np.asarray(values)) + 0.0  # −0 becomes 0
    return " ".join(str(value).removesuffix(".0") for value in positive_zeros)


def find_section(parent: Element, tag: str) -> Element:
    """The one section of a model with a tag.

    Raises:
        ValueError: There is none, or more than one.
    """
    sections = parent.findall(tag)
    if len(sections) != 1:
        raise ValueError(f"invalid MJCF: expected one {tag}, found {len(sections)}")
    return sections[0]


def _check_order(rows: list[tuple[int, Element]], items: list[Any]) -> None:
    """Rejects elements in another order than the model's.

    Not every element has a name, so the rows of the compiled model's arrays are assigned by order.

    Args:
        rows: Row and element of the XML, in the order of the file.
        items: Elements of the spec, in the order of the model.

    Raises:
        ValueError: A name differs.
    """
    for (_, node), item in zip(rows, items, strict=True):
        if node.get("name", "") != item.name:
            raise ValueError(f"invalid order of MJCF: expected {item.name!r}, found {node.get('name')!r}")


def _rewrite(node: Element, values: dict[str, ArrayLike]) -> None:
    """Writes exact numbers to attributes of an element.

    Attributes that the element lacks are skipped. Poses are an exception: `to_xml` omits them where six digits round
    them to their defaults. A pose that is exactly the default is removed.

    Args:
        node: The element.
        values: Values by name of the attribute; of a longer array, as many are written as the element has.
    """
    for name, value in values.items():
        text = node.get(name)
        if text is None and name not in _POSE:
            continue
        # as many numbers as the element has, or all of a pose that it lacks
        count = np.size(value) if text is None else len(text.split())
        node.set(name, format_numbers(np.ravel(value)[:count]))
        if node.get(name) == _POSE.get(name) and node.tag != "inertial":  # an inertial element must have its place
            del node.attrib[name]


def _dissolve_frames(parent: Element) -> None:
    """Replaces each frame below an element by its children; their poses are rewritten afterwards."""
    for node in list(parent):
        _dissolve_frames(node)
        if node.tag == "frame":
            at = list(parent).index(node)  # the children go to the place of the frame
            parent.remove(node)
            for i, child in enumerate(node):
                parent.insert(at + i, child)

"""The files of a scene: MJCF, textures and meshes, in one folder.

`NAME.xml` has terrain, bystanders, light and keyframe. It includes `wearer.xml`: person, exoskeleton, sensors, cuffs
and servos. Scenes of one wearer can share a folder, and then share `wearer.xml` and the textures.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import TwinConfig
from stridetwin.sim.scene.exact_xml import exact_xml, find_section, format_numbers
from stridetwin.sim.scene.scene_spec import scene_spec
from stridetwin.sim.wearer.body import compile_model
from stridetwin.sim.world.textures import SIZE
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.files import atomic_file

TEXTURE_PX = SIZE
"""Edge of the twin's own textures, pixels."""
WEARER = "wearer.xml"
_SCENERY = "scenery_"  # prefix of the names of scenery meshes and textures
_ROOT = "root"  # the wearer's outermost body
_WEARERS = ("option", "actuator", "equality", "sensor")  # sections of wearer.xml
_NOTE = " Written by StrideTwin (stridetwin scene): docs/scene.md says what is in it. "


def scene_files(config: TwinConfig, texture_px: int = TEXTURE_PX) -> dict[str, bytes]:
    """The files of a scene by their path in its folder.

    Args:
        config: Scenario.
        texture_px: Edge of the textures, pixels; fewer make smaller files.

    Raises:
        ConfigError: A value that cannot be built.
    """
    if f"{config.name}.xml" == WEARER:
        raise ConfigError(config.name, "name of the scenario", config.name, "another one: wearer.xml is the wearer's")
    spec = scene_spec(config)
    finish = "" if config.route.texture == "rich" else f"_{config.route.texture}"  # suffix of the textures' names
    files = _extract_textures(spec, finish, texture_px)
    spec.assets = dict(files)
    root = exact_xml(spec, compile_model(spec))
    for node in list(find_section(root, "asset").iter("mesh")):
        name = str(node.get("name"))
        if name.startswith(_SCENERY):  # other meshes stay in the MJCF or are files already
            path = f"meshes/{config.name}/{name.removeprefix(_SCENERY)}.obj"
            files[path] = _format_obj(spec.mesh(name)).encode()
            node.attrib = {"name": name, "file": path, "inertia": "shell"}
    wearer = _split_off_wearer(root)  # `root` then has the rest of the scene
    for name, part in ((f"{config.name}.xml", root), (WEARER, wearer)):
        part.insert(0, ElementTree.Comment(_NOTE))
        ElementTree.indent(part)
        files[name] = ElementTree.tostring(part) + b"\n"
    return files


def write_scene(files: Mapping[str, bytes], name: str, folder: Path) -> None:
    """Writes the files of a scene to a folder, where other scenes of the same wearer may be.

    Args:
        files: Contents of the files by their path in the folder (`scene_files`).
        name: Name of the scene.
        folder: Made if it does not exist.

    Raises:
        StrideTwinError: A shared file has other contents there.
    """
    for path, data in files.items():
        target, is_own_file = folder / path, path == f"{name}.xml" or path.startswith(f"meshes/{name}/")
        if not is_own_file and target.exists() and target.read_bytes() != data:
            valid = "an empty folder, or one with scenes of the same wearer and texture size"
            raise StrideTwinError(f"{target}: invalid content: belongs to another scene: expected {valid}")
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(folder / path) as file:
            file.write_bytes(data)


def _extract_textures(spec: mujoco.MjSpec, finish: str, size: int) -> dict[str, bytes]:
    """Replaces the painted textures of a model by references to PNG files, and returns these files by path.

    Args:
        spec: The model, which is changed.
        finish: Suffix of the names.
        size: Edge of the images, pixels.
    """
    files: dict[str, bytes] = {}
    painted: dict[bytes, str] = {}  # path by pixels: equal textures share a file
    for texture in spec.textures:
        data = bytes(texture.data)
        if not data:
            continue  # not painted, but built in or a file
        if data not in painted:
            painted[data] = f"textures/{texture.name.removeprefix(_SCENERY)}{finish}.png"
            pixels = np.frombuffer(data, np.uint8).reshape(texture.height, texture.width, 3)
            files[painted[data]] = _encode_png(pixels, size)
        texture.data, texture.file = b"", painted[data]
    return files


def _encode_png(pixels: NDArray[np.uint8], size: int) -> bytes:
    """PNG file of an image, scaled to `size` pixels along each edge."""
    if size != len(pixels):
        pixels = np.asarray(cv2.resize(pixels, (size, size), interpolation=cv2.INTER_AREA), np.uint8)
    # OpenCV wants the channels in the order blue, green, red
    done, encoded = cv2.imencode(".png", pixels[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise StrideTwinError("a texture cannot be encoded as PNG")
    return encoded.tobytes()


def _format_obj(mesh: mujoco.MjsMesh) -> str:
    """Text of an OBJ file with a mesh of rectangles; equal corners, texture coordinates and normals are written once.

    The mesh lists the corners of its rectangles one after another, four for each.
    """
    vertices = np.reshape(np.asarray(mesh.uservert, np.float32), (-1, 3))
    normals = np.reshape(np.asarray(mesh.usernormal, np.float32), (-1, 3))
    uv = np.reshape(np.asarray(mesh.usertexcoord, np.float32), (-1, 2))
    uv[:, 1] = 1.0 - uv[:, 1]  # MuJoCo reverses that of OBJ files
    lines, corners = [], []  # `corners`: for v, vt and vn, the number of each corner's row, from 1 on
    for key, rows in (("v", vertices), ("vt", uv), ("vn", normals)):
        index: dict[str, int] = {}  # number of each row by its text, in order of first use
        corners.append([index.setdefault(format_numbers(row), len(index) + 1) for row in rows])
        lines += [f"{key} {text}" for text in index]
    corner_texts = [f"{v}/{t}/{n}" for v, t, n in zip(*corners)]
    lines += [f"f {' '.join(corner_texts[i : i + 4])}" for i in range(0, len(corner_texts), 4)]
    return "\n".join(lines) + "\n"


def _split_off_wearer(root: Element) -> Element:
    """Moves the wearer out of a scene's MJCF, which then includes the file `WEARER`.

    Returns:
        Root element of that file: the wearer's bodies, the materials, meshes and textures that they use, and servos,
        cuffs and sensors.
    """
    world, assets = find_section(root, "worldbody"), find_section(root, "asset")
    wearer = Element("mujoco", model="wearer")
    wearer.append(find_section(root, "compiler"))
    body = next(node for node in world if node.get("name") == _ROOT)  # the wearer's outermost body
    wearer_assets = ElementTree.SubElement(wearer, "asset")
    # names of the materials, meshes and textures that the wearer's shapes use
    used = {value for geom in body.iter("geom") for value in (geom.get("material"), geom.get("mesh")) if value}
    used |= {str(node.get("texture")) for node in assets.iter("material") if node.get("name") in used}
    _move_elements([node for node in assets if node.get("name") in used], assets, wearer_assets)
    # what follows the wearer goes behind the include, so that the order of bodies stays
    later = list(world)[list(world).index(body) + 1 :]
    _move_elements([body], world, ElementTree.SubElement(wearer, "worldbody"))
    for tag in _WEARERS:
        _move_elements(root.findall(tag), root, wearer)
    at = list(root).index(world) + 1
    root.insert(at, Element("include", file=WEARER))
    if later:
        remaining = Element("worldbody")
        _move_elements(later, world, remaining)
        root.insert(at + 1, remaining)
    return wearer


def _move_elements(nodes: list[Element], source: Element, target: Element) -> None:
    """Moves elements from one parent to the end of another."""
    for node in nodes:
        source.remove(node)
        target.append(node)

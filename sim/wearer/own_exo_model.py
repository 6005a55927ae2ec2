"""An exoskeleton's MJCF or URDF file, read by MuJoCo's own compiler, as a base and two chains of hinges.

Links without a joint are merged into their carriers. Joint axes, ranges, damping, friction and armature, masses and
inertias are the model's; its actuators, sensors, contacts and keyframes are not used. Models that cannot be worn this
way are rejected: other joints than hinges, more than one on a link, legs that branch, closed chains.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr, unescape

import mujoco
import numpy as np

from stridetwin.sim.exo_description import Link, Shape
from stridetwin.streams.bounded import read_bytes
from stridetwin.streams.errors import ConfigError, StrideTwinError
from stridetwin.streams.samples import Array

MOST_JOINTS = 8
"""Largest number of joints of a leg."""
MOST_LINKS = 100
"""Largest number of bodies of the model."""
MASS_KG = (0.05, 60.0)
"""Least and largest mass of the whole exoskeleton."""
# settings of MuJoCo's compiler for a URDF: keep visual shapes, fixed links and the folders of meshes
_URDF = 'discardvisual="false" fusestatic="false" strippath="false"'
_PACKAGE = "package://"  # begins the paths of files in a ROS package
_LARGEST_FILE = 4 << 20  # bytes
_MOST_FACES = 100_000  # of all meshes together
_LIGHTEST_KG = 1e-3  # least mass of a link with a joint
_FULL_TURN = np.array([-np.pi, np.pi])  # rad, range of a hinge without limits
# types of geoms that a link may show
_SHAPES = {
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_MESH,
    )
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Chains:
    """Links of a custom exoskeleton, and the place of each body of its model among them.

    Attributes:
        base: Link fixed to the pelvis.
        legs: The two chains that hang on it.
        carrier: Link that each of the model's bodies is merged into: -1 is the base, otherwise leg and number in it.
        T_carrier: (4, 4) pose of each of the model's bodies in the frame of that link.
    """

    base: Link
    legs: tuple[tuple[Link, ...], ...]
    carrier: dict[str, tuple[int, int]]
    T_carrier: dict[str, Array]


def read_model(path: Path, base: str, p_base: Array, R_base: Array, names: dict[str, str]) -> Chains:
    """Reads the model of a custom exoskeleton as a base and two chains of hinges.

    Args:
        path: MJCF or URDF file.
        base: Name of the link that is fixed to the pelvis.
        p_base: (3,) m, origin of that link in the pelvis' frame.
        R_base: (3, 3) rotation of that link in the pelvis' frame.
        names: Name in the wearer's model of each joint, by its name in the file; other joints get a generated name.

    Raises:
        ConfigError: An invalid value; the message names file, field, value and what is valid.
        StrideTwinError: The file cannot be read or compiled.
    """
    model = _compile_file(path)
    _check_kinds(path, model)
    # the number is -1 for an unknown name and 0 for the world
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, base) < 1:
        known = ", ".join(model.body(b).name for b in range(1, model.nbody))
        raise ConfigError(path, "base", base, f"a link of the model: {known}")
    root = model.body(base).id
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    owners = _find_owners(path, model, root)  # by body: the body that it is merged into
    chains = _find_chains(path, model, root, owners)
    _check_names(path, model, [root, *(b for leg in chains for b in leg)], names)
    # rotation from the model's world to the pelvis' axes, and origin of each link in that world: its joint's anchor
    to_pelvis = R_base @ data.xmat[root].reshape(3, 3).T
    origin = {root: data.xpos[root]} | {b: data.xanchor[model.body_jntadr[b]] for leg in chains for b in leg}

    def link(b: int, parent: int | None) -> Link:
        """The link of body b with all bodies merged into it, in the pelvis' axes.

        `parent` is the body of the link that carries it; None for the base, which has no joint.
        """
        joint = model.joint(model.body_jntadr[b]) if parent is not None else None
        offset = p_base if parent is None else to_pelvis @ (origin[b] - origin[parent])
        merged = [i for i, owner in owners.items() if owner == b]
        mass, com, inertia = _combine_masses(model, data, merged, origin[b], to_pelvis)
        if parent is not None and mass < _LIGHTEST_KG:
            raise ConfigError(path, f"mass of {model.body(b).name}", mass, f"at least {_LIGHTEST_KG:g} kg")
        dof = model.jnt_dofadr[joint.id] if joint is not None else 0
        return Link(
            name=_exo_name(model.body(b).name),
            joint="" if joint is None else names.get(joint.name, _exo_name(joint.name)),
            offset=np.array(offset),
            axis=np.zeros(3) if joint is None else to_pelvis @ data.xaxis[joint.id],
            stops=np.array(joint.range) if joint is not None and model.jnt_limited[joint.id] else _FULL_TURN.copy(),
            damping=float(model.dof_damping.reshape(model.nv, -1)[dof, 0]) if joint is not None else 0.0,
            friction=float(model.dof_frictionloss[dof]) if joint is not None else 0.0,
            armature=float(model.dof_armature[dof]) if joint is not None else 0.0,
            mass=mass,
            com=com,
            inertia=inertia,
            shapes=tuple(_read_shapes(path, model, data, merged, origin[b], to_pelvis)),
        )

    base_link = link(root, None)
    # each link is carried by the one before it in its chain, the first one by the base
    legs = tuple(tuple(link(b, parent) for b, parent in zip(leg, [root, *leg])) for leg in chains)
    total_mass = base_link.mass + sum(part.mass for leg in legs for part in leg)
    if not MASS_KG[0] <= total_mass <= MASS_KG[1]:
        raise ConfigError(path, "mass", round(total_mass, 4), f"{MASS_KG[0]:g}-{MASS_KG[1]:g} kg in all")
    # by body with a joint: number of the leg, and of the link in it; -1 for the base
    place = {root: (-1, 0)} | {b: (k, i) for k, leg in enumerate(chains) for i, b in enumerate(leg)}
    T_carrier = {}
    for b, owner in owners.items():
        T = np.eye(4)
        T[:3, :3] = to_pelvis @ data.xmat[b].reshape(3, 3)
        T[:3, 3] = to_pelvis @ (data.xpos[b] - origin[owner])
        T_carrier[model.body(b).name] = T
    carrier = {model.body(b).name: place[o] for b, o in owners.items() if model.body(b).name}
    return Chains(base=base_link, legs=legs, carrier=carrier, T_carrier=T_carrier)


def files_of(path: Path) -> list[str]:
    """Files that a model references, such as meshes, as paths relative to its folder.

    Raises:
        ConfigError: The file has elements that a model of an exoskeleton may not have.
        StrideTwinError: It cannot be read.
    """
    text, folder = _read_text(path), path.absolute().parent
    # an error of MuJoCo becomes one line
    with _report_in_one_line(path, "read"):
        if _is_urdf(text):  # MuJoCo does not list the meshes of URDF among the dependencies
            spec = _parse_spec(path, text)
            names = (mesh.file.removeprefix(_PACKAGE) for mesh in spec.meshes)
            files = [os.path.join(folder, spec.meshdir, name) for name in names]
        else:
            files = mujoco.mju_getXMLDependencies(str(path.absolute()))
    return sorted({os.path.relpath(file, folder) for file in files if Path(file) != path.absolute()})


def _read_text(path: Path) -> str:
    """Text of a model file.

    Raises:
        StrideTwinError: It cannot be read.
        ConfigError: It has elements that a model of an exoskeleton may not have.
    """
    try:
        text = read_bytes(path, _LARGEST_FILE).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise StrideTwinError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if element := re.search(r"<\s*(include|plugin|extension|replicate|composite|flexcomp|hfield|skin)\b", text):
        raise ConfigError(
            path, element[1], f"<{element[1]}>", "one file of bodies, joints, geoms, meshes and materials"
        )
    return text


def _is_urdf(text: str) -> bool:
    """Whether the root element is a robot; comments and declarations may contain any name."""
    before, *comments = text.split("<!--")  # each of `comments` begins inside a comment, which ends at "-->"
    root = re.search(r"<(\w+)", before + "".join(after.partition("-->")[2] for after in comments))
    return root is not None and root[1] == "robot"


def _parse_spec(path: Path, text: str) -> mujoco.MjSpec:
    """Editable model of an MJCF or URDF file; a URDF without settings for MuJoCo gets them."""
    if not _is_urdf(text) or "<mujoco" in text:
        return mujoco.MjSpec.from_file(str(path))
    folder = quoteattr(str(path.absolute().parent))
    text = re.sub(rf"(?<=[\"']){_PACKAGE}[^\"']*", lambda uri: _resolve_package(path, uri[0]), text)
    text = text.replace("</robot>", f"<mujoco><compiler {_URDF} meshdir={folder}/></mujoco></robot>")
    return mujoco.MjSpec.from_string(text)


def _resolve_package(path: Path, uri: str) -> str:
    """Path of a file `package://NAME/PATH` of a URDF, relative to the URDF's folder, escaped for XML.

    The file is searched as PATH and as NAME/PATH beside the URDF, then as PATH in the nearest folder above that is
    called NAME, where ROS packages keep `urdf` beside `meshes`. It stays NAME/PATH, which MuJoCo then misses by name,
    if there is none.
    """
    named = unescape(uri.removeprefix(_PACKAGE))
    package, _, inside = named.partition("/")
    folder = path.absolute().parent
    roots = [folder / inside, folder / named, *(up / inside for up in folder.parents if up.name == package)]
    file = next((file for file in roots if inside and file.is_file()), folder / named)
    return escape(os.path.relpath(file, folder))


def _compile_file(path: Path) -> mujoco.MjModel:
    """Compiled model of an MJCF or URDF file, in which fixed links keep their own bodies.

    Raises:
        ConfigError: It has elements that a model of an exoskeleton may not have.
        StrideTwinError: It cannot be read or compiled.
    """
    text = _read_text(path)
    with _report_in_one_line(path, "compile"):
        spec = _parse_spec(path, text)
        spec.compiler.fusestatic = False  # otherwise a base that is fixed to the world would lose its mass
        return spec.compile()


@contextmanager
def _report_in_one_line(path: Path, action: str) -> Iterator[None]:
    """Turns MuJoCo's errors within a `with` block into `StrideTwinError` with one line."""
    try:
        yield
    except Exception as error:
        raise StrideTwinError(f"{path}: MuJoCo cannot {action} it: {' '.join(str(error).split())[:400]}") from error


def _check_kinds(path: Path, model: mujoco.MjModel) -> None:
    """Rejects models that are not chains of hinges: too many links, closed chains, tendons, or unsuitable joints.

    Raises:
        ConfigError: The message names the element and what is valid.
    """
    if model.nbody - 1 > MOST_LINKS:
        raise ConfigError(path, "links", model.nbody - 1, f"up to {MOST_LINKS}")
    if model.neq:
        name = model.equality(0).name or "unnamed"
        raise ConfigError(path, "equality", name, "no closed chains: legs that are chains of hinges")
    if model.ntendon:
        raise ConfigError(path, "tendon", model.tendon(0).name or "unnamed", "no tendons")
    for i in range(model.njnt):
        joint, body = model.joint(i), model.body(model.jnt_bodyid[i])
        kind = mujoco.mjtJoint(int(model.jnt_type[i])).name.removeprefix("mjJNT_").lower()
        where, count = f"joint {joint.name or 'unnamed'} of {body.name}", model.body_jntnum[body.id]
        limits = joint.range  # rad; all joints at zero is the pose of standing upright
        within = not model.jnt_limited[i] or limits[0] <= 0.0 <= limits[1]
        for is_valid, field, value, valid in (
            (kind == "hinge", where, kind, "hinge (the base is fixed to the pelvis by its rig file)"),
            (joint.name, where, "", "a name"),
            (body.name, f"link of joint {joint.name}", "", "a name"),
            (count == 1, where, f"{count} joints", "one hinge a link"),
            (not np.any(joint.stiffness), f"{where}, stiffness", np.max(joint.stiffness), "0: no springs in joints"),
            (not joint.qpos0[0], f"{where}, ref", float(joint.qpos0[0]), "0"),
            (
                within,
                f"{where}, range",
                f"{np.round(np.degrees(limits), 2).tolist()} deg",
                "a range with 0, the pose of standing upright",
            ),
        ):
            if not is_valid:
                raise ConfigError(path, field, value, valid)


def _check_names(path: Path, model: mujoco.MjModel, bodies: list[int], names: dict[str, str]) -> None:
    """Rejects links and joints whose names collide in the wearer's model.

    Args:
        path: The model's file, for messages.
        model: The exoskeleton's model.
        bodies: The base, then all bodies with a joint.
        names: Name in the wearer's model of each joint that has one, by its name in the file.

    Raises:
        ConfigError: Two names of the file become one.
    """
    links = [model.body(b).name for b in bodies]
    joints = [model.joint(model.body_jntadr[b]).name for b in bodies[1:]]
    for kind, wearer_names in (
        ("link", {name: _exo_name(name) for name in links}),
        ("joint", {name: names.get(name, _exo_name(name)) for name in joints}),
    ):
        first: dict[str, str] = {}  # the first name of the file that becomes a name in the wearer's model
        for name, wearer_name in wearer_names.items():
            first_name = first.setdefault(wearer_name, name)
            if first_name != name:
                raise ConfigError(
                    path, kind, name, f"another name: {first_name} is {wearer_name} in the wearer's model, too"
                )


def _find_owners(path: Path, model: mujoco.MjModel, root: int) -> dict[int, int]:
    """For each body, the body that it is merged into: the nearest carrier with a joint, or the base.

    Raises:
        ConfigError: The base hangs on a joint, or a body does not hang on the base.
    """
    owners: dict[int, int] = {}
    if any(model.body_jntnum[up] for up in _carriers(model, model.body_parentid[root])):
        raise ConfigError(path, "base", model.body(root).name, "a link that no joint carries")
    if model.body_jntnum[root]:
        raise ConfigError(
            path, "base", model.body(root).name, "a link without a joint: its rig file says where it sits"
        )
    for b in range(1, model.nbody):
        carriers = list(_carriers(model, b))
        if root not in carriers:
            raise ConfigError(path, f"link {model.body(b).name}", "beside the base", "links that hang on the base")
        owners[b] = next(up for up in carriers if up == root or model.body_jntnum[up])
    return owners


def _carriers(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """A body and those that carry it, up to the outermost one."""
    while body:
        yield int(body)
        body = model.body_parentid[body]


def _find_chains(path: Path, model: mujoco.MjModel, root: int, owners: dict[int, int]) -> list[list[int]]:
    """For each of the two legs, its bodies with a joint from the base to the tip.

    Args:
        path: The model's file, for messages.
        model: The exoskeleton's model.
        root: The base.
        owners: For each body, the body that it is merged into (`_find_owners`).

    Raises:
        ConfigError: A leg branches, or the model has not two legs of the same number of joints.
    """
    below: dict[int, list[int]] = {}  # bodies with a joint that hang on a link or on what is merged into it
    for b in range(1, model.nbody):
        if model.body_jntnum[b]:
            below.setdefault(owners.get(int(model.body_parentid[b]), root), []).append(b)
    legs = []
    for first in below.get(root, []):
        leg = [first]
        while next_links := below.get(leg[-1], []):
            if len(next_links) > 1:
                names = " and ".join(model.body(b).name for b in next_links)
                raise ConfigError(path, f"link {model.body(leg[-1]).name}", names, "one link with a joint beyond it")
            leg += next_links
        legs.append(leg)
    counts = [len(leg) for leg in legs]
    if len(legs) != 2 or counts[0] != counts[1] or counts[0] > MOST_JOINTS:
        valid = f"two, one a leg, of the same number of joints, 1-{MOST_JOINTS}"
        raise ConfigError(path, "chains of hinges on the base, joints of each", counts, valid)
    return legs


def _combine_masses(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], origin: Array, to_pelvis: Array
) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia of several bodies together.

    Args:
        model: The exoskeleton's model.
        data: Its state with all joints at zero.
        bodies: The bodies.
        origin: (3,) m, origin of their link in the model's world.
        to_pelvis: (3, 3) rotation from the model's world to the pelvis' axes.

    Returns:
        kg; (3,) m from the origin, and (3, 3) kg m² about the centre of mass, in the pelvis' axes.
    """
    masses = model.body_mass[bodies]
    mass = float(masses.sum())
    if mass <= 0.0:  # no centre of mass
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = masses @ data.xipos[bodies] / mass
    inertia = np.zeros((3, 3))
    for b in bodies:
        # axes of the body's moments of inertia, and its centre of mass from the common one: parallel-axis theorem
        R, d = data.ximat[b].reshape(3, 3), data.xipos[b] - centre
        inertia += R @ np.diag(model.body_inertia[b]) @ R.T + model.body_mass[b] * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, to_pelvis @ (centre - origin), to_pelvis @ inertia @ to_pelvis.T


def _read_shapes(
    path: Path, model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], origin: Array, to_pelvis: Array
) -> list[Shape]:
    """Visual shapes of the bodies that are merged into one link; of a URDF, its visual elements if there are any.

    Args:
        path: The model's file, for messages.
        model: The exoskeleton's model.
        data: Its state with all joints at zero.
        bodies: The bodies.
        origin: (3,) m, origin of their link in the model's world.
        to_pelvis: (3, 3) rotation from the model's world to the pelvis' axes.

    Raises:
        ConfigError: A shape that cannot be worn, or too many faces.
    """
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in bodies]
    if path.suffix == ".urdf":  # its visual elements do not collide; a model without them shows the others
        geoms = [g for g in geoms if not model.geom_contype[g] and not model.geom_conaffinity[g]] or geoms
    shapes = []
    if int(model.nmeshface) > _MOST_FACES:
        raise ConfigError(path, "faces of its meshes", int(model.nmeshface), f"up to {_MOST_FACES}")
    for g in geoms:
        kind = int(model.geom_type[g])
        if kind not in _SHAPES:
            name = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
            raise ConfigError(
                path, f"geom {model.geom(g).name or g}", name, "sphere, capsule, ellipsoid, cylinder, box or mesh"
            )
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, (to_pelvis @ data.geom_xmat[g].reshape(3, 3)).ravel())
        # number of the mesh; vertices and faces stay empty for other shapes
        m, vertices, faces = int(model.geom_dataid[g]), np.zeros((0, 3)), np.zeros((0, 3), np.int32)
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            at, count = model.mesh_vertadr[m], model.mesh_vertnum[m]
            vertices = np.array(model.mesh_vert[at : at + count], dtype=float)
            at, count = model.mesh_faceadr[m], model.mesh_facenum[m]
            faces = np.array(model.mesh_face[at : at + count], dtype=np.int32)
        material = int(model.geom_matid[g])
        shapes.append(
            Shape(
                kind=kind,
                size=np.array(model.geom_size[g]),
                quat=quat,
                vertices=vertices,
                faces=faces,
                pos=to_pelvis @ (data.geom_xpos[g] - origin),
                rgba=np.array(model.mat_rgba[material] if material >= 0 else model.geom_rgba[g], dtype=float),
            )
        )
    return shapes


def _exo_name(name: str) -> str:
    """Name of a link or joint in the wearer's model: `exo_` and its own name with underscores."""
    return "exo_" + re.sub(r"\W", "_", name)

"""What was found of an arm -> the text of its adapted file: plain MJCF in the form of the shipped arms.

Radians; housing in group 2, capsules in group 4; explicit inertias; one position servo a joint; limits
as `<numeric>`. Meshes are written as the corners of convex solids, so that the file stands alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from workcell.scene.adapt.capsules import Capsule
from workcell.scene.adapt.home import TOOL, Pairs
from workcell.scene.adapt.hulls import Piece
from workcell.scene.adapt.links import Link
from workcell.scene.arm_file import ACCELERATION_LIMIT_NUMERIC, VELOCITY_LIMIT_NUMERIC, ArmFile

_GEOM = mujoco.mjtGeom
_PRIMITIVES = {
    int(_GEOM.mjGEOM_SPHERE): ("sphere", 1),
    int(_GEOM.mjGEOM_CAPSULE): ("capsule", 2),
    int(_GEOM.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    int(_GEOM.mjGEOM_CYLINDER): ("cylinder", 2),
    int(_GEOM.mjGEOM_BOX): ("box", 3),
}
_COLOUR = "0.8 0.8 0.78 1"
_DIGITS = 7
"""Of corners, m: a tenth of a micrometre, far below the margin of the capsules."""


@dataclass(frozen=True)
class Parts:
    """All that an adapted file says but gains and exclusions."""

    name: str
    source: str
    """File name of the original."""
    file: ArmFile
    links: tuple[Link, ...]
    housing: dict[int, list[Piece]]
    """By first body of the link, in the link's frame."""
    capsules: dict[int, list[Capsule]]
    tool_link: int
    tool: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Position and rotation in the frame of its link."""
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    torque: dict[int, tuple[float, float]]


def body_name(file: ArmFile, link: Link) -> str:
    """Of a link in the adapted file."""
    if link.first:
        return file.bodies[link.first]
    names = ("base", "stand", *(f"stand{k}" for k in range(len(file.bodies))))
    return next(name for name in names if name not in file.bodies)


def volume(corners: NDArray[np.float64]) -> float:
    """m³ of the hull of points."""
    return float(ConvexHull(corners).volume)


def xml(
    parts: Parts,
    gains: Sequence[tuple[float, float]] | None = None,
    excluded: Pairs = (),
    home_rad: Sequence[float] | None = None,
) -> str:
    """The whole text; without servos where no gains are given, without keyframe where no home is."""
    root = etree.Element("mujoco", model=parts.name)
    root.append(
        etree.Comment(f" Adapted from {parts.source} by `workcell import`; docs/arms.md says how. ")
    )
    etree.SubElement(root, "compiler", angle="radian", autolimits="true")
    custom = etree.SubElement(root, "custom")
    for numeric, values in (
        (VELOCITY_LIMIT_NUMERIC, parts.velocity),
        (ACCELERATION_LIMIT_NUMERIC, parts.acceleration),
    ):
        etree.SubElement(custom, "numeric", name=numeric, data=_text(values, 6))
    asset = etree.SubElement(root, "asset")
    world = etree.SubElement(root, "worldbody")
    elements: dict[int | None, etree._Element] = {None: world}
    poses = {link.first: link for link in parts.links}
    for link in parts.links:
        elements[link.first] = _body(parts, link, poses, elements[link.parent], asset)
    if not len(asset):
        root.remove(asset)
    if excluded:
        contact = etree.SubElement(root, "contact")
        for one, other in excluded:
            etree.SubElement(contact, "exclude", body1=one, body2=other)
    if gains is not None:
        actuators = etree.SubElement(root, "actuator")
        joints = [joint for link in parts.links for joint in link.joints]
        for joint, (kp, kv) in zip(joints, gains, strict=True):
            name = parts.file.joints[joint]
            etree.SubElement(
                actuators, "position", name=name, joint=name, kp=f"{kp:g}", kv=f"{kv:g}"
            )
    if home_rad is not None:
        keyframe = etree.SubElement(root, "keyframe")
        etree.SubElement(keyframe, "key", name="home", qpos=_text(np.array(home_rad)))
    etree.indent(root)
    return etree.tostring(root, encoding="unicode") + "\n"


def _body(
    parts: Parts,
    link: Link,
    poses: dict[int, Link],
    parent: etree._Element,
    asset: etree._Element,
) -> etree._Element:
    element = etree.SubElement(parent, "body", name=body_name(parts.file, link))
    if link.parent is not None:
        carrier = poses[link.parent]
        position = carrier.rotation.T @ (link.position_m - carrier.position_m)
        element.set("pos", _text(position))
        element.set("quat", _text(_wxyz(carrier.rotation.T @ link.rotation)))
    element.set("gravcomp", "1")
    if link.mass_kg > 0:
        i = link.inertia
        etree.SubElement(
            element,
            "inertial",
            pos=_text(link.centre_m),
            mass=repr(float(link.mass_kg)),
            fullinertia=_text([i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]),
        )
    for joint in link.joints:
        _joint(parts, element, joint)
    for piece in parts.housing[link.first]:
        _piece(parts, element, piece, asset)
    for k, capsule in enumerate(parts.capsules.get(link.first, [])):
        etree.SubElement(
            element,
            "geom",
            name=f"{body_name(parts.file, link)}_capsule{k}",
            type="capsule",
            group="4",
            contype="0",
            conaffinity="0",
            mass="0",
            rgba="0.25 0.5 0.9 0.25",
            fromto=_text(_ends(capsule).reshape(-1)),
            size=repr(float(capsule.radius_m)),
        )
    if parts.tool_link == link.first:
        position, rotation = parts.tool
        etree.SubElement(
            element, "site", name=TOOL, pos=_text(position), quat=_text(_wxyz(rotation))
        )
    return element


def _joint(parts: Parts, element: etree._Element, joint: int) -> None:
    model, file = parts.file.model, parts.file
    dof, address = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    new = etree.SubElement(
        element,
        "joint",
        name=file.joints[joint],
        type=file.kinds[joint],
        pos=_text(model.jnt_pos[joint]),
        axis=_text(model.jnt_axis[joint]),
        actuatorgravcomp="true",
    )
    if model.jnt_limited[joint]:
        new.set("range", _text(model.jnt_range[joint]))
    if joint in parts.torque:
        new.set("actuatorfrcrange", _text(np.array(parts.torque[joint]), 6))
    for key, value in (
        ("ref", model.qpos0[address]),
        ("springref", model.qpos_spring[address]),
        ("stiffness", model.jnt_stiffness[joint]),
        ("damping", model.dof_damping[dof]),
        ("armature", model.dof_armature[dof]),
        ("frictionloss", model.dof_frictionloss[dof]),
    ):
        if value:
            new.set(key, repr(float(value)))


def _piece(parts: Parts, element: etree._Element, piece: Piece, asset: etree._Element) -> None:
    model, name = parts.file.model, parts.file.geoms[piece.geom]
    new = etree.SubElement(
        element,
        "geom",
        name=name,
        group="2",
        contype="0",
        conaffinity="0",
        mass="0",
        rgba=_colour(model, piece.geom),
    )
    corners = piece.corners
    if piece.is_mesh:
        etree.SubElement(asset, "mesh", name=name, vertex=_text(corners.reshape(-1), _DIGITS))
        new.set("type", "mesh")
        new.set("mesh", name)
        return
    kind, sizes = _PRIMITIVES[int(model.geom_type[piece.geom])]
    new.set("type", kind)
    new.set("size", _text(model.geom_size[piece.geom, :sizes]))
    new.set("pos", _text(piece.position_m))
    new.set("quat", _text(_wxyz(piece.rotation)))


def _colour(model: mujoco.MjModel, geom: int) -> str:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    drawn = model.geom_group[geom] <= 2 and rgba[3] > 0.5
    return " ".join(f"{float(x):.3g}" for x in rgba) if drawn else _COLOUR


def _ends(capsule: Capsule) -> NDArray[np.float64]:
    """Both ends; of a ball a hundredth of a millimetre apart, since MJCF wants a direction."""
    if capsule.length_m > 1e-5:
        return capsule.ends
    return capsule.ends.mean(axis=0) + np.array([[0, 0, -5e-6], [0, 0, 5e-6]])


def _wxyz(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).reshape(9))
    return quaternion


def _text(values: Sequence[float] | NDArray[np.float64], digits: int | None = None) -> str:
    """Numbers with all digits, or so many behind the point."""
    numbers = [float(value) if digits is None else round(float(value), digits) for value in values]
    return " ".join(repr(number + 0.0) for number in numbers)

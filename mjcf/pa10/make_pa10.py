"""Write pa10.xml from the tables in pa10_dimensions.py: `python make_pa10.py [FILE]`.

In: links, drives, housing pieces, capsules. Out: one MJCF file of one arm, the same bytes for the
same tables. Derived here are only the servo gains: joint i, alone with its heaviest load, is a
mass on a spring, I q'' + (d + kv) q' + kp q = ..., and kp and kv make it critically damped at the
stated frequency. README.md, steps 5 and 6, gives the reasons.
"""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np
from capsule_fit import extreme_points, margin
from pa10_dimensions import (
    CAPSULES,
    DRIVES,
    HOUSING,
    LINKS,
    TOOL,
    TOOL_TIP_M,
    Box,
    Cylinder,
    Drive,
    DriveClass,
    Frustum,
    Link,
    Piece,
)

# Chosen: fast beside the motions asked of the arm (about 1 Hz), slow beside a 2 ms time step.
SERVO_FREQUENCY_RAD_S = 2 * math.pi * 15.0
# Chosen: half of the 1 mrad a move at 1 rad/s may lag, the rest being left to the accelerations.
VISCOUS_LAG_RAD_PER_RAD_S = 0.5e-3

_HEADER = """
  One Mitsubishi PA10 of seven joints, to be attached to a scene. Straight up at the zero pose:
  z up, x forward, y left. Groups: 2 housing, 4 watched capsules. README.md says where every number
  comes from. Written by make_pa10.py from pa10_dimensions.py: change those, not this file.
"""

_FINISHES = {
    "housing": "0.86 0.87 0.85 1",
    "housing_cover": "0.62 0.80 0.68 1",
    "housing_metal": "0.45 0.47 0.49 1",
}


def build() -> str:
    """The text of pa10.xml.

    Raises:
        ValueError: A watched capsule does not contain its housing.
    """
    for capsule in CAPSULES:
        if margin(capsule) < 0:
            raise ValueError(
                f"{capsule.name}: the housing sticks out by {-margin(capsule):.3f} mm; "
                "capsule_fit.py proposes one that contains it"
            )
    root = _arm()
    actuators = ET.SubElement(root, "actuator")
    inertia = heaviest_inertia_kg_m2(root)
    for (drive, drive_class), inertia_kg_m2 in zip(DRIVES, inertia, strict=True):
        kp, kv = servo_gains(inertia_kg_m2, drive_class.damping_n_m_s)
        ET.SubElement(
            actuators, "position", name=drive.name, joint=drive.name, kp=_text(kp), kv=_text(kv)
        )
    return _serialise(root)


def heaviest_inertia_kg_m2(root: ET.Element) -> list[float]:
    """Diagonal element of the mass matrix of each joint, kg m^2, in its heaviest configuration."""
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    mass = np.zeros((model.nv, model.nv))
    inertia = []
    for index, (drive, _) in enumerate(DRIVES):
        data.qpos[:] = np.deg2rad(drive.heaviest_deg)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        inertia.append(float(mass[index, index]))
    return inertia


def servo_gains(inertia_kg_m2: float, damping_n_m_s: float) -> tuple[float, float]:
    """Position gain, N m / rad, and velocity gain, N m s / rad, rounded to three digits."""
    kp = max(
        inertia_kg_m2 * SERVO_FREQUENCY_RAD_S**2,
        damping_n_m_s / VISCOUS_LAG_RAD_PER_RAD_S,
    )
    kv = 2 * math.sqrt(inertia_kg_m2 * kp) - damping_n_m_s
    return float(f"{kp:.3g}"), float(f"{kv:.3g}")


def _arm() -> ET.Element:
    """The arm without its actuators, whose gains follow from it."""
    root = ET.Element("mujoco", model="pa10")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    _add_limits(ET.SubElement(root, "custom"))
    _add_defaults(ET.SubElement(root, "default"))
    assets = ET.SubElement(root, "asset")
    parent = ET.SubElement(root, "worldbody")
    for index, link in enumerate(LINKS):
        parent = _add_link(parent, link, assets, DRIVES[index - 1] if index else None)
        if link.name == "link3":
            ET.SubElement(parent, "site", name="elbow")
    ET.SubElement(parent, "site", name="flange")
    parent = _add_link(parent, TOOL, assets, None)
    ET.SubElement(parent, "site", name="tool", pos=_text(0, 0, TOOL_TIP_M))
    return root


def _add_limits(custom: ET.Element) -> None:
    """What MJCF has no attribute for, in the order of the joints."""
    speeds = [drive.speed_rad_s for drive, _ in DRIVES]
    accelerations = [math.radians(drive.acceleration_deg_s2) for drive, _ in DRIVES]
    for name, values in (
        ("joint_velocity_limit_rad_s", speeds),
        ("joint_acceleration_limit_rad_s2", accelerations),
    ):
        ET.SubElement(custom, "numeric", name=name, data=_text(*values))


def _add_defaults(default: ET.Element) -> None:
    arm = ET.SubElement(default, "default", {"class": "pa10"})
    ET.SubElement(arm, "joint", type="hinge", actuatorgravcomp="true")
    ET.SubElement(arm, "geom", contype="0", conaffinity="0", mass="0")
    ET.SubElement(arm, "site", group="3", size="0.008", rgba="0.9 0.3 0.2 1")
    for drive_class in {drive_class.name: drive_class for _, drive_class in DRIVES}.values():
        motor = ET.SubElement(arm, "default", {"class": drive_class.name})
        ET.SubElement(
            motor,
            "joint",
            armature=_text(drive_class.armature_kg_m2),
            damping=_text(drive_class.damping_n_m_s),
        )
    housing = ET.SubElement(arm, "default", {"class": "housing"})
    ET.SubElement(housing, "geom", group="2", rgba=_FINISHES["housing"])
    for finish, rgba in _FINISHES.items():
        if finish != "housing":
            child = ET.SubElement(housing, "default", {"class": finish})
            ET.SubElement(child, "geom", rgba=rgba)
    watched = ET.SubElement(arm, "default", {"class": "watched"})
    ET.SubElement(watched, "geom", type="capsule", group="4", rgba="0.25 0.5 0.9 0.25")


def _add_link(
    parent: ET.Element, link: Link, assets: ET.Element, drive: tuple[Drive, DriveClass] | None
) -> ET.Element:
    """The body of a link with all that it carries, added to its parent."""
    body = ET.SubElement(
        parent, "body", name=link.name, pos=_text(0, 0, link.offset_z_m), gravcomp="1"
    )
    if link.name == LINKS[0].name:
        body.set("childclass", "pa10")
    ET.SubElement(
        body,
        "inertial",
        pos=_text(0, 0, link.com_z_m),
        mass=_text(link.mass_kg),
        diaginertia=_text(*link.inertia_kg_m2),
    )
    if drive is not None:
        _add_joint(body, *drive)
    for piece in HOUSING[link.name]:
        _add_piece(body, assets, link.name, piece)
    for capsule in CAPSULES:
        if capsule.body == link.name:
            ET.SubElement(
                body,
                "geom",
                {"class": "watched"},
                name=capsule.name,
                fromto=_metres(*capsule.start, *capsule.end),
                size=_metres(capsule.radius),
            )
    return body


def _add_joint(body: ET.Element, drive: Drive, drive_class: DriveClass) -> None:
    range_rad = math.radians(drive.range_deg)
    ET.SubElement(
        body,
        "joint",
        {"class": drive_class.name},
        name=drive.name,
        axis={"y": "0 1 0", "z": "0 0 1"}[drive.axis],
        range=_text(-range_rad, range_rad),
        actuatorfrcrange=_text(-drive.torque_n_m, drive.torque_n_m),
    )


def _add_piece(body: ET.Element, assets: ET.Element, link_name: str, piece: Piece) -> None:
    """One convex geom; a frustum, which MJCF has no primitive for, brings its mesh."""
    name = f"{link_name}_{piece.name}"
    geom = ET.SubElement(body, "geom", {"class": piece.finish}, name=name)
    if isinstance(piece, Box):
        ranges = np.array([piece.x, piece.y, piece.z], dtype=float)
        geom.set("type", "box")
        geom.set("pos", _metres(*ranges.mean(axis=1)))
        geom.set("size", _metres(*(ranges[:, 1] - ranges[:, 0]) / 2))
    elif isinstance(piece, Cylinder):
        low, high = piece.span
        ends = [
            (piece.at[0], piece.at[1], end)
            if piece.along == "z"
            else (piece.at[0], end, piece.at[1])
            for end in (low, high)
        ]
        geom.set("type", "cylinder")
        geom.set("fromto", _metres(*ends[0], *ends[1]))
        geom.set("size", _metres(piece.radius))
    elif isinstance(piece, Frustum):
        vertices = _metres(*extreme_points(piece).ravel())
        ET.SubElement(assets, "mesh", name=name, vertex=vertices)
        geom.set("type", "mesh")
        geom.set("mesh", name)


def _metres(*values_mm: float) -> str:
    return _text(*(value / 1000 for value in values_mm))


def _text(*values: float) -> str:
    """Numbers as MJCF writes them: seven decimals, which is a tenth of a micrometre."""
    return " ".join(f"{round(value, 7) + 0.0:.8g}" for value in values)


def _serialise(root: ET.Element) -> str:
    root.insert(0, ET.Comment(_HEADER))
    ET.indent(root, space="  ")
    return ET.tostring(root, encoding="unicode").replace(" />", "/>") + "\n"


def main(arguments: Iterable[str]) -> None:
    """Write the model to the file named, or to pa10.xml beside this script."""
    target = next(iter(arguments), Path(__file__).parent / "pa10.xml")
    Path(target).write_text(build(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

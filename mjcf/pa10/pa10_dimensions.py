"""The figures of the arm: what make_pa10.py turns into pa10.xml.

In: nothing. Out: tables of link offsets, drives, inertias, housing pieces and capsules of one
Mitsubishi PA10 of the slim-wrist generation (shoulder at 0.315 m, links of 0.450, 0.500 and
0.080 m). README.md gives the source of each table. Lengths of shapes are in millimetres, as the
measurements were taken; everything else is in SI units. Axes at the zero pose (arm straight up):
z along the link, x forward, y left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

# A frustum is written as the prism-like hull of polygons of this many sides drawn around its end
# circles, so that the hull contains the cone: 24 sides stand out by at most 0.9 % of the radius.
FRUSTUM_SIDES = 24

Range = tuple[float, float]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Link:
    """A rigid body of the arm.

    Attributes:
        name: Body name.
        offset_z_m: Height of the body frame in the frame of the body before it.
        mass_kg: Mass.
        com_z_m: Height of the centre of mass in the body frame (x = y = 0).
        inertia_kg_m2: Principal inertias about the centre of mass along x, y, z.
    """

    name: str
    offset_z_m: float
    mass_kg: float
    com_z_m: float
    inertia_kg_m2: tuple[float, float, float]


@dataclass(frozen=True)
class Drive:
    """A joint with its motor, seen from the joint side of the gear.

    Attributes:
        name: Joint and actuator name.
        axis: Joint axis in the body frame.
        range_deg: Half of the symmetric operating range.
        speed_rad_s: Largest speed.
        acceleration_deg_s2: Largest acceleration.
        torque_n_m: Largest torque.
        heaviest_deg: Configuration in which the inertia about this joint is largest.
    """

    name: str
    axis: str
    range_deg: float
    speed_rad_s: float
    acceleration_deg_s2: float
    torque_n_m: float
    heaviest_deg: tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True)
class DriveClass:
    """What joints with the same motor share.

    Attributes:
        name: Default class of the joints.
        armature_kg_m2: Rotor inertia times the square of the gear ratio.
        damping_n_m_s: Viscous friction at the joint, in N m s / rad.
    """

    name: str
    armature_kg_m2: float
    damping_n_m_s: float


@dataclass(frozen=True)
class Box:
    """An axis-aligned box: ranges along x, y and z in mm."""

    name: str
    x: Range
    y: Range
    z: Range
    finish: str = "housing"


@dataclass(frozen=True)
class Cylinder:
    """A cylinder along z or y: axial range and radius in mm, `at` = the axis's other coordinates.

    For `along="z"` these are (x, y), for `along="y"` they are (x, z).
    """

    name: str
    along: str
    span: Range
    radius: float
    at: Range = (0.0, 0.0)
    finish: str = "housing"


@dataclass(frozen=True)
class Frustum:
    """A cone frustum along z: axial range, the radii at its two ends, `at` = (x, y); in mm."""

    name: str
    span: Range
    radii: Range
    at: Range = (0.0, 0.0)
    finish: str = "housing"


Piece = Box | Cylinder | Frustum


@dataclass(frozen=True)
class Capsule:
    """A watched capsule: segment ends and radius in mm, in the frame of `body`."""

    name: str
    body: str
    start: Point
    end: Point
    radius: float


def _sides(piece: Box | Cylinder) -> tuple[Piece, Piece]:
    """The piece, given at +y, and its mirror image at -y."""
    if isinstance(piece, Box):
        low, high = piece.y
        right: Piece = Box(f"{piece.name}_right", piece.x, (-high, -low), piece.z, piece.finish)
        left: Piece = Box(f"{piece.name}_left", piece.x, piece.y, piece.z, piece.finish)
    else:
        low, high = piece.span
        right = Cylinder(
            f"{piece.name}_right", "y", (-high, -low), piece.radius, piece.at, piece.finish
        )
        left = Cylinder(f"{piece.name}_left", "y", piece.span, piece.radius, piece.at, piece.finish)
    return left, right


LINKS = (
    Link("base", 0.0, 3.04, 0.0765, (0.0193, 0.0193, 0.0184)),
    Link("link1", 0.315, 9.78, -0.16532, (0.0953, 0.0412, 0.0876)),
    Link("link2", 0.0, 8.41, 0.06325, (0.1146, 0.1113, 0.0211)),
    Link("link3", 0.450, 3.51, -0.08944, (0.0297, 0.0143, 0.0229)),
    Link("link4", 0.0, 4.31, 0.04609, (0.0422, 0.0415, 0.0059)),
    Link("link5", 0.500, 3.45, -0.1647, (0.0313, 0.0265, 0.0085)),
    Link("link6", 0.0, 1.46, -0.030, (0.0066, 0.0067, 0.0009)),
    Link("link7", 0.080, 0.24, -0.029, (8e-5, 8e-5, 15e-5)),
)
# The tool is ours: chosen as a small electric gripper, its inertia that of a solid cylinder of
# 20 mm radius and 115 mm length.
TOOL = Link("tool", 0.0, 0.25, 0.055, (0.0003, 0.0003, 0.00005))
TOOL_TIP_M = 0.120

SHOULDER = DriveClass("shoulder_drive", 0.75, 10.0)
ELBOW = DriveClass("elbow_drive", 0.2125, 5.0)
WRIST = DriveClass("wrist_drive", 0.0575, 2.0)

DRIVES = (
    (Drive("S1", "z", 177, 1.0, 95.5, 200, (0, 90, 0, 0, 0, 0, 0)), SHOULDER),
    (Drive("S2", "y", 91, 1.0, 95.5, 200, (0, 0, 0, 0, 0, 0, 0)), SHOULDER),
    (Drive("S3", "z", 174, 2.0, 191, 80, (0, 0, 0, 90, 0, 0, 0)), ELBOW),
    (Drive("E1", "y", 137, 2.0, 191, 80, (0, 0, 0, 0, 0, 0, 0)), ELBOW),
    (Drive("E2", "z", 255, 2.0, 191, 15, (0, 0, 0, 0, 0, 90, 0)), WRIST),
    (Drive("W1", "y", 165, 2 * math.pi, 191, 15, (0, 0, 0, 0, 0, 0, 0)), WRIST),
    (Drive("W2", "z", 255, 2 * math.pi, 191, 10, (0, 0, 0, 0, 0, 0, 0)), WRIST),
)

HOUSING: dict[str, tuple[Piece, ...]] = {
    "base": (
        Box("plate_long", (-117, 117), (-80, 80), (1.5, 21), "housing_metal"),
        Box("plate_wide", (-80, 80), (-117, 117), (1.5, 21), "housing_metal"),
        Box("plate_middle", (-100, 100), (-100, 100), (1.5, 21), "housing_metal"),
        Cylinder("column", "z", (21, 201.5), 110),
        Box("cable_box", (-52, 52), (100, 140), (30, 86), "housing_metal"),
    ),
    "link1": (
        Cylinder("hub", "z", (-123.5, -113), 55.5, finish="housing_metal"),
        Cylinder("turntable", "z", (-113.5, -98), 110),
        Cylinder("shelf", "z", (-99, -85), 100),
        Box("yoke", (-70, 70), (-122, 122), (-99, -84.5)),
        Cylinder("dome", "z", (-86, -70), 41),
        Box("rib", (-20, 20), (-80, 80), (-86, -69.5)),
        *_sides(Box("arm_inner", (-70, 70), (80, 95), (-95, 0))),
        *_sides(Box("arm_middle", (-60, 60), (80, 112), (-97, 0))),
        *_sides(Box("arm_outer", (-48, 48), (80, 130), (-88, 0))),
        *_sides(Cylinder("end_inner", "y", (80, 95.5), 69.5)),
        *_sides(Cylinder("end_middle", "y", (80, 112.5), 60)),
        *_sides(Cylinder("end_outer", "y", (80, 130.5), 48, finish="housing_cover")),
    ),
    "link2": (
        Cylinder("barrel", "y", (-77.5, 76.5), 70),
        Cylinder("trunk", "z", (35, 92), 68),
        Box("saddle", (-66, 66), (-77, 76), (30, 58)),
        Box("shoulder", (-40, 40), (-68, 74), (58, 78)),
        Frustum("collar", (92, 105), (67, 50)),
        Frustum("waist", (105, 185), (49.5, 47)),
        Frustum("flare", (185, 280), (47, 60)),
        Cylinder("end", "z", (280, 313.5), 60, finish="housing_cover"),
        Box("duct_lower", (-20, 20), (0, 70.5), (78, 240), "housing_cover"),
        Box("duct_upper", (-17, 17), (0, 64), (240, 262), "housing_cover"),
    ),
    "link3": (
        Cylinder("hub", "z", (-144.6, -134), 42, finish="housing_metal"),
        Box("yoke_lower", (-48, 48), (-92, 92), (-134, -88.5)),
        Box("yoke_upper", (-57, 57), (-103, 103), (-125, -88)),
        *_sides(Box("arm", (-60, 60), (58.5, 106.5), (-90, 0))),
        *_sides(Cylinder("end_outer", "y", (58.5, 107), 56, finish="housing_cover")),
        *_sides(Cylinder("end_inner", "y", (58.5, 100), 59.5)),
    ),
    "link4": (
        Cylinder("barrel", "y", (-56, 55), 52),
        Box("saddle", (-50, 50), (-55, 54), (20, 52)),
        Cylinder("trunk", "z", (30, 71), 50, (0, 2.5)),
        Frustum("collar", (71, 92), (48, 30), (0, 2.5)),
        Cylinder("waist", "z", (92, 140), 29.5, (0, 2.5)),
        Frustum("flare", (140, 226), (29.5, 50), (0, 2.5)),
        Cylinder("end", "z", (226, 245), 50, (0, 2.5), "housing_cover"),
        Cylinder("rim", "z", (245, 261), 49, (0, 2.5)),
        Box("duct", (-17, 17), (-44.2, 0), (60, 222), "housing_cover"),
    ),
    "link5": (
        Cylinder("hub", "z", (-260, -246), 32.5, finish="housing_metal"),
        Cylinder("turntable", "z", (-247, -235), 35.5, finish="housing_cover"),
        Box("yoke", (-36, 36), (-63, 63), (-241, -160)),
        *_sides(Box("arm", (-43, 43), (37, 63.5), (-201.5, 0))),
        *_sides(Cylinder("lower_end", "y", (37, 64), 43, (0, -201.5))),
        Cylinder("upper_end_left", "y", (37, 64), 42.7, finish="housing_cover"),
        Cylinder("upper_end_right", "y", (-64, -31), 42.7, finish="housing_cover"),
    ),
    "link6": (
        Cylinder("tail_cap", "z", (-159, -145), 29),
        Cylinder("tail", "z", (-145, -72), 31.3),
        Cylinder("body", "z", (-72, 48), 27.5),
        Cylinder("barrel", "y", (-24, 24), 40),
        Cylinder("barrel_step", "y", (-28, 30), 36),
        Cylinder("barrel_ends", "y", (-31, 37), 31, finish="housing_cover"),
        Cylinder("head", "z", (48, 73), 36.5, finish="housing_cover"),
        Box("ridge", (0, 36), (-19.5, 19.5), (-137, 48)),
    ),
    "link7": (
        Cylinder("flange", "z", (-7, 2.5), 36.3, finish="housing_metal"),
        Cylinder("rim", "z", (2.5, 5), 33, finish="housing_metal"),
    ),
    "tool": (
        Cylinder("palm", "z", (5, 45), 20, finish="housing_metal"),
        Box("carriage", (-16, 16), (-10, 10), (45, 55)),
        Box("finger_front", (3, 13), (-6, 6), (55, 120), "housing_metal"),
        Box("finger_back", (-13, -3), (-6, 6), (55, 120), "housing_metal"),
    ),
}

CAPSULES = (
    Capsule("base_capsule", "base", (0, 0, 54.6), (0, 0, 97.6), 151.5),
    Capsule("link1_capsule", "link1", (0, -26, -36.4), (0, 26, -36.4), 134.6),
    Capsule("link2_capsule", "link2", (0, -0.5, 0), (0, 0, 228.5), 104.2),
    Capsule("link3_capsule", "link3", (0, -56.7, -42.3), (0, 56.7, -42.3), 110.8),
    Capsule("link4_capsule", "link4", (0, -0.5, 0), (0, 3.5, 203.7), 76.2),
    Capsule("link5_capsule", "link5", (0, 0, -214.9), (0, 0, -0.3), 77.2),
    Capsule("link6_capsule", "link6", (0, 1.1, -122.5), (0, 1.3, 53.8), 47.5),
    Capsule("tool_capsule", "tool", (0, 0, 8), (0, 0, 106), 20.5),
)

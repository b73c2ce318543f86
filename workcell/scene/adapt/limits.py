"""Published speed and acceleration limits of well-known arms, each with its source.

An arm is known by the words of its name and its number of joints. What a maker does not publish is
None: a conservative value is then assumed, and said. Degrees are as the makers give them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Published:
    """Limits of one arm."""

    words: tuple[str, ...]
    """Any of these in the arm's name, in lower case."""
    velocity_rad_s: tuple[float, ...]
    acceleration_rad_s2: tuple[float, ...] | None
    source: str


def _deg(*values: float) -> tuple[float, ...]:
    return tuple(float(np.deg2rad(value)) for value in values)


PUBLISHED = (
    Published(
        ("panda", "fr3", "franka"),
        (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
        (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        "Franka Emika, Franka Control Interface documentation, robot and interface specifications: limits of Panda",
    ),
    Published(
        ("ur5e", "ur3e", "ur10e"),
        _deg(180, 180, 180, 180, 180, 180),
        None,
        "Universal Robots, UR5e technical specifications: 180 degrees/s at every joint",
    ),
    Published(
        ("iiwa14", "iiwa_14", "iiwa"),
        _deg(85, 85, 100, 75, 130, 135, 135),
        None,
        "KUKA, LBR iiwa 14 R820 data sheet: rated speeds of A1 to A7 (the slower of the two iiwa)",
    ),
    Published(
        ("sawyer",),
        (1.74, 1.328, 1.957, 1.957, 3.485, 3.485, 4.545),
        None,
        "Rethink Robotics, sawyer_robot: velocity limits of sawyer_base.urdf",
    ),
    Published(
        ("baxter",),
        (2.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0),
        None,
        "Rethink Robotics, baxter_common: velocity limits of baxter.urdf, arms",
    ),
    Published(
        ("kinova3", "gen3"),
        (1.3963, 1.3963, 1.3963, 1.3963, 1.2218, 1.2218, 1.2218),
        None,
        "Kinova, kortex_description: velocity limits of the 7-joint Gen3",
    ),
    Published(
        ("jaco", "j2n7", "j2s7"),
        _deg(36, 36, 36, 36, 48, 48, 48),
        None,
        "Kinova, JACO2 specifications: 36 degrees/s of the large actuators, 48 of the small",
    ),
    Published(
        ("xarm7",),
        _deg(180, 180, 180, 180, 180, 180, 180),
        None,
        "UFACTORY, xArm user manual: 180 degrees/s at every joint",
    ),
)


def published(name: str, joints: int) -> Published | None:
    """What is published of an arm of this name and number of joints; None if nothing is known."""
    for entry in PUBLISHED:
        if len(entry.velocity_rad_s) == joints and any(w in name.lower() for w in entry.words):
            return entry
    return None

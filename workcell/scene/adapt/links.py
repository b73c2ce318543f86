"""Bodies that never move against one another -> one link with one mass.

In: an arm file compiled alone, a home, the driven joints and the root. Out: one record a link, in the
frame of its first body, with the mass, centre and inertia of all its bodies together.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.normal_form import rigid_links


@dataclass(frozen=True)
class Link:
    """Bodies that are fixed to one another."""

    first: int
    """Its first body; 0 for what stands still."""
    bodies: tuple[int, ...]
    parent: int | None
    """First body of the link that carries it; None for what stands still."""
    joints: tuple[int, ...]
    """Driven joints that move it against its parent."""
    position_m: NDArray[np.float64]
    """(3,) of its frame in the world at home."""
    rotation: NDArray[np.float64]
    """(3, 3) of its frame in the world at home."""
    mass_kg: float
    centre_m: NDArray[np.float64]
    """(3,) centre of mass in its frame."""
    inertia: NDArray[np.float64]
    """(3, 3) about the centre of mass, axes of its frame, kg m²."""


def links_of(
    model: mujoco.MjModel, data: mujoco.MjData, driven: tuple[int, ...], bodies: set[int], root: int
) -> tuple[Link, ...]:
    """The links that the given bodies make, parents first.

    Args:
        model: The file compiled alone.
        data: Its state at home, positions computed.
        driven: Numbers of the driven joints.
        bodies: Which bodies count: the root and what is below it.
        root: The body whose frame is the arm's base; 0 for the file's world.
    """
    first_of = rigid_links(model, driven)
    members: dict[int, list[int]] = {0: []}
    for body in sorted(bodies):
        members.setdefault(first_of[body], []).append(body)
    found = []
    for first, own in sorted(members.items()):
        frame = first or root
        rotation = data.xmat[frame].reshape(3, 3).copy()
        mass, centre, inertia = composite(model, data, own)
        parent = None if first == 0 else first_of[int(model.body_parentid[first])]
        start, count = model.body_jntadr[first], model.body_jntnum[first]
        found.append(
            Link(
                first=first,
                bodies=tuple(own),
                parent=parent,
                joints=tuple(j for j in range(start, start + count) if j in driven),
                position_m=data.xpos[frame].copy(),
                rotation=rotation,
                mass_kg=mass,
                centre_m=rotation.T @ (centre - data.xpos[frame]),
                inertia=rotation.T @ inertia @ rotation,
            )
        )
    return tuple(found)


def composite(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int]
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Mass, centre of mass in the world, and inertia about it in world axes, of bodies together."""
    masses = model.body_mass[bodies]
    mass = float(masses.sum())
    if mass == 0.0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centres = data.xipos[bodies]
    centre = masses @ centres / mass
    inertia = np.zeros((3, 3))
    for body, own, at in zip(bodies, masses, centres, strict=True):
        turn = data.ximat[body].reshape(3, 3)
        away = at - centre
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia += own * (away @ away * np.eye(3) - np.outer(away, away))
    return mass, centre, inertia

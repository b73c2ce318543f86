"""What of an arm meets things: the body at its tool, and how far that reaches around the tool point.

An arm's tool point may be the tip of its hand, or a point within it; its flange may carry nothing at all.
"""

from __future__ import annotations

import mujoco

from workcell.scene.addresses import ArmAddresses


def tool_body(model: mujoco.MjModel, arm: ArmAddresses) -> int:
    """The body that meets what the tool meets: the tool's own, or the nearest before it that has anything to touch with."""
    watched = {int(model.geom_bodyid[g]) for g in arm.geoms}
    own = body = int(model.site_bodyid[arm.tool_site])
    while body and body not in watched:
        body = int(model.body_parentid[body])
    return body or own


def ahead_m(model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses) -> float:
    """How far the hand's capsules reach beyond the tool point, along the tool's z axis; 0 if they end before it."""
    return max((x for x, _ in _extents(model, data, arm)), default=0.0)


def around_m(model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses) -> float:
    """How far they reach beyond it or, if that is more, to the side of their own axes."""
    return max((max(both) for both in _extents(model, data, arm)), default=0.0)


def _extents(
    model: mujoco.MjModel, data: mujoco.MjData, arm: ArmAddresses
) -> list[tuple[float, float]]:
    """Of each capsule of the hand: how far it reaches beyond the tool point, at least 0, and its radius; m.

    Needs current kinematics.
    """
    body = tool_body(model, arm)
    forward = data.site_xmat[arm.tool_site].reshape(3, 3)[:, 2]
    found = []
    for g in arm.geoms:
        if model.geom_bodyid[g] != body or model.geom_type[g] != mujoco.mjtGeom.mjGEOM_CAPSULE:
            continue
        radius, half = model.geom_size[g, :2]
        axis = half * data.geom_xmat[g].reshape(3, 3)[:, 2]
        offset = data.geom_xpos[g] - data.site_xpos[arm.tool_site]
        ahead = offset @ forward + abs(axis @ forward) + radius
        found.append((max(0.0, float(ahead)), float(radius)))
    return found

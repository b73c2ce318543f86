"""Which bodies of an arm are its hand: what holds an instrument touches it."""

from __future__ import annotations

import mujoco

from workcell.scene.addresses import ArmAddresses

HAND_BODIES = 3
"""The tool's body and the two links before it: what holds an instrument is not watched against it."""


def hand_bodies(model: mujoco.MjModel, arm: ArmAddresses) -> frozenset[int]:
    """The tool's body and the links right before it, as body ids."""
    bodies, body = [], int(model.site_bodyid[arm.tool_site])
    moved = 0
    while body and moved < HAND_BODIES:
        bodies.append(body)
        moved += bool(model.body_jntnum[body])
        body = int(model.body_parentid[body])
    return frozenset(bodies)

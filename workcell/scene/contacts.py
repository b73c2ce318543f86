"""What may touch: hands and what they hold, meetings of jobs, and the names of their exemptions.

Decided here once, for the controller, the final check and whoever judges a run. Roles are in
`addresses.py`: an arm with jobs is a support arm, one with an operator a priority arm.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scenario import Exchange, Fetch, Meet, Put
from workcell.scene.addresses import ArmAddresses, InstrumentAddresses
from workcell.scene.cell import Cell
from workcell.scene.hand import tool_body

HAND_BODIES = 3
"""The tool's body and the two links before it: what holds an instrument is not watched against it."""


def hand_bodies(model: mujoco.MjModel, arm: ArmAddresses) -> frozenset[int]:
    """The tool's body and the links right before it, as body ids; links without anything to touch with do not count."""
    bodies, body = [], int(model.site_bodyid[arm.tool_site])
    first, moved = tool_body(model, arm), 0
    while body and moved < HAND_BODIES:
        bodies.append(body)
        moved += bool(model.body_jntnum[body]) and (moved > 0 or body <= first)
        body = int(model.body_parentid[body])
    return frozenset(bodies)


def hands(cell: Cell) -> dict[str, list[int]]:
    """Watched pairs of an instrument with an arm's own hand, by `instrument=arm`: they do not count while it holds it."""
    bodies = {arm.name: hand_bodies(cell.model, arm) for arm in cell.arms}
    found: dict[str, list[int]] = {}
    for k, (geoms, owners) in enumerate(zip(cell.pairs.geoms, cell.pairs.owners, strict=True)):
        item, arm = owners
        if arm in bodies and item not in bodies and cell.model.geom_bodyid[geoms[1]] in bodies[arm]:
            found.setdefault(f"{item}={arm}", []).append(k)
    return found


def person_pairs(cell: Cell) -> list[int]:
    """Pairs that only people answer for: arms they drive, with themselves, each other or what stands."""
    driven = {arm.name for arm in cell.arms if not arm.support}
    return [
        k
        for k, owners in enumerate(cell.pairs.owners)
        if all(owner is None or owner in driven for owner in owners)
    ]


def window_name(arm: str, partner: str) -> str:
    """The final check's exemption for what an arm's job brings to another arm, or to an instrument that lies."""
    return f"{arm}_{partner}"


def meeting_pairs(cell: Cell) -> list[tuple[str, str]]:
    """Watched pairs that some job brings together on purpose: tools that meet, and instruments with the hands they pass through."""
    tools = {arm.name: tool_body(cell.model, arm) for arm in cell.arms}
    meetings: list[set[str]] = []
    for arm in cell.scenario.arm:
        for job in arm.job:
            if isinstance(job, Meet):
                meetings.append({arm.name, job.arm})
            elif isinstance(job, Exchange):
                meetings += [{arm.name, job.instrument}, {job.arm, job.instrument}]
            elif isinstance(job, (Fetch, Put)):
                meetings.append({arm.name, job.instrument})
    return [
        names
        for (g, h), names, owners in zip(
            cell.pairs.geoms, cell.pairs.names, cell.pairs.owners, strict=True
        )
        if set(owners) in meetings
        and all(
            o not in tools or cell.model.geom_bodyid[x] == tools[o]
            for x, o in zip((g, h), owners, strict=True)
        )
    ]


def as_slice(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """The same entries as a slice where they follow one another, which takes no copy."""
    first, count = int(indices[0]), len(indices)
    return slice(first, first + count) if (np.diff(indices) == 1).all() else indices


class CarriedMotion:
    """How an instrument's free joint moves with the arm that holds it, as one rigid body.

    Args:
        model: The scene.
    """

    def __init__(self, model: mujoco.MjModel):
        self._model = model
        self._columns: dict[str, slice | NDArray[np.intp]] = {}
        self._jacobian = np.empty((6, model.nv))
        self._rotation = np.empty(9)

    def per_joint(
        self, data: mujoco.MjData, item: InstrumentAddresses, arm: ArmAddresses
    ) -> NDArray[np.float64]:
        """(6, n) velocities of the free joint for each joint velocity of the arm; good until the next call.

        Needs current kinematics.
        """
        model, jacobian, rotation = self._model, self._jacobian, self._rotation
        body = model.site_bodyid[arm.tool_site]
        position = data.qpos[item.qpos : item.qpos + 3]
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], position, body)
        mujoco.mju_quat2Mat(rotation, data.qpos[item.qpos + 3 : item.qpos + 7])
        follow = jacobian[:, self.columns(arm)]
        # A free joint turns in its own frame and moves in the world's.
        follow[3:] = rotation.reshape(3, 3).T @ follow[3:]
        return follow

    def columns(self, arm: ArmAddresses) -> slice | NDArray[np.intp]:
        """Where an arm's joints are in a joint velocity of the whole cell."""
        found = self._columns.get(arm.name)
        if found is None:
            found = self._columns[arm.name] = as_slice(arm.dofs)
        return found

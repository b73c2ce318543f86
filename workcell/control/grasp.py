"""Who holds which instrument, and what follows for motion and for the watched pairs.

A held instrument moves with the tool as one rigid body: its pose is carried along, and the columns
of G that belong to its free joint are folded onto the joints of the arm that holds it. It counts as
part of that arm from the tick it is taken: pairs with its own hand are switched off, pairs with
everything else are the holder's to keep apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.addresses import ArmAddresses, InstrumentAddresses
from workcell.scene.cell import Cell
from workcell.scene.contacts import hand_bodies


@dataclass(frozen=True)
class _Grasp:
    arm: ArmAddresses
    position_m: NDArray[np.float64]
    """(3,) of the instrument in the tool frame."""
    wxyz: NDArray[np.float64]
    """(4,)"""
    dofs: slice | NDArray[np.intp]
    """Of the arm, into qvel: a slice, which takes no copy, where they follow one another."""


class Grasps:
    """The instruments of a cell and the arms that hold them.

    Args:
        cell: The cell.
        data: At home, after `mj_kinematics`: where instruments held from the start are gripped.
    """

    def __init__(self, cell: Cell, data: mujoco.MjData):
        self._cell = cell
        self._arms = {arm.name: arm for arm in cell.arms}
        self._items = {item.name: item for item in cell.instruments}
        self._held: dict[str, _Grasp] = {}
        self._hands = {arm.name: hand_bodies(cell.model, arm) for arm in cell.arms}
        self._jacobian = np.empty((6, cell.model.nv))
        self._rotation = np.empty(9)
        """Rewritten at every call: of the place of a held instrument, and of the instrument."""
        self.holders: dict[str, str | None] = {}
        """For every instrument the arm that holds it, None where it lies; another dict after every change."""
        self._summary = ""
        self._tell()
        for item in cell.instruments:
            if item.held_by is not None:
                self.take(item.name, item.held_by, data)

    def holder(self, instrument: str) -> str | None:
        """Name of the arm that holds an instrument; None where it lies."""
        grasp = self._held.get(instrument)
        return None if grasp is None else grasp.arm.name

    def holding(self, arm: str) -> str | None:
        """Name of the instrument an arm holds."""
        return next((name for name, grasp in self._held.items() if grasp.arm.name == arm), None)

    def summary(self) -> str:
        """Who holds what, for the log: `scalpel=nurse clamp=`."""
        return self._summary

    def take(self, instrument: str, arm: str, data: mujoco.MjData) -> None:
        """From now on the arm holds the instrument, where it is now."""
        item, addresses = self._items[instrument], self._arms[arm]
        pose = data.qpos[item.qpos : item.qpos + 7].copy()
        position, wxyz = np.empty(3), np.empty(4)
        tool_position, tool_wxyz = _tool_pose(data, addresses)
        back_position, back_wxyz = np.empty(3), np.empty(4)
        mujoco.mju_negPose(back_position, back_wxyz, tool_position, tool_wxyz)
        mujoco.mju_mulPose(position, wxyz, back_position, back_wxyz, pose[:3], pose[3:])
        self._held[instrument] = _Grasp(addresses, position, wxyz, _as_slice(addresses.dofs))
        self._tell()

    def let_go(self, instrument: str) -> None:
        """From now on nobody holds the instrument; it stays where it is."""
        del self._held[instrument]
        self._tell()

    def carry(self, data: mujoco.MjData) -> None:
        """Put every held instrument where its tool is, at rest against it; needs current kinematics.

        An instrument that nobody holds lies still.
        """
        for name, item in self._items.items():
            if name not in self._held:
                data.qvel[item.dof : item.dof + 6] = 0.0
        for name, grasp in self._held.items():
            item = self._items[name]
            tool_position, tool_wxyz = _tool_pose(data, grasp.arm)
            mujoco.mju_mulPose(
                data.qpos[item.qpos : item.qpos + 3],
                data.qpos[item.qpos + 3 : item.qpos + 7],
                tool_position,
                tool_wxyz,
                grasp.position_m,
                grasp.wxyz,
            )
            data.qvel[item.dof : item.dof + 6] = (
                self._follow(data, item, grasp) @ data.qvel[grasp.dofs]
            )

    def fold(self, data: mujoco.MjData, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
        """G (P, nv) with held instruments as part of their arms, and lying ones as part of the world."""
        if not self._items:
            return jacobian
        folded = jacobian.copy()
        for name, item in self._items.items():
            own = slice(item.dof, item.dof + 6)
            grasp = self._held.get(name)
            if grasp is not None:
                folded[:, grasp.dofs] += folded[:, own] @ self._follow(data, item, grasp)
            folded[:, own] = 0.0
        return folded

    def parties(self, pair: int) -> tuple[str, ...]:
        """The arms whose motion changes a pair; empty for a pair that is switched off now.

        Off are: an instrument against the hand that holds it, and pairs without any arm.
        """
        names = []
        for geom, owner in zip(
            self._cell.pairs.geoms[pair], self._cell.pairs.owners[pair], strict=True
        ):
            arm = self.holder(owner) if owner in self._items else owner
            if arm is not None:
                names.append((arm, int(geom), owner in self._items))
        if len(names) == 2 and names[0][0] == names[1][0] and any(item for *_, item in names):
            arm = names[0][0]
            others = [geom for _, geom, item in names if not item]
            if not others or self._cell.model.geom_bodyid[others[0]] in self._hands[arm]:
                return ()
        return tuple(dict.fromkeys(arm for arm, *_ in names))

    def can_move(self, pair: int, arm: str) -> bool:
        """Whether an arm's joints change a pair: its own base stands, whatever it does."""
        model = self._cell.model
        return any(
            (self.holder(owner) if owner in self._items else owner) == arm
            and model.body_weldid[model.geom_bodyid[geom]] != 0
            for geom, owner in zip(
                self._cell.pairs.geoms[pair], self._cell.pairs.owners[pair], strict=True
            )
        )

    def part_of_hand(self, geom: int, arm: str) -> bool:
        """Whether a geom is on the arm's tool or is the instrument it holds."""
        tool = self._cell.model.site_bodyid[self._arms[arm].tool_site]
        held = self.holding(arm)
        return self._cell.model.geom_bodyid[geom] == tool or (
            held is not None and geom == self._items[held].geom
        )

    def _follow(
        self, data: mujoco.MjData, item: InstrumentAddresses, grasp: _Grasp
    ) -> NDArray[np.float64]:
        """(6, n): the velocities of the instrument's free joint per joint velocity of the arm that holds it.

        Good until the next call.
        """
        model, jacobian, rotation = self._cell.model, self._jacobian, self._rotation
        body = model.site_bodyid[grasp.arm.tool_site]
        position = data.qpos[item.qpos : item.qpos + 3]
        mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], position, body)
        mujoco.mju_quat2Mat(rotation, data.qpos[item.qpos + 3 : item.qpos + 7])
        follow = jacobian[:, grasp.dofs]
        # A free joint turns in its own frame and moves in the world's.
        follow[3:] = rotation.reshape(3, 3).T @ follow[3:]
        return follow

    def _tell(self) -> None:
        """Say anew who holds what: asked every tick, changed a few times a run."""
        self.holders = {name: self.holder(name) for name in self._items}
        self._summary = " ".join(f"{name}={arm or ''}" for name, arm in self.holders.items())


def _as_slice(indices: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """The same entries as a slice where they follow one another."""
    first, count = int(indices[0]), len(indices)
    return slice(first, first + count) if (np.diff(indices) == 1).all() else indices


def _tool_pose(
    data: mujoco.MjData, arm: ArmAddresses
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    wxyz = np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[arm.tool_site])
    return data.site_xpos[arm.tool_site], wxyz

"""Where the plant has the instruments: carried rigidly by the hand that holds them, or lying still.

An instrument's weight is too small to be felt by an arm, so its pose is set and not computed from forces.
A hand that closes takes the instrument where it is: what the controller believes of its pose plays no part.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.addresses import ArmAddresses, InstrumentAddresses
from workcell.scene.cell import Cell
from workcell.scene.contacts import CarriedMotion


@dataclass(frozen=True, slots=True)
class _Held:
    arm: ArmAddresses
    position_m: NDArray[np.float64]
    """(3,) of the instrument in the tool frame."""
    wxyz: NDArray[np.float64]
    """(4,)"""


class Instruments:
    """The instruments of one plant.

    Args:
        cell: The cell.
        data: The plant at home, after `mj_kinematics`: where instruments held from the start are gripped.
    """

    def __init__(self, cell: Cell, data: mujoco.MjData):
        self._arms = {arm.name: arm for arm in cell.arms}
        self._items = {item.name: item for item in cell.instruments}
        self._model = cell.model
        self._carried = CarriedMotion(cell.model)
        self._held: dict[str, _Held] = {}
        self._holders: Mapping[str, str | None] = {}
        self.follow({item.name: item.held_by for item in cell.instruments}, data)

    def follow(self, holders: Mapping[str, str | None], data: mujoco.MjData) -> None:
        """Open and close hands so that the instruments are held as told; needs current kinematics.

        Args:
            holders: For every instrument the arm that is to hold it, None where it is to lie. A mapping
                that has been followed is not looked at again.
            data: The plant.
        """
        if holders is self._holders:
            return
        for name, arm in holders.items():
            held = self._held.get(name)
            if arm is None:
                self._held.pop(name, None)
            elif held is None or held.arm.name != arm:
                self._held[name] = self._grip(self._items[name], self._arms[arm], data)
        self._holders = holders

    def carry(self, data: mujoco.MjData) -> None:
        """Put every held instrument where its tool is, at rest against it; one that nobody holds lies still."""
        if not self._items:
            return
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        for name, item in self._items.items():
            if name not in self._held:
                data.qvel[item.dof : item.dof + 6] = 0.0
        for name, held in self._held.items():
            item = self._items[name]
            tool_position, tool_wxyz = _tool_pose(data, held.arm)
            mujoco.mju_mulPose(
                data.qpos[item.qpos : item.qpos + 3],
                data.qpos[item.qpos + 3 : item.qpos + 7],
                tool_position,
                tool_wxyz,
                held.position_m,
                held.wxyz,
            )
            per_joint = self._carried.per_joint(data, item, held.arm)
            arm_qvel = data.qvel[self._carried.columns(held.arm)]
            data.qvel[item.dof : item.dof + 6] = per_joint @ arm_qvel

    def _grip(self, item: InstrumentAddresses, arm: ArmAddresses, data: mujoco.MjData) -> _Held:
        """The instrument as it lies in the hand now."""
        pose = data.qpos[item.qpos : item.qpos + 7].copy()
        position, wxyz = np.empty(3), np.empty(4)
        back_position, back_wxyz = np.empty(3), np.empty(4)
        mujoco.mju_negPose(back_position, back_wxyz, *_tool_pose(data, arm))
        mujoco.mju_mulPose(position, wxyz, back_position, back_wxyz, pose[:3], pose[3:])
        return _Held(arm, position, wxyz)


def _tool_pose(
    data: mujoco.MjData, arm: ArmAddresses
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    wxyz = np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[arm.tool_site])
    return data.site_xpos[arm.tool_site], wxyz

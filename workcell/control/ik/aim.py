"""What is asked of one arm's tool: a target and a state -> rows J q̇ = rates, and the smallest joint motion that does it.

The arithmetic is `laws.tool_task`.
"""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.ik.mink_tasks import ToolTask
from workcell.control.laws import tool_task
from workcell.motion.orientation import pointing, turned_towards
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.scene.addresses import ArmAddresses

Array = NDArray[np.float64]

DIRECTIONS = {"pose": 6, "axis": 5, "position": 3}
"""How many of the tool's six directions each task asks for: position first, the turn about the tool's own axis last."""


class ToolAim:
    """The tool task of one arm.

    Args:
        arm: Its addresses and limits.
        dt_s: Control period.
        task_gain_per_s: Rate at which tool errors are corrected.
    """

    def __init__(self, arm: ArmAddresses, *, dt_s: float, task_gain_per_s: float):
        n = len(arm.dofs)
        self.arm = arm
        self.dt_s = dt_s
        self.tool = ToolTask(arm.tool_site_name, gain_per_s=task_gain_per_s, dt_s=dt_s)
        self.tool_rows, self.tool_rates = np.zeros((6, n)), np.zeros(6)
        """(6, n) and (6,) what the last `aim` asks of the tool: rows q̇ = rates, of which the first `tool_count` count."""
        self.tool_count = 6
        """How many of the tool's six the last `aim` has asked for."""
        self.directions = 6
        """The same as its task has them; a free rotation leaves out one more of a pose."""
        self.tool_error = (0.0, 0.0)
        """How far the tool was from its target then, m and rad."""
        self.path_rad_s = np.zeros(n)
        """(n,) the part of the last `aim` that the target's own motion asks for, corrections of the tool error aside."""
        self._pose = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(3)
        self._gram, self._solved = np.zeros((6, 6)), np.zeros((2, 6))
        self._configuration: mink.Configuration | None = None
        self._frames: tuple[Any, ...] = ()
        self.qpos = np.zeros(0)
        """Joint positions of the configuration last taken."""

    def take(self, configuration: mink.Configuration) -> None:
        """Use this configuration; its arrays never move, so they are asked for once."""
        if configuration is self._configuration:
            return
        model, data, arm = configuration.model, configuration.data, self.arm
        bodies, to_tool = model.dof_bodyid[arm.dofs], []
        body = int(model.site_bodyid[arm.tool_site])
        while body:
            to_tool.append(body)
            body = int(model.body_parentid[body])
        self._configuration, self.qpos = configuration, data.qpos
        self._frames = (
            data.site_xpos, data.site_xmat, data.cdof, data.subtree_com, arm.tool_site,
            np.ascontiguousarray(arm.dofs, dtype=np.int64),
            model.body_rootid[bodies].astype(np.int64), np.isin(bodies, to_tool),
        )  # fmt: skip

    def aim(
        self,
        configuration: mink.Configuration,
        target: Target,
        *,
        catch_up_m_s: float = np.inf,
        free_rotation: bool = False,
        task: str = "pose",
    ) -> Array:
        """Take this tick's target and state.

        Args:
            configuration: The state.
            target: Where the tool should be and how it should move.
            catch_up_m_s: Largest speed at which a tool error is made good, turning counted as length.
            free_rotation: Leave the rotation about the tool's own axis to the null space.
            task: What of the target's pose is asked for; a key of `DIRECTIONS`.

        Returns:
            (n,) the smallest joint velocity that gives the tool its wanted twist, limits aside.

        Raises:
            FloatingPointError: The target or the state is not finite.
        """
        self.take(configuration)
        position, wxyz, velocity, turn = self._pose
        position[...], wxyz[...] = target.position_m, target.wxyz
        velocity[...], turn[...] = target.velocity_m_s, target.angular_velocity_rad_s
        self.directions = DIRECTIONS[task]
        self.tool_count = min(self.directions, 5 if free_rotation else 6)
        if task != "pose":
            wxyz[...] = self._nearest_turn(target.wxyz, task)
        whole, path = np.empty((2, len(self.path_rad_s)))
        code, error_m, error_rad = tool_task.tool_task(
            *self._frames, *self._pose, self.tool.gain, self.dt_s, float(catch_up_m_s),
            TURN_LENGTH_M_PER_RAD, self.tool_count, self.tool_rows, self.tool_rates,
            self._gram, self._solved, whole, path,
        )  # fmt: skip
        if code != tool_task.FINE:
            what = "target" if code == tool_task.TARGET_NOT_FINITE else "Jacobian"
            raise FloatingPointError(
                f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite, in the tool's {what}"
            )
        self.tool_error = error_m, error_rad
        self.path_rad_s = path
        return whole

    def _nearest_turn(self, wxyz: Array, task: str) -> Array:
        """(4,) of all orientations that a task allows the one nearest to the tool's: nothing turns for what is not asked."""
        now = np.empty(4)
        mujoco.mju_mat2Quat(now, self._frames[1][self.arm.tool_site])
        return now if task == "position" else turned_towards(now, pointing(now), pointing(wxyz))

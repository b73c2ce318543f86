"""The parts of the inverse kinematics as mink's tasks and limits, for any mink `Configuration`.

`mink.solve_ik` with them gives the velocities of `ArmIk`, which assembles the same program for one arm's joints
alone. The time-to-collision limit takes the place of mink's own collision limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import mink
import mujoco
import numpy as np
from mink.limits.limit import Constraint
from mink.tasks.task import BaseTask, Objective
from numpy.typing import NDArray

from workcell.control.criteria import CRITERIA, NullspaceObjective, objective
from workcell.control.finite import at_least_zero, joint_indices, positive
from workcell.control.laws.joint_limits import joint_box
from workcell.control.laws.pair_rule import smallest_rates
from workcell.control.proximity import PairGeometry, Proximity
from workcell.errors import InputError, did_you_mean
from workcell.motion.path import Target
from workcell.scene.addresses import ArmAddresses

TASK_COST = 1e3
"""Weight of the tool task where it cannot be an equality, against 1 for the motion of the joints: the
tool then gives way by about 1e-6 of what the criterion asks for."""


class ToolTask(mink.FrameTask):
    """mink's frame task with the target's own velocity fed forward, and one rotation axis optional.

    Args:
        site: Full name of the tool site.
        gain_per_s: Rate at which a tool error is corrected.
        dt_s: Control period.
    """

    def __init__(self, site: str, *, gain_per_s: float, dt_s: float):
        self._next: Target | None = None
        super().__init__(
            site,
            "site",
            position_cost=TASK_COST,
            orientation_cost=TASK_COST,
            gain=min(1.0, gain_per_s * dt_s),
        )
        self._dt_s = dt_s
        self._twist = np.zeros(6)

    def follow(self, target: Target) -> None:
        """Set pose and twist of the target, both in the world frame; worked out once they are asked for."""
        self._next = target

    @property
    def transform_target_to_world(self) -> mink.SE3 | None:
        """mink's name for the target's pose."""
        self._take_over()
        return self._pose

    @transform_target_to_world.setter
    def transform_target_to_world(self, pose: mink.SE3 | None) -> None:
        self._take_over()  # the twist stays what it was
        self._pose = pose

    def _take_over(self) -> None:
        """Work out what `follow` was given last."""
        target, self._next = self._next, None
        if target is None:
            return
        self._pose = mink.SE3(np.concatenate([target.wxyz, target.position_m]))
        back = np.empty(4)
        mujoco.mju_negQuat(back, target.wxyz)
        mujoco.mju_rotVecQuat(self._twist[:3], target.velocity_m_s, back)
        mujoco.mju_rotVecQuat(self._twist[3:], target.angular_velocity_rad_s, back)

    def compute_error(self, configuration: mink.Configuration) -> NDArray[np.float64]:
        """mink's body twist from the tool to its target, plus what the target moves within this step."""
        return super().compute_error(configuration) + self._ahead()

    def _error_and_jacobian(
        self, configuration: mink.Configuration
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        error, jacobian = super()._error_and_jacobian(configuration)
        return error + self._ahead(), jacobian

    def _ahead(self) -> NDArray[np.float64]:
        # mink multiplies the error by the gain; dividing here leaves the fed-forward twist whole.
        self._take_over()
        return self._twist * (self._dt_s / self.gain)


class CriterionTask(BaseTask):
    """The null-space criterion and the wish for little motion, as a quadratic cost in q̇.

    Given a geometry it measures the pairs on the configuration's data, rates from its `qvel`; without one its
    `objective` is set from outside, as the controller does. Put the tool's task beside it as a constraint or
    with a weight far above 1.

    Args:
        dofs: (n,) indices of the arm's joints in the tangent space.
        nv: Size of the tangent space.
        dt_s: Control period, > 0.
        gain: Weight of the criterion against ½|q̇|², >= 0.
        geometry: Pairs to be measured; those that none of the joints moves count nothing.
        criterion: One of `criteria.CRITERIA`, for a geometry.

    Raises:
        InputError: A value is out of range.
    """

    def __init__(
        self,
        dofs: Sequence[int] | NDArray[np.intp],
        *,
        nv: int,
        dt_s: float,
        gain: float,
        geometry: PairGeometry | None = None,
        criterion: str = "artc",
    ):
        self.dofs = joint_indices(dofs, nv)
        self.gain = at_least_zero("gain", gain)
        self.geometry = geometry
        if criterion not in CRITERIA:
            raise InputError(
                f"criterion is {criterion!r}; allowed: {', '.join(CRITERIA)}"
                + did_you_mean(str(criterion), CRITERIA)
            )
        self.criterion = criterion
        self._dt_s = positive("dt_s", dt_s)
        self._eye = np.zeros((nv, nv))
        self._eye[self.dofs, self.dofs] = 1.0
        self.objective: NullspaceObjective | None = None

    def compute_qp_objective(self, configuration: mink.Configuration) -> Objective:
        """Objective in Δq = q̇ dt, scaled by dt² so that it compares with ½|Δq|²."""
        wanted = self.objective
        if self.geometry is not None:
            wanted = self._of(measured(self.geometry, configuration), configuration)
        H, c = self._eye.copy(), np.zeros(len(self._eye))
        if wanted is not None and self.gain > 0.0:
            H[np.ix_(self.dofs, self.dofs)] += self.gain * wanted.hessian
            c[self.dofs] += self.gain * self._dt_s * wanted.linear
        return Objective(H, c)

    def _of(self, found: Proximity, configuration: mink.Configuration) -> NullspaceObjective:
        """The objective of the pairs that the arm moves."""
        qvel, own = np.array(configuration.data.qvel), found.jacobian[:, self.dofs]
        moved = np.flatnonzero(own.any(axis=1))
        others = qvel.copy()
        others[self.dofs] = 0.0
        return objective(
            self.criterion,
            found.distance_m[moved],
            found.rate_m_s(qvel)[moved],
            own[moved],
            other_rate_m_s=found.rate_m_s(others)[moved],
        )


class JointLimit(mink.Limit):
    """Position, velocity and acceleration limits of an arm as one box on Δq, never empty (`laws.joint_limits`)."""

    def __init__(self, arm: ArmAddresses, *, nv: int):
        self.arm = arm
        self.previous_rad_s = np.zeros(len(arm.dofs))
        """(n,) last commanded velocity, from which the acceleration counts."""
        n = len(arm.dofs)
        self._rows = np.zeros((2 * n, nv))
        self._rows[np.arange(n), arm.dofs] = 1.0
        self._rows[np.arange(n, 2 * n), arm.dofs] = -1.0

    def bounds(
        self, q_rad: NDArray[np.float64], dt_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) smallest and largest joint velocity; see `laws.joint_limits`.

        Raises:
            FloatingPointError: A joint's position or last velocity is not finite.
        """
        arm, n = self.arm, len(self.arm.dofs)
        smallest, largest = np.empty(n), np.empty(n)
        bad = joint_box(
            np.array(q_rad), np.arange(n), arm.lower_rad, arm.upper_rad, arm.velocity_limit_rad_s,
            arm.acceleration_limit_rad_s2, np.array(self.previous_rad_s), dt_s, smallest, largest,
        )  # fmt: skip
        if bad >= 0:
            raise FloatingPointError(
                f"joint {arm.joints[bad]} of arm {arm.name}: its position {q_rad[bad]} or its last velocity "
                f"{self.previous_rad_s[bad]} is not finite"
            )
        return smallest, largest

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        """Rows ±1 on the arm's joints."""
        low, high = self.bounds(configuration.data.qpos[self.arm.qpos], dt)
        return Constraint(G=self._rows, h=np.concatenate([high, -low]) * dt)


class TtcLimit(mink.Limit):
    """Keeps t = -d/ḋ >= t_min on watched pairs, row by row (`laws.pair_rule`).

    Used by itself it measures the pairs on the configuration's data; the controller hands it the
    rows it has measured already, with bounds that take the other arms' motion into account.

    Args:
        geometry: The watched pairs.
        t_min_s: Smallest time to collision allowed, > 0.
        standoff_m: Distance the time is counted to, >= 0.

    Raises:
        InputError: A value is out of range.
    """

    def __init__(
        self, geometry: PairGeometry | None = None, *, t_min_s: float, standoff_m: float = 0.0
    ):
        self.geometry = geometry
        self.t_min_s = positive("t_min_s", t_min_s)
        self.standoff_m = at_least_zero("standoff_m", standoff_m)
        self._given: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def give(self, jacobian: NDArray[np.float64], smallest_rate_m_s: NDArray[np.float64]) -> None:
        """Use these rows G q̇ >= bound instead of measuring; (R, nv) and (R,).

        Raises:
            InputError: They are of other shapes.
        """
        rows, bound = np.asarray(jacobian, dtype=float), np.asarray(smallest_rate_m_s, dtype=float)
        if rows.ndim != 2 or bound.shape != rows.shape[:1]:
            raise InputError(
                f"jacobian has shape {rows.shape} and smallest_rate_m_s {bound.shape}; allowed is (R, nv) and (R,)"
            )
        self._given = rows, bound

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        """-G Δq <= -bound dt."""
        if self._given is not None:
            jacobian, bound = self._given
        elif self.geometry is not None:
            found = measured(self.geometry, configuration)
            jacobian, bound = found.jacobian, np.empty(len(found.distance_m))
            others_stand = np.zeros(len(bound))
            smallest_rates(found.distance_m, others_stand, self.t_min_s, self.standoff_m, bound)
        else:
            raise ValueError("TtcLimit needs either a PairGeometry or rows given beforehand")
        if not len(bound):
            return Constraint()
        return Constraint(G=-jacobian, h=-bound * dt)


def measured(geometry: PairGeometry, configuration: mink.Configuration) -> Proximity:
    """The pairs at a configuration.

    Raises:
        InputError: The pairs are of another model.
    """
    if geometry.model is not configuration.model:
        raise InputError(
            "the pairs are of another model than the configuration; watch the model that the Configuration was made from"
        )
    if geometry.has_sensors:
        mujoco.mj_sensorPos(configuration.model, configuration.data)
    return geometry.measure(configuration.data)

"""Inverse kinematics of one arm: tool twist and null-space criterion -> joint velocities.

One quadratic program an arm, in q̇ of the arm's own joints, so that a solver's tolerance means radians a second:

    minimise  ½ q̇ᵀ H q̇ + cᵀ q̇        (least motion plus the null-space criterion)
    subject to  J q̇ = tool twist       (the tool is never traded for the null space)
                position, velocity and acceleration limits
                ḋ >= bound              (the time-to-collision inequality on self-motion)

When it has no solution, weaker programs follow in a fixed order, and the answer says which one it came from.
What the tool is asked for is `aim.py`; the arithmetic is `laws.joint_limits` and `laws.program`.
"""

from __future__ import annotations

from typing import NamedTuple

import mink
import numpy as np
from mink.tasks.task import BaseTask
from numpy.typing import NDArray

from workcell.control.criteria import NullspaceObjective
from workcell.control.ik.aim import ToolAim
from workcell.control.ik.mink_tasks import CriterionTask, JointLimit, TtcLimit
from workcell.control.ik.qp import SOLVER_TOLERANCE_RAD_S, ProgramSpace
from workcell.control.laws import joint_limits, program
from workcell.scene.addresses import ArmAddresses

Array = NDArray[np.float64]

SOFT_TASK_COST = 50.0
"""Weight of the tool task where the tool has to give way to the joint limits: a direction in which a metre a second takes the
joints more than 50 rad/s is let go, so that an arm at the end of its reach does not thrash; others lose 0.2 %."""

LEAST_PULL = 1e-6
"""Weight of standing still against missing a row, where rows alone are to decide."""

OPTIMAL = "optimal"
TASK_ONLY = "task_only"
TASK_SOFT = "task_soft"
STOPPED = "stopped"


class IkSolution(NamedTuple):
    """Joint velocities of one arm."""

    velocity_rad_s: Array
    """(n,)"""
    status: str
    """`optimal`, or the fallback that answered: `task_only` (no self-motion), `task_soft` (the tool gives way), `stopped`."""


class ArmIk(ToolAim):
    """The inverse kinematics of one arm.

    `tasks`, `limits` and `constraints` are what defines it: `mink.solve_ik` with them gives the same
    velocities. `solve` assembles the same program for the arm's own joints alone, in q̇, so that a
    solver's tolerance means radians a second, and each task is evaluated once a tick.

    Args:
        arm: Its addresses and limits.
        nv: Size of the model's tangent space.
        dt_s: Control period.
        task_gain_per_s: Rate at which tool errors are corrected.
        criterion_gain: Weight of the null-space criterion.
    """

    def __init__(
        self,
        arm: ArmAddresses,
        *,
        nv: int,
        dt_s: float,
        task_gain_per_s: float,
        criterion_gain: float,
    ):
        super().__init__(arm, dt_s=dt_s, task_gain_per_s=task_gain_per_s)
        n = len(arm.dofs)
        self.criterion = CriterionTask(arm.dofs, nv=nv, dt_s=dt_s, gain=criterion_gain)
        self.limit = JointLimit(arm, nv=nv)
        self.ttc = TtcLimit(t_min_s=1.0)
        self.space = ProgramSpace(n)
        """Where its programs are written."""
        self.joints: tuple[Array, ...] = tuple(
            np.ascontiguousarray(values, dtype=kind)
            for values, kind in (
                (arm.qpos, np.int64),
                (arm.lower_rad, float),
                (arm.upper_rad, float),
                (arm.velocity_limit_rad_s, float),
                (arm.acceleration_limit_rad_s2, float),
            )
        )
        """(n,) where they are in qpos, their ranges, their speed and acceleration limits."""
        self._before, self._wanted = np.zeros(n), np.zeros(n)

    @property
    def tasks(self) -> list[BaseTask]:
        """The cost of the full program."""
        return [self.criterion]

    @property
    def constraints(self) -> list[mink.Task]:
        """Its equality."""
        return [self.tool]

    @property
    def limits(self) -> list[mink.Limit]:
        """Its inequalities."""
        return [self.limit, self.ttc]

    def solve(
        self,
        configuration: mink.Configuration,
        previous_rad_s: Array,
        objective: NullspaceObjective,
        rows: Array,
        smallest_rate_m_s: Array,
    ) -> IkSolution:
        """The first program, from the full one down, that has a finite solution within its limits.

        Args:
            configuration: The state `aim` was given.
            previous_rad_s: (n,) velocity from which the acceleration counts.
            objective: The null-space criterion.
            rows: (R, n) rows G of the pairs to be kept apart.
            smallest_rate_m_s: (R,) smallest rate allowed to each.

        Raises:
            FloatingPointError: an input is not finite; the solver itself would not say so.
        """
        space = self._boxed(configuration, previous_rad_s, rows, smallest_rate_m_s)
        space.H[...], space.c[...] = objective.hessian, objective.linear
        program.least_motion(self.criterion.gain, space.H, space.c)
        pairs = len(smallest_rate_m_s)
        if not self._constrain(pairs, program.HARD, self.tool_count):
            raise FloatingPointError(
                f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite"
            )
        return self.first_of(space.solve(pairs + self.tool_count), pairs)

    def first_of(self, velocity: Array | None, pairs: int) -> IkSolution:
        """The full program's solution (n,); without one, that of a weaker program with so many rows of pairs.

        Weaker are: no criterion and rows that may be missed; then a tool that gives way, too; then to stop.
        """
        if velocity is not None:
            return IkSolution(velocity, OPTIMAL)
        space, tool = self.space, self.tool_count
        space.H[...], space.c[...] = np.eye(space.n), 0.0
        if self._constrain(pairs, program.SOFT, tool):
            velocity = space.solve(pairs + tool)
        if velocity is not None:
            return IkSolution(velocity, TASK_ONLY)
        rows, rates = self.tool_rows[:tool], self.tool_rates[:tool]
        weighted = SOFT_TASK_COST**2 * rows.T
        space.H[...], space.c[...] = np.eye(space.n) + weighted @ rows, -weighted @ rates
        if self._constrain(pairs, program.SOFT, 0):
            velocity = space.solve(pairs)
        if velocity is not None:
            return IkSolution(velocity, TASK_SOFT)
        stopped = np.empty(space.n)
        joint_limits.settle(
            np.zeros(space.n), space.smallest, space.largest, SOLVER_TOLERANCE_RAD_S, stopped
        )
        return IkSolution(stopped, STOPPED)

    def predicted(
        self, configuration: mink.Configuration, previous_rad_s: Array, wanted_rad_s: Array
    ) -> tuple[Array, Array]:
        """(n,) and (n,) what the joints make of what the last `aim` asks for, after a previous velocity (n,).

        First joint by joint, then by the least motion within their limits that moves the tool as asked, which is the
        same where the limits cut nothing off.

        Raises:
            FloatingPointError: A number is not finite.
        """
        self.take(configuration)
        self._before[...], self._wanted[...] = previous_rad_s, wanted_rad_s
        space = self.space
        followed, settled = np.empty((2, space.n))
        code, joint, whole, answer = program.predicted_motion(
            self.qpos, *self.joints, self._before, self.dt_s, self._wanted, self.tool_rows,
            self.tool_rates, self.tool_count, space.rows, space.bounds, space.smallest,
            space.largest, space.H, space.c, space.lower, space.upper, space.sense, followed,
            *space.solver, SOLVER_TOLERANCE_RAD_S, settled,
        )  # fmt: skip
        self._refuse(joint)
        if code != program.FINE:
            raise FloatingPointError(
                f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite"
            )
        if whole:
            return followed, followed
        found = self.first_of(space.answered(answer, self.tool_count, settled), 0)
        return followed, found.velocity_rad_s

    def followed(
        self, configuration: mink.Configuration, previous_rad_s: Array, wanted_rad_s: Array
    ) -> Array:
        """(n,) what the joint limits let through of a wanted velocity (n,) after a previous one (n,).

        Raises:
            FloatingPointError: A number is not finite.
        """
        self.take(configuration)
        self._before[...], self._wanted[...] = previous_rad_s, wanted_rad_s
        allowed = np.empty(self.space.n)
        self._refuse(
            joint_limits.within_limits(
                self.qpos, *self.joints, self._before, self._wanted, self.dt_s, allowed
            )
        )
        return allowed

    def box(self, configuration: mink.Configuration, previous_rad_s: Array) -> tuple[Array, Array]:
        """(n,) and (n,) smallest and largest velocity of the joints after a previous one (n,)."""
        self.take(configuration)
        self._before[...] = previous_rad_s
        smallest, largest = np.empty(self.space.n), np.empty(self.space.n)
        self._refuse(
            joint_limits.joint_box(
                self.qpos, *self.joints, self._before, self.dt_s, smallest, largest
            )
        )
        return smallest, largest

    def evade(
        self,
        configuration: mink.Configuration,
        previous_rad_s: Array,
        preferred_rad_s: Array,
        rows: Array,
        smallest_rate_m_s: Array,
        hard: NDArray[np.bool_] | None = None,
    ) -> Array | None:
        """The motion nearest to a preferred one that opens what must open, the tool's task aside.

        The rows may be missed, as little as possible, where the joint limits leave no other way. Hard rows come first:
        they are missed only by what the joints cannot do at all, and never for the sake of the others.

        Args:
            configuration: The state.
            previous_rad_s: (n,) velocity from which the acceleration counts.
            preferred_rad_s: (n,) velocity to stay near to.
            rows: (R, n) rows G of the pairs.
            smallest_rate_m_s: (R,) rate each should have at least.
            hard: (R,) which rows come first; None where all are alike.

        Returns:
            (n,) joint velocity; None if the solver failed.

        Raises:
            FloatingPointError: A number is not finite.
        """
        space = self._boxed(configuration, previous_rad_s, rows, smallest_rate_m_s)
        space.H[...], space.c[...] = np.eye(space.n), np.negative(preferred_rad_s)
        if not self._constrain(len(smallest_rate_m_s), program.SOFT, 0):
            raise FloatingPointError(
                f"arm {self.arm.name}: the evasive motion was given a number that is not finite"
            )
        pairs = len(smallest_rate_m_s)
        velocity = None
        if hard is not None and hard.any():
            marks = space.sense[space.n : space.n + pairs]
            marks[hard] = program.HARD
            velocity = space.solve(pairs)
            if velocity is None:
                velocity = self._least_missed(preferred_rad_s, rows, smallest_rate_m_s, hard)
        if velocity is None:
            space.sense[space.n : space.n + pairs] = program.SOFT
            velocity = space.solve(pairs)
        return velocity

    def _least_missed(
        self, preferred_rad_s: Array, rows: Array, smallest_rate_m_s: Array, hard: NDArray[np.bool_]
    ) -> Array | None:
        """The same where the joints cannot keep every hard row: these are missed least, then the others."""
        space, pairs = self.space, len(smallest_rate_m_s)
        marks = space.sense[space.n : space.n + pairs]
        bounds = space.lower[space.n : space.n + pairs]
        marks[...] = program.SOFT
        bounds[~hard] = -program.UNBOUNDED
        # Alone, and pulled by nothing but the least miss: any preferred motion would be paid for with more of it.
        space.c[...] = 0.0
        space.H[...] = LEAST_PULL * np.eye(space.n)
        least = None if space.solve(pairs) is None else space.solver.x
        space.c[...], space.H[...] = np.negative(preferred_rad_s), np.eye(space.n)
        bounds[...] = smallest_rate_m_s
        if least is None:
            return None
        # Not as settled in the box: a hard row must be one that the solver itself can keep.
        within = rows[hard] @ least - 10.0 * SOLVER_TOLERANCE_RAD_S
        bounds[hard] = np.minimum(smallest_rate_m_s[hard], within)
        marks[hard] = program.HARD
        return space.solve(pairs)

    def _boxed(
        self,
        configuration: mink.Configuration,
        previous_rad_s: Array,
        rows: Array,
        smallest_rate_m_s: Array,
    ) -> ProgramSpace:
        """The space with the joint box and the pairs' rows written into it."""
        self.take(configuration)
        space, pairs = self.space, len(smallest_rate_m_s)
        space.reserve(pairs + 6)
        space.rows[:pairs], space.bounds[:pairs] = rows, smallest_rate_m_s
        self.limit.previous_rad_s = self._before
        self._before[...] = previous_rad_s
        self._refuse(
            joint_limits.joint_box(
                self.qpos, *self.joints, self._before, self.dt_s, space.smallest, space.largest
            )
        )
        return space

    def _constrain(self, pairs: int, mark: int, tool: int) -> bool:
        """Write the constraints of a program; false where a number is not finite."""
        space = self.space
        return program.constrain(
            space.H, space.c, space.smallest, space.largest, space.bounds, pairs, mark,
            self.tool_rows, self.tool_rates, tool, space.rows, space.lower, space.upper, space.sense,
        )  # fmt: skip

    def _refuse(self, joint: int) -> None:
        """Name the joint that a law has found not to be finite; -1 is none."""
        if joint >= 0:
            raise FloatingPointError(
                f"joint {self.arm.joints[joint]} of arm {self.arm.name}: its position or velocity is not finite"
            )

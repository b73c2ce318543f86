"""Inverse kinematics of one arm: tool twist and null-space criterion -> joint velocities.

One quadratic program an arm, in the displacement Δq = q̇ dt of the arm's own joints:

    minimise  ½ q̇ᵀ H q̇ + cᵀ q̇        (least motion plus the null-space criterion)
    subject to  J q̇ = tool twist       (the tool is never traded for the null space)
                position, velocity and acceleration limits
                ḋ >= bound              (the time-to-collision inequality on self-motion)

Defined by mink's and our tasks and limits, solved by daqp. When it has no solution a
written ladder of weaker programs follows, and the answer says which rung it came from. The tasks
and limits are usable with any mink `Configuration`. Where there is compiled code (`kernels`), the tool's
error and rows come from it, and in the controller the first program, too (`compiled.py`); mink's task and the NumPy code
here say what they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import daqp
import mink
import mujoco
import numpy as np
from mink.limits.limit import Constraint
from mink.tasks.task import BaseTask, Objective
from numpy.typing import ArrayLike, NDArray

from workcell.control.criteria import NullspaceObjective
from workcell.control.finite import all_finite
from workcell.control.kernels.arguments import DONE
from workcell.control.kernels.library import ArrayFunction, Bound, Kernels, kernels
from workcell.control.proximity import PairGeometry
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.scene.addresses import ArmAddresses

SOLVER_TOLERANCE_RAD_S = 1e-9
"""How far a constraint may be missed; far below what an encoder sees."""
_SOLVED, _SOLVED_SOFT = 1, 2  # daqp's exit flags: optimal; optimal with a soft constraint missed
_UNBOUNDED = 1e30  # daqp's infinity
_EQUALITY, _SOFT = 5, 8  # daqp's marks of constraints: met exactly; violated as little as need be
TASK_COST = 1e3
"""Weight of the tool task where it cannot be an equality, against 1 for the motion of the joints: the
tool then gives way by about 1e-6 of what the criterion asks for."""
SOFT_TASK_COST = 50.0
"""The same where the tool has to give way to the joint limits: a direction in which a metre a second takes the joints
more than 50 rad/s is let go, so that an arm at the end of its reach does not thrash; others lose 0.2 %."""
LEAST_MOTION_DAMPING = 1e-6
"""Regularises the least-norm solution near singular configurations; small against J Jᵀ of order 0.1."""

OPTIMAL = "optimal"
TASK_ONLY = "task_only"
TASK_SOFT = "task_soft"
STOPPED = "stopped"


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

    Args:
        dofs: (n,) indices of the arm's joints in the tangent space.
        nv: Size of the tangent space.
        dt_s: Control period.
        gain: Weight of the criterion against ½|q̇|².
    """

    def __init__(self, dofs: NDArray[np.intp], *, nv: int, dt_s: float, gain: float):
        self.dofs = dofs
        self.gain = gain
        self._dt_s = dt_s
        self._eye = np.zeros((nv, nv))
        self._eye[dofs, dofs] = 1.0
        self.objective: NullspaceObjective | None = None

    def compute_qp_objective(self, configuration: mink.Configuration) -> Objective:
        """Objective in Δq = q̇ dt, scaled by dt² so that it compares with ½|Δq|²."""
        H, c = self._eye.copy(), np.zeros(len(self._eye))
        if self.objective is not None and self.gain > 0.0:
            H[np.ix_(self.dofs, self.dofs)] += self.gain * self.objective.hessian
            c[self.dofs] += self.gain * self._dt_s * self.objective.linear
        return Objective(H, c)


class JointLimit(mink.Limit):
    """Position, velocity and acceleration limits of an arm as one box on Δq, never empty.

    The position bound is the speed from which the joint can still brake before its end stop, so it
    agrees with the acceleration bound; where they disagree all the same (a joint put beyond its
    range), the position bound wins.
    """

    def __init__(self, arm: ArmAddresses, *, nv: int):
        self.arm = arm
        self.previous_rad_s = np.zeros(len(arm.dofs))
        """(n,) last commanded velocity, from which the acceleration counts."""
        n = len(arm.dofs)
        self._ends = np.stack([-arm.lower_rad, arm.upper_rad])
        self._towards = np.array([[1.0], [-1.0]])
        self._rows = np.zeros((2 * n, nv))
        self._rows[np.arange(n), arm.dofs] = 1.0
        self._rows[np.arange(n, 2 * n), arm.dofs] = -1.0

    def bounds(
        self, q_rad: NDArray[np.float64], dt_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) smallest and largest joint velocity."""
        arm = self.arm
        speed = _approach(self._towards * q_rad + self._ends, arm, dt_s)
        np.minimum(speed, arm.velocity_limit_rad_s, out=speed)
        low, high = -speed[0], speed[1]
        step = arm.acceleration_limit_rad_s2 * dt_s
        return np.minimum(np.maximum(low, self.previous_rad_s - step), high), np.maximum(
            np.minimum(high, self.previous_rad_s + step), low
        )

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        """Rows ±1 on the arm's joints."""
        low, high = self.bounds(configuration.data.qpos[self.arm.qpos], dt)
        return Constraint(G=self._rows, h=np.concatenate([high, -low]) * dt)


class TtcLimit(mink.Limit):
    """Keeps t = -d/ḋ >= t_min on watched pairs: ḋ >= -d/t_min, row by row (theory: section 5).

    Used by itself it measures the pairs on the configuration's data; the controller hands it the
    rows it has measured already, with bounds that take the other arms' motion into account.

    Args:
        geometry: The watched pairs.
        t_min_s: Smallest time to collision allowed.
        standoff_m: Distance the time is counted to.
    """

    def __init__(
        self, geometry: PairGeometry | None = None, *, t_min_s: float, standoff_m: float = 0.0
    ):
        self.geometry = geometry
        self.t_min_s = t_min_s
        self.standoff_m = standoff_m
        self._given: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    def give(self, jacobian: NDArray[np.float64], smallest_rate_m_s: NDArray[np.float64]) -> None:
        """Use these rows G q̇ >= bound instead of measuring; (R, nv) and (R,)."""
        self._given = jacobian, smallest_rate_m_s

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> Constraint:
        """-G Δq <= -bound dt."""
        if self._given is not None:
            jacobian, bound = self._given
        elif self.geometry is not None:
            mujoco.mj_sensorPos(configuration.model, configuration.data)
            measured = self.geometry.measure(configuration.data)
            jacobian, bound = (
                measured.jacobian,
                (self.standoff_m - measured.distance_m) / self.t_min_s,
            )
        else:
            raise ValueError("TtcLimit needs either a PairGeometry or rows given beforehand")
        if not len(bound):
            return Constraint()
        return Constraint(G=-jacobian, h=-bound * dt)


@dataclass(frozen=True)
class IkSolution:
    """Joint velocities of one arm."""

    velocity_rad_s: NDArray[np.float64]
    """(n,)"""
    status: str
    """`optimal`, or the fallback that answered: `task_only` (no self-motion), `task_soft` (the tool gives way), `stopped`."""


class ArmIk:
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
        self.arm = arm
        self.dt_s = dt_s
        self.tool = ToolTask(arm.tool_site_name, gain_per_s=task_gain_per_s, dt_s=dt_s)
        self.criterion = CriterionTask(arm.dofs, nv=nv, dt_s=dt_s, gain=criterion_gain)
        self.limit = JointLimit(arm, nv=nv)
        self.ttc = TtcLimit(t_min_s=1.0)
        self._eye = np.eye(len(arm.dofs))
        self._tool_rows = np.zeros((6, len(arm.dofs)))
        self._tool_rates = np.zeros(6)
        self._program_space = _Space(len(arm.dofs))
        self._low = self._high = np.zeros(len(arm.dofs))
        self._at_work: CompiledIk | None = None
        self.aimed_by: CompiledIk | None = None
        """What the last `aim` was done by; None for NumPy."""
        self.tool_error = (0.0, 0.0)
        """How far the tool was from its target then, m and rad."""
        self.path_rad_s = np.zeros(len(arm.dofs))
        """(n,) the part of the last `aim` that the target's own motion asks for, corrections of the tool error aside."""

    @property
    def tool_rows(self) -> int:
        """How many of the tool's six the last `aim` has asked for."""
        return len(self._tool_rates)

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

    def aim(
        self,
        configuration: mink.Configuration,
        target: Target,
        *,
        catch_up_m_s: float = np.inf,
        free_rotation: bool = False,
    ) -> NDArray[np.float64]:
        """Take this tick's target and state.

        Args:
            configuration: The state.
            target: Where the tool should be and how it should move.
            catch_up_m_s: Largest speed at which a tool error is made good, turning counted as length.
            free_rotation: Leave the rotation about the tool's own axis to the null space.

        Returns:
            (n,) the smallest joint velocity that gives the tool its wanted twist, limits aside.
        """
        self.tool.follow(target)
        compiled = self.compiled(configuration)
        if compiled is not None:
            found = compiled.aim(target, self.tool.gain, self.dt_s, catch_up_m_s, free_rotation)
            if found is not None:
                self._tool_rows, self._tool_rates, whole, self.path_rad_s = found
                self.aimed_by = compiled
                self.tool_error = compiled.tool_error()
                return whole
        self.aimed_by = None
        self.tool_error = _tool_error(configuration, self.arm.tool_site, target)
        return self._aim(configuration, catch_up_m_s, free_rotation)

    def _aim(
        self, configuration: mink.Configuration, catch_up_m_s: float, free_rotation: bool
    ) -> NDArray[np.float64]:
        """`aim` by mink's task and NumPy."""
        error, jacobian = self.tool._error_and_jacobian(configuration)
        if not all_finite(error):
            raise FloatingPointError(
                f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite"
            )
        self._tool_rows = jacobian.take(self.arm.dofs, axis=1)
        ahead = self.tool._ahead()
        correction = (error - ahead) * (-self.tool.gain / self.dt_s)
        if catch_up_m_s < np.inf:
            x, y, z, *turn = correction.tolist()
            speed = math.hypot(x, y, z, TURN_LENGTH_M_PER_RAD * math.hypot(*turn))
            if speed > catch_up_m_s:
                correction *= catch_up_m_s / speed
        self._tool_rates = correction + ahead * (-self.tool.gain / self.dt_s)
        if free_rotation:
            self._tool_rows, self._tool_rates = self._tool_rows[:5], self._tool_rates[:5]
        gram = self._tool_rows @ self._tool_rows.T
        gram.ravel()[:: len(gram) + 1] += LEAST_MOTION_DAMPING
        path_rates = ahead[: len(self._tool_rates)] * (-self.tool.gain / self.dt_s)
        # The damping keeps the matrix positive definite, so that Cholesky's factor always exists.
        if mujoco.mju_cholFactor(gram, 0.0) < len(gram):
            raise FloatingPointError(f"arm {self.arm.name}: the tool's Jacobian is not finite")
        both = np.empty((2, len(gram)))
        mujoco.mju_cholSolve(both[0], gram, self._tool_rates)
        mujoco.mju_cholSolve(both[1], gram, path_rates)
        whole, self.path_rad_s = both @ self._tool_rows
        return whole

    def solve(
        self,
        configuration: mink.Configuration,
        previous_rad_s: NDArray[np.float64],
        objective: NullspaceObjective,
        rows: NDArray[np.float64],
        smallest_rate_m_s: NDArray[np.float64],
    ) -> IkSolution:
        """Descend the ladder until a program has a finite solution within its limits.

        Args:
            configuration: The state `aim` was given.
            previous_rad_s: (n,) velocity from which the acceleration counts.
            objective: The null-space criterion.
            rows: (R, n) rows G of the pairs to be kept apart.
            smallest_rate_m_s: (R,) smallest rate allowed to each.

        Raises:
            FloatingPointError: an input is not finite; the solver itself would not say so.
        """
        self.limit.previous_rad_s = previous_rad_s
        self._low, self._high = self.limit.bounds(configuration.data.qpos[self.arm.qpos], self.dt_s)
        gain = self.criterion.gain
        H, c = self._eye + gain * objective.hessian, gain * objective.linear
        for values in (
            self._tool_rows,
            self._tool_rates,
            self._low,
            self._high,
            H,
            c,
            rows,
            smallest_rate_m_s,
        ):
            if not all_finite(values):
                raise FloatingPointError(
                    f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite"
                )
        velocity, status = self._program(H, c, rows, smallest_rate_m_s, hard_tool=True), OPTIMAL
        if velocity is None:
            velocity, status = (
                self._program(
                    self._eye,
                    np.zeros_like(c),
                    rows,
                    smallest_rate_m_s,
                    hard_tool=True,
                    soft_rows=True,
                ),
                TASK_ONLY,
            )
        if velocity is None:
            weighted = SOFT_TASK_COST**2 * self._tool_rows.T
            H, c = self._eye + weighted @ self._tool_rows, -weighted @ self._tool_rates
            velocity = self._program(H, c, rows, smallest_rate_m_s, hard_tool=False, soft_rows=True)
            status = TASK_SOFT
        if velocity is None:
            velocity, status = np.zeros_like(c), STOPPED
        # The solver keeps inequalities to a tolerance; the joint limits are meant exactly.
        return IkSolution(within(velocity, self._low, self._high), status)

    def followed(
        self,
        configuration: mink.Configuration,
        previous_rad_s: NDArray[np.float64],
        wanted_rad_s: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """(n,) what the joint limits let through of a wanted velocity (n,) after a previous one (n,)."""
        self.limit.previous_rad_s = previous_rad_s
        compiled = self.compiled(configuration)
        found = None if compiled is None else compiled.followed(previous_rad_s, wanted_rad_s)
        if found is not None:
            return found
        low, high = self.limit.bounds(configuration.data.qpos[self.arm.qpos], self.dt_s)
        return np.clip(wanted_rad_s, low, high)

    def evade(
        self,
        configuration: mink.Configuration,
        previous_rad_s: NDArray[np.float64],
        preferred_rad_s: NDArray[np.float64],
        rows: NDArray[np.float64],
        smallest_rate_m_s: NDArray[np.float64],
    ) -> NDArray[np.float64] | None:
        """The motion nearest to a preferred one that opens what must open, the tool's task aside.

        The rows may be missed, as little as possible, where the joint limits leave no other way.

        Args:
            configuration: The state.
            previous_rad_s: (n,) velocity from which the acceleration counts.
            preferred_rad_s: (n,) velocity to stay near to.
            rows: (R, n) rows G of the pairs.
            smallest_rate_m_s: (R,) rate each should have at least.

        Returns:
            (n,) joint velocity; None if the solver failed.
        """
        self.limit.previous_rad_s = previous_rad_s
        self._low, self._high = self.limit.bounds(configuration.data.qpos[self.arm.qpos], self.dt_s)
        for values in (preferred_rad_s, rows, smallest_rate_m_s, self._low, self._high):
            if not all_finite(values):
                raise FloatingPointError(
                    f"arm {self.arm.name}: the evasive motion was given a number that is not finite"
                )
        velocity = self._program(
            self._eye, -preferred_rad_s, rows, smallest_rate_m_s, hard_tool=False, soft_rows=True
        )
        return None if velocity is None else within(velocity, self._low, self._high)

    def _program(
        self,
        H: NDArray[np.float64],
        c: NDArray[np.float64],
        rows: NDArray[np.float64],
        lower: NDArray[np.float64],
        *,
        hard_tool: bool,
        soft_rows: bool = False,
    ) -> NDArray[np.float64] | None:
        """Minimise ½ q̇ᵀHq̇ + cᵀq̇ within the joint box and rows q̇ >= lower, missed as little as
        possible where they are soft; None where there is no acceptable solution."""
        tool = len(self._tool_rates) if hard_tool else 0
        n, pairs = len(c), len(lower)
        program = self._program_space.of(pairs + tool, H, c)
        program.sense[:] = 0
        np.maximum(self._low, -_UNBOUNDED, out=program.lower[:n])
        np.minimum(self._high, _UNBOUNDED, out=program.upper[:n])
        program.rows[:pairs], program.lower[n : n + pairs] = rows, lower
        program.upper[n : n + pairs] = _UNBOUNDED
        if soft_rows:
            program.sense[n : n + pairs] = _SOFT
        if hard_tool:
            program.rows[pairs:] = self._tool_rows
            program.lower[n + pairs :] = program.upper[n + pairs :] = self._tool_rates
            program.sense[n + pairs :] = _EQUALITY
        return solution(program)

    def compiled(self, configuration: mink.Configuration) -> CompiledIk | None:
        """The compiled functions at work on this configuration; None where NumPy is used."""
        found = kernels()
        if found is None:
            return None
        at_work = self._at_work
        if (
            at_work is None
            or at_work.configuration is not configuration
            or at_work.kernels is not found
        ):
            at_work = self._at_work = CompiledIk(found, self.arm, configuration, self.dt_s)
        return at_work


class CompiledIk:
    """The compiled functions for one arm, bound to the arrays of one configuration's data.

    Args:
        kernels: Of this process.
        arm: Its addresses and limits.
        configuration: Its arrays never move, so their addresses are taken once.
        dt_s: Control period.
    """

    def __init__(
        self, kernels: Kernels, arm: ArmAddresses, configuration: mink.Configuration, dt_s: float
    ):
        self.kernels = kernels
        self._dt_s = dt_s
        self.configuration = configuration
        model, data = configuration.model, configuration.data
        n = len(arm.dofs)
        on_the_way, body = np.zeros(model.nbody, dtype=bool), int(model.site_bodyid[arm.tool_site])
        while body:
            on_the_way[body], body = True, int(model.body_parentid[body])
        self._aim: Bound = kernels.bind(
            "aim",
            {"joints": model.nv, "bodies": model.nbody, "sites": model.nsite, "dofs": n},
            site_xpos=data.site_xpos,
            site_xmat=data.site_xmat,
            cdof=data.cdof,
            subtree_com=data.subtree_com,
            site=_integers([arm.tool_site]),
            dof=_integers(arm.dofs),
            dof_root=_integers(model.body_rootid[model.dof_bodyid[arm.dofs]]),
            moves=on_the_way[model.dof_bodyid[arm.dofs]],
        )
        kept = self._aim.arrays
        self._position, self._wxyz = kept["position"], kept["wxyz"]
        self._velocity, self._turn = kept["velocity"], kept["turn"]
        self._settings, self._free = kept["settings"], kept["free"]
        self._asked: tuple[float, ...] = ()
        self._whole, self._path = kept["whole"], kept["path"]
        self.tool_error = kept["error"].tolist
        """Distance to the target and angle, m and rad, of the last `aim`."""
        self._tool = {
            free: (kept["rows"][: 6 - free], kept["rates"][: 6 - free]) for free in (False, True)
        }
        self.aimed: dict[str, NDArray[Any]] = {
            "task": kept["whole"], "tool_rows": kept["rows"], "tool_rates": kept["rates"],
        }  # fmt: skip
        """What the last `aim` has left, for another function to take up."""
        self.limits: dict[str, NDArray[Any]] = {
            "qpos": data.qpos,
            "address": _integers(arm.qpos),
            "lower_rad": _floats(arm.lower_rad),
            "upper_rad": _floats(arm.upper_rad),
            "speed": _floats(arm.velocity_limit_rad_s),
            "acceleration": _floats(arm.acceleration_limit_rad_s2),
        }
        """Of the joints, and where they are."""
        sizes = {"dofs": n, "coordinates": len(data.qpos)}
        self._followed: Bound = kernels.bind("followed", sizes, **self.limits)

    def aim(
        self,
        target: Target,
        gain: float,
        dt_s: float,
        catch_up_m_s: float,
        free_rotation: bool,
    ) -> tuple[NDArray[np.float64], ...] | None:
        """Rows, rates, the whole motion and the path's part of it, as `ArmIk.aim` keeps them; None where NumPy has to say what is wrong."""
        self._position[...], self._wxyz[...] = target.position_m, target.wxyz
        self._velocity[...] = target.velocity_m_s
        self._turn[...] = target.angular_velocity_rad_s
        asked = gain, dt_s, catch_up_m_s, free_rotation
        if asked != self._asked:
            self._asked = asked
            self._settings[...] = gain, dt_s, catch_up_m_s, TURN_LENGTH_M_PER_RAD
            self._free[0] = free_rotation
        self._aim.run()
        if self._aim.done() != DONE:
            return None
        return *self._tool[free_rotation], self._whole.copy(), self._path.copy()

    def followed(
        self, previous_rad_s: NDArray[np.float64], wanted_rad_s: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """See `ArmIk.followed`."""
        kept = self._followed.arrays
        kept["previous"][...], kept["wanted"][...] = previous_rad_s, wanted_rad_s
        self._followed.setting[0] = self._dt_s
        self._followed.run()
        return kept["within"].copy() if self._followed.done() == DONE else None


def _tool_error(
    configuration: mink.Configuration, site: int, target: Target
) -> tuple[float, float]:
    """Distance and angle between a tool and its target, m and rad."""
    data, wxyz = configuration.data, np.empty(4)
    mujoco.mju_mat2Quat(wxyz, data.site_xmat[site])
    # |a - b| and |a + b| are 2 sin and 2 cos of a quarter of the angle; the sign of a quaternion is free.
    apart, along = math.dist(wxyz, target.wxyz), math.dist(wxyz, -target.wxyz)
    angle = 4.0 * math.atan2(min(apart, along), max(apart, along))
    return math.dist(data.site_xpos[site], target.position_m), angle


def _integers(values: ArrayLike) -> NDArray[np.int64]:
    return np.ascontiguousarray(values, dtype=np.int64)


def _floats(values: ArrayLike) -> NDArray[np.float64]:
    return np.ascontiguousarray(values, dtype=np.float64)


class _Space:
    """Arrays a program is written into, kept from tick to tick.

    Args:
        n: Joints.
    """

    def __init__(self, n: int):
        self._n = n
        self._grow(64)

    def _grow(self, rows: int) -> None:
        self._rows = np.empty((rows, self._n))
        self._lower, self._upper = np.empty(self._n + rows), np.empty(self._n + rows)
        self._sense = np.empty(self._n + rows, dtype=np.intc)

    def of(self, rows: int, H: NDArray[np.float64], c: NDArray[np.float64]) -> Program:
        """Room for a box and this many rows, with whatever the last program left in it."""
        if rows > len(self._rows):
            self._grow(2 * rows)
        m = self._n + rows
        return Program(H, c, self._rows[:rows], self._lower[:m], self._upper[:m], self._sense[:m])


@dataclass(frozen=True)
class Program:
    """A program, its constraints in daqp's order: the box on the joints, then the rows."""

    H: NDArray[np.float64]
    """(n, n)"""
    c: NDArray[np.float64]
    """(n,)"""
    rows: NDArray[np.float64]
    """(R, n)"""
    lower: NDArray[np.float64]
    """(n + R,)"""
    upper: NDArray[np.float64]
    """(n + R,)"""
    sense: NDArray[np.intc]
    """(n + R,) daqp's marks."""


def solution(program: Program) -> NDArray[np.float64] | None:
    """What daqp finds; None where there is no acceptable solution."""
    velocity, _, flag, _ = daqp.solve(
        program.H,
        program.c,
        program.rows,
        program.upper,
        program.lower,
        program.sense,
        primal_tol=SOLVER_TOLERANCE_RAD_S,
    )
    if flag not in (_SOLVED, _SOLVED_SOFT) or not all_finite(velocity):
        return None
    return velocity


_SETTLE = ArrayFunction("settle", "velocity", "low", "high")


def within(
    velocity: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What the solver found, within its box to the last bit, and on its bounds where it is on them but for the solver's tolerance.

    Whether a joint brakes as hard as it can must not depend on the last bit of an iteration.
    """
    found = _SETTLE(velocity, low, high, setting=SOLVER_TOLERANCE_RAD_S)
    if found is not None:
        return found["settled"].copy()
    settled = np.where(velocity <= low + SOLVER_TOLERANCE_RAD_S, low, velocity)
    return np.where(velocity >= high - SOLVER_TOLERANCE_RAD_S, high, settled)


def _approach(
    distance_rad: NDArray[np.float64], arm: ArmAddresses, dt_s: float
) -> NDArray[np.float64]:
    """(2, n) largest speed towards an end stop at a distance from which braking still fits; negative beyond it."""
    a = arm.acceleration_limit_rad_s2
    half_step = a * (dt_s / 2)
    speed = np.sqrt(half_step * half_step + 2.0 * a * np.maximum(distance_rad, 0.0)) - half_step
    if distance_rad.min() >= 0.0:
        return speed
    return np.where(
        distance_rad < 0, np.maximum(distance_rad / dt_s, -arm.velocity_limit_rad_s), speed
    )

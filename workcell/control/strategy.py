"""The interface of a strategy: what it may know of an arm in a tick, and what it answers.

A strategy steers one arm. Once a tick it is given an `ArmView` and answers with a `Steering`; what it
has to remember is its own. Support arms are steered first, by priority, then the priority arms, so that
each knows what those before it were commanded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.arm_constraints import Allowance, Keeping
from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import IkSolution
from workcell.control.laws.criteria import GIVEN, NO_CRITERION
from workcell.control.tick import ArmSensed, ArmSetpoint, Sensed, Steering
from workcell.errors import ControlFault
from workcell.scenario import Control
from workcell.scene.addresses import ArmAddresses

if TYPE_CHECKING:
    from workcell.control.arm import ControlledArm
    from workcell.motion.jobs import JobSequence

Array = NDArray[np.float64]


class StrategySetup(NamedTuple):
    """What a strategy is made from: its class is called with this alone."""

    settings: Control
    """Parameters at the start."""
    period_s: float
    """Control period."""
    limits: ArmAddresses
    """Addresses and joint limits of the arm; of the first arm for a strategy of the whole cell."""
    options: Any
    """Its own options, an instance of its attribute `Options`; None where the scenario gives none."""
    model: mujoco.MjModel
    """The cell's model; not to be written to."""
    pair_geoms: NDArray[np.intp]
    """(P, 2) geom ids of the watched pairs."""
    factor_multiplier: float = 1.0
    """Fault put in on purpose into the built-in strategy, for tests of the final check."""


class Strategy(Protocol):
    """What steers an arm. One object an arm, so that it may remember what it likes."""

    def steer(self, view: ArmView) -> Steering:
        """Answer for this tick."""
        ...


class CellStrategy(Protocol):
    """What steers all arms of a cell at once, priority arms included."""

    def steer_all(self, view: CellView) -> dict[str, Steering]:
        """Answer for every arm, by its name."""
        ...


class CellView(NamedTuple):
    """A whole cell in one tick, for reading."""

    arms: dict[str, ArmView]
    """By name, in the order in which they would be steered one by one."""
    jacobian: Array
    """G = dd/dq (P, nv) of all watched pairs."""
    distance_m: Array
    """(P,)"""
    inactive: NDArray[np.bool_]
    """(P,) pairs that do not count now: an instrument against the hand that holds it."""


class ArmView:
    """One arm in one tick, for reading. n joints, R pairs that the arm answers for, M that it moves.

    Arrays are the controller's own and good until the tick is over; a strategy must not write to them.

    Args:
        arm: The arm.
        sensed: What was measured of the cell.
        seen: What was measured of the arm.
        setpoint: What is asked of it.
    """

    __slots__ = ("_arm", "_constraints", "_counted", "seen", "sensed", "setpoint", "settings")

    def __init__(self, arm: ControlledArm, sensed: Sensed, seen: ArmSensed, setpoint: ArmSetpoint):
        self._arm = arm
        self._constraints = arm.constraints
        self._counted = False
        self.sensed = sensed
        self.seen = seen
        self.setpoint = setpoint
        self.settings: Control = sensed.settings
        """The parameters in force."""

    # ---------------------------------------------------------------- the arm and its limits

    @property
    def limits(self) -> ArmAddresses:
        """Addresses and joint limits."""
        return self._arm.addresses

    @property
    def period_s(self) -> float:
        """Control period."""
        return self._arm.ik.dt_s

    @property
    def q_rad(self) -> Array:
        """(n,) joint positions."""
        return self.sensed.qpos[self._arm.addresses.qpos]

    @property
    def dofs(self) -> NDArray[np.intp]:
        """(n,) where its joints are in a joint velocity of the whole cell."""
        return self._arm.dofs

    @property
    def command_rad_s(self) -> Array:
        """(n,) last command."""
        return self._arm.memory.command_rad_s

    @property
    def nominal_rad_s(self) -> Array:
        """(n,) last nominal velocity, or the last command where a new path has begun."""
        return self._arm.memory.nominal_rad_s

    @property
    def last(self) -> Steering:
        """What was answered in the tick before."""
        return self._arm.memory.answer

    def box(self, previous_rad_s: Array) -> tuple[Array, Array]:
        """(n,) smallest and largest joint velocity after a previous one (n,): stops, speed and acceleration."""
        self._arm.ik.limit.previous_rad_s = previous_rad_s
        return self._arm.ik.limit.bounds(self.q_rad, self.period_s)

    # ---------------------------------------------------------------- the tool's task

    @property
    def configuration(self) -> mink.Configuration:
        """The controller's belief, for kinematics that are not here."""
        return self._arm.configuration

    @property
    def tool_jacobian(self) -> Array:
        """(6, n) linear, then angular velocity of the tool in its own frame for each joint's; fewer rows where the
        task asks for less than a pose."""
        return self._arm.configuration.get_frame_jacobian(self.limits.tool_site_name, "site")[
            : self._arm.ik.directions, self._arm.dofs
        ]

    @property
    def self_motion(self) -> bool:
        """Whether the controller may use the arm's null space (`self_motion` of the arm)."""
        return self._arm.self_motion

    @property
    def task_rad_s(self) -> Array:
        """(n,) the smallest joint velocity that does what the target asks, limits aside."""
        return self.setpoint.task_rad_s

    @property
    def path_rad_s(self) -> Array:
        """(n,) the part of it that the target's own motion asks for, corrections of the tool error aside."""
        return self._arm.ik.path_rad_s

    @property
    def jobs(self) -> JobSequence | None:
        """The jobs of a support arm, for reading: progress, whether it moves, retreats, has arrived."""
        return self._arm.jobs

    # ---------------------------------------------------------------- the watched pairs

    @property
    def moved(self) -> NDArray[np.intp]:
        """(M,) pairs that its motion changes."""
        return self._constraints.pairs.moved

    @property
    def owned(self) -> NDArray[np.intp]:
        """(R,) pairs that it answers for by slowing down."""
        return self._constraints.pairs.owned

    @property
    def meeting(self) -> NDArray[np.intp]:
        """Pairs that its present job brings together."""
        return self._arm.meeting_pairs

    @property
    def distance_m(self) -> Array:
        """(P,) of all watched pairs."""
        return self.sensed.distance_m

    def rows(self, pairs: NDArray[np.intp]) -> Array:
        """(K, n) rows of G, the distances' derivatives by its joints, of some pairs."""
        return self._constraints.rows(pairs)

    @property
    def other_m_s(self) -> Array:
        """(P,) the rates that others are predicted to cause, of the pairs it moves; the least favourable of their velocity hypotheses."""
        if not self._counted:
            static = self._arm.support and self.settings.variant == "static"
            self._constraints.predict_others(static=static)
            self._counted = True
        return self._constraints.other_m_s

    # ---------------------------------------------------------------- helpers

    def solve(self, push: NullspaceObjective | None = None) -> IkSolution:
        """The nominal velocity: the tool's task, the criterion, and no self-motion that brings a pair below t_min.

        Args:
            push: What the null space is to do instead of the criterion. An arm with `self_motion = false` has
                no criterion; a push that is asked for counts.

        Raises:
            ControlFault: a number is not finite.
            CriterionFault: a criterion from outside gave no answer that can be used.
        """
        criterion, kind = self._arm.criterion, NO_CRITERION
        if push is None and self.self_motion:
            kind = criterion.kind(self.settings)
        if kind == GIVEN:
            averaged = self._constraints.pairs.averaged
            rows = self.rows(averaged)
            held_m_s = self.other_m_s[averaged] + rows @ self.task_rad_s
            push = criterion.objective(self.settings, self.distance_m[averaged], held_m_s, rows)
        try:
            found = self._constraints.solve(
                self.nominal_rad_s, self.task_rad_s, self.sensed.qvel, self.settings, kind, push
            )
        except FloatingPointError as error:
            raise ControlFault(self.sensed.tick, str(error)) from error
        self._counted = True
        return found

    def evade(
        self,
        preferred_rad_s: Array,
        rows: Array,
        needed_m_s: Array,
        hard: NDArray[np.bool_] | None = None,
    ) -> Array | None:
        """(n,) the velocity nearest to a preferred one (n,) that gives each row (K, n) its needed rate (K,).

        Rows are missed, as little as possible, where the joint limits leave no other way; those marked hard (K,)
        never for the sake of the others. None if the solver failed.
        """
        return self._arm.ik.evade(
            self._arm.configuration, self.command_rad_s, preferred_rad_s, rows, needed_m_s, hard
        )

    def allowance(self, velocity_rad_s: Array) -> Allowance:
        """What the pairs and the joints leave of a velocity (n,)."""
        return self._constraints.allow(
            velocity_rad_s, self.command_rad_s, self.period_s, self.settings
        )

    def is_free(self, velocity_rad_s: Array) -> bool:
        """Whether no pair would limit the arm at this velocity (n,)."""
        return self._constraints.is_free(velocity_rad_s, self.settings)

    def keeps(self, velocity_rad_s: Array) -> bool:
        """Whether a velocity (n,) leaves every pair its time to collision; remembered if so."""
        return self._constraints.keeps(velocity_rad_s, self.settings)

    def kept(self, velocity_rad_s: Array) -> Keeping:
        """How far a velocity (n,) keeps the times to collision, pair by pair."""
        return self._constraints.kept(velocity_rad_s, self.settings)

    def remember_kept(self) -> None:
        """Take what the others do now as what was last kept."""
        self._constraints.remember()

    @property
    def criterion_gain(self) -> float:
        """Weight of the null-space criterion against ½|q̇|²."""
        return self._arm.ik.criterion.gain

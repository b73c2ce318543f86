"""What the watched pairs allow to the motion of one arm: what the other arms cause, the program of its inverse
kinematics, the speed scale that keeps every time to collision, whether a command keeps it.

What is kept here from tick to tick are the arrays; the arithmetic is in `laws`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import mink
import numpy as np
from numpy.typing import NDArray

from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import ArmIk, IkSolution
from workcell.control.ik.qp import SOLVER_TOLERANCE_RAD_S
from workcell.control.laws import pair_rule, program, speed_scale, tool_state
from workcell.control.laws.pair_rule import TASK_SLACK_M_S
from workcell.control.scaling import AccelerationInterval, ScaleBound
from workcell.control.watched import HYPOTHESES, Watched
from workcell.errors import WorkcellError
from workcell.scenario import Control
from workcell.scene.addresses import ArmAddresses

__all__ = [
    "TASK_SLACK_M_S",
    "Allowance",
    "ArmConstraints",
    "ArmPairs",
    "Keeping",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Allowance(NamedTuple):
    """What pairs and joints leave of the velocity an arm wants."""

    bound: ScaleBound
    """By the times to collision; its pairs are numbered among those the arm answers for."""
    must_yield: bool
    """Whether standing is not enough for a pair that the arm can do something about."""
    reach: AccelerationInterval
    """By the joints' acceleration."""


@dataclass(frozen=True)
class ArmPairs:
    """Which pairs concern an arm; replaced when an instrument changes hands."""

    moved: Indices
    """Pairs that its motion changes."""
    averaged: Indices
    """The arm against its surroundings: the M N pairs of the criterion. Self pairs are watched but not averaged."""
    owned: Indices
    """Pairs that it answers for by slowing down."""
    fixed_base: NDArray[np.bool_]
    """For each of these, whether it is with the arm's own base, which only another arm can come near."""


class ArmConstraints:
    """One arm's part of the watched pairs; R is the number of those it answers for, n that of its joints.

    Args:
        watched: All pairs.
        ik: The arm's inverse kinematics.
        configuration: The controller's belief.
        pairs: Which concern this arm.
        support: Whether it is scaled.
    """

    def __init__(
        self,
        watched: Watched,
        ik: ArmIk,
        configuration: mink.Configuration,
        pairs: ArmPairs,
        *,
        support: bool,
    ):
        self.watched = watched
        self.pairs = pairs
        self.arm: ArmAddresses = ik.arm
        self.ik = ik
        self.support = support
        self._configuration = configuration
        self._foreign = np.setdiff1d(np.arange(watched.jacobian.shape[1]), self.arm.dofs)
        self.meeting = np.zeros(len(pairs.owned), dtype=bool)
        """(R,) which of them the arm's present job brings together."""
        self._meeting_pairs: Indices | None = None
        self.other_m_s = np.zeros(len(watched.distance_m))
        """(P,) the rates that the others cause, as predicted; only of the pairs it moves."""
        self.kept_other_m_s: Array | None = None
        """(R,) the same when every time to collision was last kept."""

        n, answered = len(self.arm.dofs), len(pairs.owned)
        self._moved, self._averaged, self._owned, self._dof = (
            np.ascontiguousarray(k, dtype=np.int64)
            for k in (pairs.moved, pairs.averaged, pairs.owned, self.arm.dofs)
        )
        self._fixed_base = np.ascontiguousarray(pairs.fixed_base)
        self._task, self._velocity, self._before = np.zeros(n), np.zeros(n), np.zeros(n)
        self._qvel = np.zeros(watched.jacobian.shape[1])
        self._push = np.zeros((n, n)), np.zeros(n)
        self._nothing = np.zeros((n, n)), np.zeros(n)
        self._work, self._rates = np.zeros((4, answered)), np.zeros(len(watched.distance_m))
        body = int(configuration.model.site_bodyid[self.arm.tool_site])
        elbow = -1 if self.arm.elbow_site is None else self.arm.elbow_site
        self._sites = (
            self.arm.tool_site, body, int(configuration.model.body_rootid[body]), elbow,
        )  # fmt: skip
        """Site, body and root body of its tool, and the elbow's site."""
        self._keeping = _room_for_keeping(answered)
        ik.space.reserve(len(pairs.moved) + 6)

    @property
    def other_owned_m_s(self) -> Array:
        """(R,) of the pairs it answers for."""
        return self.other_m_s.take(self.pairs.owned)

    def meets(self, pairs: Indices) -> None:
        """Say which pairs the arm's present job brings together."""
        if pairs is not self._meeting_pairs:
            self._meeting_pairs = pairs
            self.meeting[...] = np.isin(self.pairs.owned, pairs)

    def rows(self, pairs: Indices) -> Array:
        """(R, n) rows of G of some pairs."""
        return self.watched.jacobian.take(pairs, axis=0).take(self.arm.dofs, axis=1)

    def arm_state(
        self, frames: tuple[Array, ...], position_m: Array, elbow_m: Array, *, approaching: bool
    ) -> tuple[float, float, float]:
        """The tool's speed in m/s, ARTC in 1/s, signed or of what approaches, and ARMD in 1/m.

        Args:
            frames: MuJoCo's `site_xpos`, `cvel` and `subtree_com`, after `mj_comVel`.
            position_m: (3,) written: where the tool is.
            elbow_m: (3,) written where the arm has an elbow.
            approaching: Whether pairs that open count nothing in ARTC.
        """
        speed_m_s, artc, armd, bad = tool_state.arm_state(
            *frames, *self._sites, self.watched.distance_m, self.watched.rate_m_s, self._averaged,
            approaching, position_m, elbow_m,
        )  # fmt: skip
        if bad >= 0:
            raise WorkcellError(f"watched pair {bad}: its distance or its rate is not finite")
        return speed_m_s, artc, armd

    def predict_others(self, *, static: bool) -> None:
        """Take `other_m_s` from what the other arms are predicted to do.

        A support arm assumes the least favourable of their velocity hypotheses, as they may be kept from doing at
        once what is asked of them; a priority arm on what they were commanded. Static: they stand.
        """
        bad = pair_rule.predicted_rates(
            self.watched.jacobian,
            self._moved,
            self._foreign,
            self._hypotheses(static),
            self.watched.change_rad_s,
            self.other_m_s,
        )
        if bad >= 0:
            raise FloatingPointError(f"watched pair {bad}: what others do to it is not finite")

    def _hypotheses(self, static: bool) -> Array:
        return self.watched.hypotheses_rad_s[: 0 if static else HYPOTHESES if self.support else 1]

    def solve(
        self,
        previous_rad_s: Array,
        task_rad_s: Array,
        qvel: Array,
        settings: Control,
        kind: int,
        push: NullspaceObjective | None = None,
    ) -> IkSolution:
        """The arm's inverse kinematics: its tool's task, its criterion, no self-motion that brings a pair below t_min.

        Args:
            previous_rad_s: (n,) velocity from which the acceleration counts.
            task_rad_s: (n,) the smallest motion that does what the tool is to do (`ArmIk.aim`).
            qvel: (nv,) measured velocities.
            settings: In force.
            kind: The criterion; see `laws.criteria`.
            push: What the null space is for where that is `NO_CRITERION` or `GIVEN`; None for nothing.

        Raises:
            FloatingPointError: a number is not finite.
        """
        watched, ik, space = self.watched, self.ik, self.ik.space
        ik.take(self._configuration)
        self._task[...], self._before[...] = task_rad_s, previous_rad_s
        self._qvel[...] = qvel
        wish = self._nothing
        if push is not None:
            wish = self._push
            wish[0][...], wish[1][...] = push.hessian, push.linear
        static = self.support and settings.variant == "static"
        settled = np.empty(space.n)
        code, culprit, rows, answer = program.arm_program(
            watched.jacobian, watched.distance_m, watched.rate_m_s, self._hypotheses(static),
            watched.change_rad_s, self._foreign, self._moved, self._averaged, self._dof, self._task, self._qvel, kind,
            self.support, *wish, ik.criterion.gain, settings.t_min_s, settings.standoff_m,
            settings.d_min_m, ik.qpos, *ik.joints, self._before, ik.dt_s, ik.tool_rows,
            ik.tool_rates, ik.tool_count, self.other_m_s, self._rates, space.rows, space.bounds,
            space.smallest, space.largest, space.H, space.c, space.lower, space.upper, space.sense,
            *space.solver, SOLVER_TOLERANCE_RAD_S, settled,
        )  # fmt: skip
        if code != program.FINE:
            raise FloatingPointError(self._not_finite(code, culprit))
        return ik.first_of(space.answered(answer, rows + ik.tool_count, settled), rows)

    def _not_finite(self, code: int, culprit: int) -> str:
        where = {
            program.PAIR_NOT_FINITE: f", in watched pair {culprit}",
            program.JOINT_NOT_FINITE: f", in joint {self.arm.joints[culprit]}",
        }.get(code, "")
        return f"arm {self.arm.name}: the inverse kinematics was given a number that is not finite{where}"

    def allow(
        self, wanted_rad_s: Array, command_rad_s: Array, period_s: float, settings: Control
    ) -> Allowance:
        """What the pairs and the joints leave of a wanted velocity.

        Args:
            wanted_rad_s: (n,).
            command_rad_s: (n,) what the joints were commanded last.
            period_s: Of control.
            settings: In force.
        """
        bound, must_yield = self._scale(wanted_rad_s, settings)
        self._before[...] = command_rad_s
        lowest, highest, feasible, bad = speed_scale.acceleration_interval(
            self._before, self._velocity, self.ik.joints[4], period_s
        )
        if bad >= 0:
            raise WorkcellError(
                f"joint {self.arm.joints[bad]}: its velocity is not finite or its acceleration limit not positive"
            )
        return Allowance(bound, must_yield, AccelerationInterval(lowest, highest, feasible))

    def _scale(self, velocity_rad_s: Array, settings: Control) -> tuple[ScaleBound, bool]:
        """The speed scale of a velocity (n,), and whether the arm must yield; see `laws.speed_scale.arm_scale`."""
        watched, rule = self.watched, speed_scale.BY_TIME
        accel = watched.accel_m_s2
        if settings.slow_down == "distance":
            rule = speed_scale.BY_DISTANCE
        elif accel is not None:
            rule = speed_scale.BY_SECOND_ORDER_TIME
        self._velocity[...] = velocity_rad_s
        found, must_yield = speed_scale.arm_scale(
            watched.jacobian, watched.distance_m, self.other_m_s,
            watched.distance_m if accel is None else accel, self._owned, self.meeting,
            self._fixed_base, self._dof, self._velocity, rule, settings.t_min_s, settings.standoff_m,
            settings.d_min_m, settings.slow_distance_m, self._work,
        )  # fmt: skip
        if found[5] >= 0:
            raise WorkcellError(
                f"watched pair {self._owned[found[5]]}: its distance or rate is not finite"
            )
        return ScaleBound(*found[:5]), must_yield

    def is_free(self, velocity_rad_s: Array, settings: Control) -> bool:
        """Whether no pair would limit the arm at this velocity (n,)."""
        return self._scale(velocity_rad_s, settings)[0].factor == 1.0

    def keeps(self, command_rad_s: Array, settings: Control) -> bool:
        """Whether a command (n,) leaves every pair its time to collision, and none to be opened; remembered if so."""
        if not self._keep(command_rad_s, settings, self._keeping):
            return False
        self.remember()
        return True

    def remember(self) -> None:
        """Take what the others do now as what was last kept."""
        self.kept_other_m_s = self.other_owned_m_s

    def kept(self, command_rad_s: Array, settings: Control) -> Keeping:
        """How far a command (n,) keeps the times to collision, pair by pair."""
        found = _room_for_keeping(len(self._owned))
        self._keep(command_rad_s, settings, found)
        return Keeping(self.rows(self.pairs.owned), *found)

    def _keep(self, command_rad_s: Array, settings: Control, found: tuple[Any, ...]) -> bool:
        """Whether a command keeps every pair; what it does to each is written, see `laws.pair_rule.keeping`."""
        watched, before = self.watched, self.kept_other_m_s
        self._velocity[...] = command_rad_s
        return pair_rule.keeping(
            watched.jacobian, watched.distance_m, self.other_m_s,
            self.other_owned_m_s if before is None else before, self._owned, self.meeting,
            self._dof, self._velocity, settings.t_min_s, settings.standoff_m, settings.d_min_m,
            *found,
        )  # fmt: skip


def _room_for_keeping(pairs: int) -> tuple[Any, ...]:
    """Arrays (R,) that `laws.pair_rule.keeping` writes: allowances, needs, and what holds of each pair."""
    return (
        np.empty(pairs), np.empty(pairs), np.empty(pairs, dtype=bool), np.empty(pairs, dtype=bool),
        np.empty(pairs, dtype=bool),
    )  # fmt: skip


class Keeping(NamedTuple):
    """What a command does to the pairs an arm answers for."""

    rows: Array
    """(R, n) of G."""
    allowance_m_s: Array
    """(R,) how fast each may be closed, the others' part already taken off; negative where standing does not keep it."""
    needed_m_s: Array
    """(R,) rate that each needs of this arm; 0 for those that standing keeps, or does not keep."""
    needs_more: NDArray[np.bool_]
    """(R,) which do not get it."""
    short: NDArray[np.bool_]
    """(R,) which fall short of their time to collision."""
    others_alone: NDArray[np.bool_]
    """(R,) where a time falls short, whether the others alone are the cause: they close too fast for
    an arm that stands, or faster than when every time was last kept."""

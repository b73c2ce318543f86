"""What an arm's constraints answer, from the arrays of its `Watched` (theory: sections 5 and 6)."""

from __future__ import annotations

import numpy as np

from tests.control.oracles import rule
from workcell.control.arm_constraints import ArmConstraints
from workcell.scenario import Control


class ArmOracle:
    """The same questions as to an arm's constraints, about the same pairs.

    Args:
        constraints: Whose pairs, meetings and past are looked at; none of its methods is called.
        settings: In force.
    """

    def __init__(self, constraints: ArmConstraints, settings: Control):
        self.constraints, self.watched, self.settings = constraints, constraints.watched, settings
        self.dofs, self.owned = constraints.arm.dofs, constraints.pairs.owned

    def rows(self, pairs) -> np.ndarray:
        return self.watched.jacobian[pairs][:, self.dofs]

    def other(self, *, static: bool) -> np.ndarray:
        """(P,) the least favourable rate that the others may cause."""
        velocities = self.watched.hypotheses_rad_s[: 3 if self.constraints.support else 1].copy()
        velocities[:, self.dofs] = 0.0
        if static:
            return np.zeros(len(self.watched.distance_m))
        return (self.watched.jacobian @ velocities.T).min(axis=1)

    def criterion(self, qvel, other, task) -> tuple[np.ndarray, np.ndarray]:
        """H and c, with the push from the stops."""
        pairs, arm, ik = self.constraints.pairs.averaged, self.constraints.arm, self.constraints.ik
        rows = self.rows(pairs)
        rate = rows @ qvel[self.dofs] if self.constraints.support else self.watched.rate_m_s[pairs]
        name = self.settings.criterion
        if name == "artc_held":
            rate = other[pairs] + rows @ task
        H, c = rule.objective(name, self.watched.distance_m[pairs], rate, rows, other[pairs])
        if name != "none":
            q = ik.qpos[arm.qpos]
            c = c + rule.push_from_stops(q, arm.lower_rad, arm.upper_rad, ik.criterion.gain)
        return H, c

    def self_motion_rows(self, task, other) -> tuple[np.ndarray, np.ndarray]:
        moved, asked = self.constraints.pairs.moved, self.settings
        rows = self.rows(moved)
        gap = self.watched.distance_m[moved] - asked.standoff_m
        allowed = np.where(gap <= asked.d_min_m, 0.0, -gap / asked.t_min_s) - other[moved]
        allowed = np.minimum(allowed, rows @ task - rule.TASK_SLACK_M_S)
        near = allowed > -np.abs(rows) @ self.constraints.arm.velocity_limit_rad_s
        return rows[near], allowed[near]

    def counted(self) -> tuple[np.ndarray, np.ndarray]:
        counted = self.watched.distance_m[self.owned]
        reached = (counted <= self.settings.d_min_m) & ~self.constraints.meeting
        counted = np.where(reached, np.minimum(counted, 0.0), counted)
        return counted + self.constraints.meeting * self.settings.standoff_m, reached

    def bound(self, own, other) -> tuple:
        """What `pairwise_factor` says, the settings' rule followed."""
        asked = self.settings
        counted, reached = self.counted()
        own, other = (
            np.where(reached & (np.abs(r) < rule.AT_REST_M_S), 0.0, r) for r in (own, other)
        )
        if asked.slow_down == "distance":
            if not len(counted):
                return 1.0, -1, np.inf, 0.0, -1
            pair = int(counted.argmin())
            required = (counted[pair] - asked.d_min_m) / (asked.slow_distance_m - asked.d_min_m)
            factor = min(1.0, max(0.0, required))
            return factor, pair if factor < 1.0 else -1, required, 0.0, -1
        found = rule.pairwise_factor(counted, own, other, asked.t_min_s, asked.standoff_m)
        if self.watched.accel_m_s2 is None:
            return found
        accel = self.watched.accel_m_s2[self.owned]
        kappa = rule.second_order(counted, own + other, accel, asked.standoff_m)
        ttc, pair = rule.smallest(np.where(own < 0.0, kappa, 0.0))
        factor = min(1.0, ttc / asked.t_min_s)
        return found if factor >= found[0] else (factor, pair, factor, *found[3:])

    def allow(self, velocity, other) -> tuple[tuple, bool]:
        """The bound on a velocity, and whether the arm must yield."""
        own, other = self.rows(self.owned) @ velocity, other[self.owned]
        found = self.bound(own, other)
        if found[3] <= rule.MUST_YIELD_M_S:
            return found, False
        spared = other + self.constraints.meeting * rule.MUST_YIELD_MEETING_M_S
        spared = np.where(self.constraints.pairs.fixed_base, np.maximum(spared, 0.0), spared)
        return found, self.bound(own, spared)[3] > rule.MUST_YIELD_M_S

    def kept(self, command, other) -> dict[str, np.ndarray]:
        """What a command does to the pairs; see `arm_constraints.Keeping`."""
        counted, reached = self.counted()
        other = other[self.owned]
        allowance = (counted - self.settings.standoff_m) / self.settings.t_min_s + other
        slack = np.where(reached, rule.AT_REST_M_S, rule.TASK_SLACK_M_S)
        needed, opening = np.minimum(-allowance, 0.0), self.rows(self.owned) @ command
        kept = self.constraints.kept_other_m_s
        before = 0.0 if kept is None else kept - other
        return {
            "allowance_m_s": allowance,
            "needed_m_s": needed,
            "needs_more": opening < needed - slack,
            "short": allowance + opening < -slack,
            "others_alone": (allowance < 0.0) | (allowance + before + opening >= -slack),
        }

"""The time-to-collision strategy of a support arm, and what a priority arm does.

nominal     the tool's task and the criterion, by the inverse kinematics
allowance   the largest speed scale that keeps every time to collision at t_min (docs/theory.md section 5)
recovery    whether the arm yields, and what it tries against an impasse
avoidance   where the speed scale alone does not do: yield, slide past, leave the path
detour      past an obstacle with the tool off its path, where the scenario allows that
"""

from __future__ import annotations

import numpy as np

from workcell.control import avoidance, elbow
from workcell.control.arm_constraints import Allowance
from workcell.control.criteria import NullspaceObjective
from workcell.control.recovery import Recovery, RecoveryState
from workcell.control.scaling import FactorGovernor
from workcell.control.setpoints import REJOIN_M
from workcell.control.strategies import detour
from workcell.control.strategy import ArmView, StrategySetup
from workcell.control.tick import Array, Steering

LEAVING_FACTOR = 2.0
"""An arm that could go this many times faster before any pair limited it is leaving: its factor need not rise slowly."""
OUT_OF_REACH = "out_of_reach"
"""Reason of a priority arm whose target is beyond its reach: it goes to the nearest place there is."""
SELF_MOTION_RAD_S = 0.01
"""Joint speed beyond the tool task's own from which the mode is called self_motion; chosen as what a person notices."""


class TtcStrategy:
    """Steers one support arm.

    Args:
        setup: What it is made from. `factor_multiplier` multiplies the speed scale, and nothing corrects that.
    """

    def __init__(self, setup: StrategySetup):
        control, period_s = setup.settings, setup.period_s
        self._recovery = Recovery(
            period_s=period_s,
            yields=control.yields,
            resolves=control.resolves_impasse,
            detours=control.detour_m > 0.0,
        )
        self._governor = FactorGovernor(rise_per_s=1.0 / control.rise_time_s, period_s=period_s)
        self._multiplier = setup.factor_multiplier

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        setpoint = view.setpoint
        if setpoint.began:
            self._recovery.restart()
        elif setpoint.replanned:
            self._recovery.replanned()
        solution = view.solve(self._push(view))
        nominal = solution.velocity_rad_s
        allowance = view.allowance(nominal)
        state = self._advance(view, allowance)
        bound = allowance.bound
        answer = Steering(
            velocity_rad_s=nominal,
            nominal_rad_s=nominal,
            ik_status=solution.status,
            attempt=state.attempt,
            limiting_pair=int(view.owned[bound.pair]) if bound.pair >= 0 else None,
            path="pause"
            if state.paused
            else "reverse"
            if state.attempt == "back_off"
            else "follow",
            free_rotation=state.attempt == "free_rotation",
            another_approach=state.attempt == "re_enter",
        )
        if state.yielding:
            return self._yield(view, answer)
        if state.attempt == "detour":
            self._governor.resume(0.0)
            return detour.pass_by(view, solution)
        if view.settings.slow_down == "ttc" and bound.factor < 1.0 and _is_left(view, answer):
            return self._slide(view, answer)
        return self._scale(view, answer, allowance, state)

    def _advance(self, view: ArmView, allowance: Allowance) -> RecoveryState:
        jobs = view.jobs
        return self._recovery.advance(
            must_yield=allowance.must_yield,
            clock_s=0.0 if jobs is None else jobs.progress_s,
            moving=jobs is not None and jobs.moving,
            out_of_reach=view.setpoint.waits and allowance.bound.factor == 1.0,
            on_path=view.setpoint.tool_error_m < REJOIN_M,
        )

    def _push(self, view: ArmView) -> NullspaceObjective | None:
        """What the null space is for now instead of the criterion, by the attempt decided last."""
        attempt = view.last.attempt
        if attempt in ("elbow_left", "elbow_right") and view.self_motion:
            return elbow.push(view, 1.0 if attempt == "elbow_left" else -1.0)
        return None

    def _yield(self, view: ArmView, answer: Steering) -> Steering:
        found = avoidance.give_way(view, answer.nominal_rad_s)
        self._governor.resume(0.0)
        return answer._replace(
            velocity_rad_s=found.velocity_rad_s,
            nominal_rad_s=found.velocity_rad_s,
            clock_rate=found.factor,
            scale=found.factor,
            reason="other_arm",
            mode="yield",
            limiting_pair=answer.limiting_pair if found.missed_pair is None else found.missed_pair,
            ik_status=answer.ik_status if found.solved else "stopped",
        )

    def _slide(self, view: ArmView, answer: Steering) -> Steering:
        found = avoidance.slide(view, answer.nominal_rad_s)
        self._governor.resume(found.factor)
        return answer._replace(
            velocity_rad_s=found.velocity_rad_s,
            clock_rate=found.factor,
            scale=found.factor,
            reason="other_arm" if found.forced else "ttc",
            mode="scale",
            ik_status=answer.ik_status if found.solved else "stopped",
        )

    def _scale(
        self, view: ArmView, answer: Steering, allowance: Allowance, state: RecoveryState
    ) -> Steering:
        """Slow down along the path; leave it where that is not enough."""
        bound, nominal = allowance.bound, answer.nominal_rad_s
        choice = self._governor.choose(
            bound.factor, allowance.reach, leaving=bound.required >= LEAVING_FACTOR
        )
        factor = min(1.0, choice.factor * self._multiplier)
        velocity, reason = factor * nominal, "" if choice.limiter == "none" else choice.limiter
        if view.settings.slow_down == "ttc" and self._multiplier == 1.0:
            found = avoidance.keep(view, nominal, factor, choice.limiter == "infeasible")
            if found.left_path:
                self._governor.resume(found.factor)
            velocity, factor = found.velocity_rad_s, found.factor
            reason = "other_arm" if found.forced else reason
        scale = -factor if state.attempt == "back_off" else factor
        clock_rate = scale
        if bound.factor == 0.0 and not state.attempt and view.is_free(view.path_rad_s):
            # At d_min nothing may close, not even the last digits of a tool error. Where the path
            # itself leads away, its clock goes on: an arm that waited for its clock, and the
            # clock for the arm, would never leave.
            clock_rate = 1.0
        mode = _mode(view, answer.limiting_pair, scale)
        if mode in ("run", "scale") and state.impasse and not state.attempt:
            mode = "hold"  # whatever was to be tried has been
        return answer._replace(
            velocity_rad_s=velocity,
            clock_rate=clock_rate,
            scale=scale,
            reason="other_arm" if bound.shortfall_m_s > 0.0 else reason,
            mode=mode,
        )


class OperatorStrategy:
    """Steers one priority arm: what its operator asks, plus self-motion that endangers nothing."""

    def steer(self, view: ArmView) -> Steering:
        """See `strategy.Strategy`."""
        given = view.setpoint.joints_rad_s
        if given is not None:
            beyond = view.setpoint.out_of_reach_m is not None
            return Steering(
                velocity_rad_s=given,
                nominal_rad_s=given,
                reason=OUT_OF_REACH if beyond else "",
                ik_status="not_solved",
            )
        solution = view.solve(elbow.swing(view))
        velocity: Array = solution.velocity_rad_s
        beyond = np.abs(velocity - view.task_rad_s).max()
        return Steering(
            velocity_rad_s=velocity,
            nominal_rad_s=velocity,
            ik_status=solution.status,
            mode="self_motion" if beyond > SELF_MOTION_RAD_S else "run",
        )


def _is_left(view: ArmView, answer: Steering) -> bool:
    """Whether an arm retreats and is held by nothing but what it has just met."""
    jobs = view.jobs
    return jobs is not None and jobs.retreats and answer.limiting_pair in view.meeting.tolist()


def _mode(view: ArmView, limiting_pair: int | None, scale: float) -> str:
    jobs = view.jobs
    if jobs is None:
        return "run"
    if jobs.arrived:
        return "halt"
    if jobs.done or view.setpoint.doing == "wait":
        return "hold"
    if limiting_pair is not None and scale < 1.0:
        near = view.distance_m[limiting_pair] <= view.settings.d_min_m
        return "halt" if near else "scale"
    return "run"

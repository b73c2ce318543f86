"""What several strategies need: the nominal velocity without a criterion, barrier rows, the rate of the path's clock."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, Field

from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import IkSolution
from workcell.control.laws.pair_rule import smallest_rates
from workcell.control.strategy import ArmView
from workcell.control.tick import Array, Steering
from workcell.guard.halt import brake


class DeviationOptions(BaseModel, extra="forbid", frozen=True):
    """Options of a strategy that leaves the path."""

    deviation_m: float = Field(default=0.15, gt=0.0, le=1.0)
    """How far the tool may be off its path while the path's clock goes on. Chosen between the 8 and 25 cm with
    which such strategies finished `handover` in trials; held at 1 to 3 cm they all stand before the first obstacle."""


class Barrier(NamedTuple):
    """Rows that say t >= t_min for the pairs an arm moves: rows @ x >= needed_m_s."""

    rows: Array
    """(K, n)"""
    needed_m_s: Array
    """(K,)"""
    pairs: np.ndarray
    """(K,) pair numbers."""


def nominal(view: ArmView) -> IkSolution:
    """The tool's task within the joint limits, without a criterion."""
    return view.solve(NullspaceObjective.nothing(len(view.dofs)))


def barrier(view: ArmView, *, others: bool, margin_m: float = 0.0) -> Barrier:
    """ḋ >= -(d - δ)/t_min for every pair that the arm can move (docs/theory.md section 5).

    δ is d_min, so that an arm comes to rest there; 0 for what is to meet, which otherwise never would.

    Args:
        view: The arm.
        others: Whether the rates that others are predicted to cause count; otherwise they stand.
        margin_m: Added to d_min.
    """
    settings, moved = view.settings, view.moved
    rows = view.rows(moved)
    movable = rows.any(axis=1)
    rows, pairs = rows[movable], moved[movable]
    standoff = np.where(np.isin(pairs, view.meeting), 0.0, settings.d_min_m + margin_m)
    other = view.other_m_s[pairs] if others else np.zeros(len(pairs))
    needed = np.empty(len(pairs))
    smallest_rates(view.distance_m[pairs] - standoff, other, settings.t_min_s, 0.0, needed)
    return Barrier(rows, needed, pairs)


def clock_rate(view: ArmView, deviation_m: float) -> float:
    """1 with the tool near its path, 0 at the largest deviation, straight in between from half of it on."""
    return float(np.clip(2.0 - 2.0 * view.setpoint.tool_error_m / deviation_m, 0.0, 1.0))


def answer(
    view: ArmView,
    velocity_rad_s: Array | None,
    nominal_rad_s: Array,
    *,
    status: str,
    clock: float,
    limiting_pair: int | None,
    off_path_m: float,
) -> Steering:
    """The answer of a strategy that may leave its path; it brakes where its solver failed (None)."""
    if velocity_rad_s is None:
        velocity = brake(view.command_rad_s, view.limits.acceleration_limit_rad_s2, view.period_s)
        return Steering(
            velocity,
            velocity,
            clock_rate=0.0,
            scale=0.0,
            mode="hold",
            reason="infeasible",
            ik_status="stopped",
        )
    along = float(velocity_rad_s @ nominal_rad_s) / max(float(nominal_rad_s @ nominal_rad_s), 1e-12)
    changed = limiting_pair is not None
    return Steering(
        velocity_rad_s,
        velocity_rad_s,
        clock_rate=clock,
        scale=min(1.0, max(0.0, along)) if changed else 1.0,
        mode=finished(view) or ("scale" if changed else "run"),
        reason="ttc" if changed else "",
        limiting_pair=limiting_pair,
        ik_status=status,
        off_path_m=off_path_m,
    )


def finished(view: ArmView) -> str:
    """`halt` at what was to be met, `hold` while waiting or done, empty while there is motion to make."""
    jobs = view.jobs
    if jobs is None:
        return ""
    if jobs.arrived:
        return "halt"
    return "hold" if jobs.done or view.setpoint.doing == "wait" else ""


def binding(rows: Barrier, velocity_rad_s: Array) -> int | None:
    """The pair whose row a velocity (n,) leaves least room; None where no row is tight."""
    if not len(rows.pairs):
        return None
    slack = rows.rows @ velocity_rad_s - rows.needed_m_s
    tightest = int(np.argmin(slack))
    return int(rows.pairs[tightest]) if slack[tightest] < 1e-4 else None

"""The quadratic program of an arm's inverse kinematics, in daqp's form (docs/theory.md section 7).

    minimise    1/2 q' H q' + c q'      H = I + gain H_criterion, c = gain c_criterion
    subject to  the joint box,  rows q' >= bounds (the rule on self-motion),  the tool's rows q' = rates

Constraints stand in daqp's order: the box on the joints, then the rows of pairs, then those of the tool.
"""

from __future__ import annotations

import math

from workcell.control.laws import law
from workcell.control.laws.criteria import (
    ARTC_HELD,
    GIVEN,
    NO_CRITERION,
    objective,
    push_from_stops,
)
from workcell.control.laws.joint_limits import joint_box
from workcell.control.laws.pair_rule import predicted_rates, self_motion_rows
from workcell.control.laws.quadprog import NO_ANSWER, solve

FINE, PAIR_NOT_FINITE, JOINT_NOT_FINITE, PROGRAM_NOT_FINITE = 0, 1, 2, 3
"""What is answered: all is well; the pair or joint that follows has a number that is not finite; the program has one."""

UNBOUNDED = 1e30
"""daqp's infinity."""
HARD, EQUALITY, SOFT = 0, 5, 8
"""daqp's marks of constraints: an inequality; met exactly; violated as little as need be."""


@law
def least_motion(gain, H, c):
    """H (n, n) and c (n,) of a criterion become those of the program: H = I + gain H, c = gain c."""
    for k in range(len(c)):
        c[k] = gain * c[k]
        for m in range(len(c)):
            H[k, m] = (1.0 if k == m else 0.0) + gain * H[k, m]


@law
def constrain(
    H, c, smallest, largest, bounds, pairs, pairs_mark, tool_rows, tool_rates, tool, rows, lower,
    upper, sense,
):  # fmt: skip
    """Write a program's constraints, and see that all of it is finite.

    Args:
        H, c: (n, n) and (n,) its objective, read.
        smallest, largest: (n,) the joint box.
        bounds: (pairs,) or longer: smallest rate of the first rows, which are in `rows` already.
        pairs: How many of these there are.
        pairs_mark: `HARD` or `SOFT`.
        tool_rows, tool_rates: (6, n) and (6,).
        tool: How many of the tool's rows are asked for exactly.
        rows: (pairs + tool, n) or longer; the tool's are written.
        lower, upper, sense: (n + pairs + tool,) or longer, written.

    Returns:
        Whether every number is finite.
    """
    n = len(c)
    given = 0.0
    for k in range(n):
        given += smallest[k] + largest[k] + c[k]
        for m in range(n):
            given += H[k, m]
        lower[k], upper[k] = max(smallest[k], -UNBOUNDED), min(largest[k], UNBOUNDED)
        sense[k] = HARD
    for k in range(pairs):
        given += bounds[k]
        for m in range(n):
            given += rows[k, m]
        lower[n + k], upper[n + k], sense[n + k] = bounds[k], UNBOUNDED, pairs_mark
    for k in range(tool):
        given += tool_rates[k]
        for m in range(n):
            rows[pairs + k, m] = tool_rows[k, m]
            given += tool_rows[k, m]
        at = n + pairs + k
        lower[at], upper[at], sense[at] = tool_rates[k], tool_rates[k], EQUALITY
    return math.isfinite(given)


@law
def arm_program(
    jacobian, distance, rate, velocities, change, foreign, moved, averaged, dof, task, qvel, kind, own_rates,
    push_hessian, push, gain, t_min, standoff, d_min, qpos, address, lower_rad, upper_rad, fastest, acceleration,
    previous, period, tool_rows, tool_rates, tool, other, work, rows, bounds, smallest, largest, H, c,
    lower, upper, sense, addresses, problem, result, x, tolerance, settled,
):  # fmt: skip
    """An arm's program from the state of the cell, solved: what the others may do, the criterion, the rule, the tool.

    Args:
        jacobian, distance, rate: G (P, nv), d (P,), d' (P,).
        velocities, change: (K, nv), (nv,) predicted of the other arms; see `pair_rule.predicted_rates`.
        foreign: Their joints.
        moved: Pairs that the arm moves.
        averaged: Pairs of the criterion.
        dof: (n,) joints of the arm.
        task: (n,) least motion that does what the tool is to do.
        qvel: (nv,) measured velocities.
        kind: The criterion; see `criteria.objective`.
        own_rates: Whether the criterion takes what closes from the arm's own part of the rates.
        push_hessian, push: (n, n) and (n,) what the null space is for where `kind` is `NO_CRITERION` or `GIVEN`.
        gain: Weight of the criterion.
        t_min, standoff, d_min: Of the rule.
        qpos, address, lower_rad, upper_rad, fastest, acceleration, previous, period: Of `joint_limits.joint_box`.
        tool_rows, tool_rates, tool: Of `constrain`.
        other: (P,) written: rates that the others may cause.
        work: (P,) for use inside.
        rows, bounds, smallest, largest, H, c, lower, upper, sense: The program, written; see `constrain`.
        addresses, problem, result, x, tolerance, settled: As in `quadprog.solve`.

    Returns:
        A code with the pair or joint that it is about, how many pairs have rows, and the solver's answer.
    """
    bad = predicted_rates(jacobian, moved, foreign, velocities, change, other)
    if bad >= 0:
        return PAIR_NOT_FINITE, bad, 0, NO_ANSWER
    closing = rate
    if kind == ARTC_HELD:
        closing = work[: len(rate)]
        for pair in averaged:
            held = other[pair]
            for k in range(len(dof)):
                held += jacobian[pair, dof[k]] * task[k]
            closing[pair] = held
    elif own_rates:
        closing = work[: len(rate)]
        for pair in averaged:
            own = 0.0
            for k in range(len(dof)):
                own += jacobian[pair, dof[k]] * qvel[dof[k]]
            closing[pair] = own
    bad = objective(kind, jacobian, distance, closing, other, averaged, dof, H, c)
    if bad >= 0:
        return PAIR_NOT_FINITE, bad, 0, NO_ANSWER
    if kind in (NO_CRITERION, GIVEN):
        H[:, :], c[:] = push_hessian, push
    if kind != NO_CRITERION and gain != 0.0:
        bad = push_from_stops(qpos, address, lower_rad, upper_rad, gain, c)
        if bad >= 0:
            return JOINT_NOT_FINITE, bad, 0, NO_ANSWER
    least_motion(gain, H, c)
    count, bad = self_motion_rows(
        jacobian, distance, other, moved, dof, task, fastest, t_min, standoff, d_min, rows, bounds
    )
    if bad >= 0:
        return PAIR_NOT_FINITE, bad, 0, NO_ANSWER
    bad = joint_box(
        qpos, address, lower_rad, upper_rad, fastest, acceleration, previous, period, smallest,
        largest,
    )  # fmt: skip
    if bad >= 0:
        return JOINT_NOT_FINITE, bad, 0, NO_ANSWER
    sound = constrain(
        H, c, smallest, largest, bounds, count, HARD, tool_rows, tool_rates, tool, rows, lower,
        upper, sense,
    )  # fmt: skip
    if not sound:
        return PROGRAM_NOT_FINITE, -1, count, NO_ANSWER
    answer = solve(
        addresses, problem, result, x, len(c) + count + tool, smallest, largest, tolerance, settled
    )
    return FINE, -1, count, answer


@law
def predicted_motion(
    qpos, address, lower_rad, upper_rad, fastest, acceleration, previous, period, wanted, tool_rows,
    tool_rates, tool, rows, bounds, smallest, largest, H, c, lower, upper, sense, followed,
    addresses, problem, result, x, tolerance, settled,
):  # fmt: skip
    """What an arm does of a wanted velocity: joint by joint, and by the least motion that moves the tool as asked.

    Args:
        qpos, address, lower_rad, upper_rad, fastest, acceleration, previous, period: Of `joint_limits.joint_box`.
        wanted: (n,).
        tool_rows, tool_rates, tool: Of `constrain`.
        rows, bounds, smallest, largest, H, c, lower, upper, sense: The program, written; see `constrain`.
        followed: (n,) written: what each joint's limits let through.
        addresses, problem, result, x, tolerance, settled: As in `quadprog.solve`; asked only where the limits cut something off.

    Returns:
        A code with the joint that it is about, whether nothing is cut off, and the solver's answer.
    """
    bad = joint_box(
        qpos, address, lower_rad, upper_rad, fastest, acceleration, previous, period, smallest,
        largest,
    )  # fmt: skip
    if bad >= 0:
        return JOINT_NOT_FINITE, bad, False, NO_ANSWER
    whole = True
    for k in range(len(wanted)):
        if not math.isfinite(wanted[k]):
            return JOINT_NOT_FINITE, k, False, NO_ANSWER
        followed[k] = min(max(wanted[k], smallest[k]), largest[k])
        whole = whole and followed[k] == wanted[k]
    if whole:
        return FINE, -1, True, NO_ANSWER
    for k in range(len(c)):
        c[k] = 0.0
        for m in range(len(c)):
            H[k, m] = 1.0 if k == m else 0.0
    if not constrain(
        H, c, smallest, largest, bounds, 0, HARD, tool_rows, tool_rates, tool, rows, lower, upper,
        sense,
    ):  # fmt: skip
        return PROGRAM_NOT_FINITE, -1, False, NO_ANSWER
    answer = solve(
        addresses, problem, result, x, len(c) + tool, smallest, largest, tolerance, settled
    )
    return FINE, -1, False, answer

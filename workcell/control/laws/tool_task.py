"""The tool task: error, rows and the smallest motion that does it (docs/theory.md section 7).

The error is the twist that turns and moves the tool into its target within one second, as the logarithm of
the motion between them, in the tool's frame. Its rows are minus the inverse left Jacobian of that motion times the
tool's Jacobian, so that J q' = rates makes the error fall at the gain's rate whatever its size. This is mink's
frame task with two additions: the target's own velocity is fed forward, and the speed of correction is bounded.
"""

from __future__ import annotations

import math

from workcell.control.laws import law, part
from workcell.control.laws.vectors import (
    cross,
    dot,
    into_frame,
    into_frame_of_quaternion,
    length,
    minus,
    plus,
    quaternion,
    row,
    second_half,
    times,
)

FINE, TARGET_NOT_FINITE, STATE_NOT_FINITE = 0, 1, 2
"""What `tool_task` answers."""

LEAST_MOTION_DAMPING = 1e-6
"""Regularises the least-norm solution near singular configurations; small against J J' of order 0.1."""
SMALL_TURN_SQUARED = 1e-10
"""Square of the angle below which frames count as turned alike, as mink takes them for its Jacobian."""
SMALL_ANGLE_RAD = 0.1
"""Angle below which power series replace quotients of differences that would lose their digits; the terms
written leave out less than 1e-15 at this angle, the quotients lose no more above it."""


@law
def tool_task(
    site_xpos, site_xmat, cdof, subtree_com, site, dof, dof_root, moves, position, wxyz, velocity,
    turn, gain, period, catch_up, turn_length, size, rows, rates, gram, solved, whole, path,
):  # fmt: skip
    """Rows and rates of a tool's task, and the least motion that does it.

    Args:
        site_xpos, site_xmat, cdof, subtree_com: MuJoCo's arrays of these names.
        site: The tool's site.
        dof: (n,) joints of the arm.
        dof_root: (n,) root body of their tree.
        moves: (n,) which of them move the tool.
        position, wxyz: (3,) and (4,) pose of the target in the world.
        velocity, turn: (3,) and (3,) its linear and angular velocity in the world, m/s and rad/s.
        gain: Part of the error made good in a period, in (0, 1].
        period: In s.
        catch_up: Largest speed at which an error is made good, m/s; may be infinite.
        turn_length: Length that a radian counts as in it, m.
        size: How many of the six directions count: 6, 5 without the rotation about the tool's own axis, 3 for the
            position alone.
        rows: (6, n), written.
        rates: (6,) in m/s and rad/s, written: rows q' = rates.
        gram, solved: (6, 6) and (2, 6) for use inside.
        whole: (n,) the least motion for all of it, rad/s, written.
        path: (n,) the part of it that the target's own motion asks for, written.

    Returns:
        `FINE`, `TARGET_NOT_FINITE` or `STATE_NOT_FINITE`; distance to the target, m, and angle, rad.
    """
    given = wxyz[0] + wxyz[1] + wxyz[2] + wxyz[3]
    for axis in range(3):
        given += position[axis] + velocity[axis] + turn[axis]
    if not math.isfinite(given):
        return TARGET_NOT_FINITE, math.nan, math.nan
    target = wxyz[0], wxyz[1], wxyz[2], wxyz[3]
    here = row(site_xpos, site)
    phi, angle = _turn_to(quaternion(site_xmat, site), target)
    offset = (position[0] - here[0], position[1] - here[1], position[2] - here[2])
    rho = _inverse_left(phi, into_frame(site_xmat, site, offset))
    _rates(rho, phi, target, velocity, turn, gain, period, catch_up, turn_length, rates, solved)
    _rows(rho, phi, site_xmat, cdof, subtree_com, site, here, dof, dof_root, moves, rows)
    if not _least_motions(rows, rates, size, gram, solved, whole, path):
        return STATE_NOT_FINITE, math.nan, math.nan
    return FINE, length(offset), angle


@part
def _turn_to(a, t):
    """Logarithm of the turn from quaternion a to t as seen from a, conj(a) t, rad; and its angle."""
    w = a[0] * t[0] + a[1] * t[1] + a[2] * t[2] + a[3] * t[3]
    v = (
        a[0] * t[1] - a[1] * t[0] - a[2] * t[3] + a[3] * t[2],
        a[0] * t[2] - a[2] * t[0] - a[3] * t[1] + a[1] * t[3],
        a[0] * t[3] - a[3] * t[0] - a[1] * t[2] + a[2] * t[1],
    )
    if w < 0.0:
        w, v = -w, times(-1.0, v)
    sine = length(v)
    angle = 2.0 * math.atan2(sine, w)
    return (times(angle / sine, v) if sine > 0.0 else (0.0, 0.0, 0.0)), angle


@part
def _rates(rho, phi, target, velocity, turn, gain, period, catch_up, turn_length, rates, solved):
    """Rates of the whole task, and of the target's own motion in the second row of `solved`."""
    rate = -gain / period
    # What the target does by itself, in its own frame; the gain is taken out of it again.
    ahead_v = times(
        period / gain, into_frame_of_quaternion(target, (velocity[0], velocity[1], velocity[2]))
    )
    ahead_w = times(period / gain, into_frame_of_quaternion(target, (turn[0], turn[1], turn[2])))
    catching_v, catching_w = times(rate, rho), times(rate, phi)
    if catch_up < math.inf:
        turning = turn_length * length(catching_w)
        speed = math.sqrt(dot(catching_v, catching_v) + turning * turning)
        if speed > catch_up:
            catching_v = times(catch_up / speed, catching_v)
            catching_w = times(catch_up / speed, catching_w)
    own_v, own_w = times(rate, ahead_v), times(rate, ahead_w)
    for axis in range(3):
        rates[axis] = catching_v[axis] + own_v[axis]
        rates[3 + axis] = catching_w[axis] + own_w[axis]
        solved[1, axis], solved[1, 3 + axis] = own_v[axis], own_w[axis]


@part
def _rows(rho, phi, site_xmat, cdof, subtree_com, site, here, dof, dof_root, moves, rows):
    """Minus the inverse left Jacobian at (rho, phi) times the tool's Jacobian in its own frame, (6, n)."""
    turned_alike = dot(phi, phi) < SMALL_TURN_SQUARED
    for k in range(len(dof)):
        if not moves[k]:
            for component in range(6):
                rows[component, k] = 0.0
            continue
        joint = dof[k]
        omega = row(cdof, joint)
        lever = minus(here, row(subtree_com, dof_root[k]))
        linear = into_frame(site_xmat, site, plus(second_half(cdof, joint), cross(omega, lever)))
        angular = into_frame(site_xmat, site, omega)
        if not turned_alike:
            angular = _inverse_left(phi, angular)
            linear = _inverse_left(phi, minus(linear, _coupling(rho, phi, angular)))
        for axis in range(3):
            rows[axis, k], rows[3 + axis, k] = -linear[axis], -angular[axis]


@part
def _least_motions(rows, rates, size, gram, solved, whole, path):
    """The least motions, J' (J J' + damping)^-1 rates by Cholesky's factor; false where they are not finite."""
    for m in range(size):
        solved[0, m] = rates[m]
        for n in range(m + 1):
            total = LEAST_MOTION_DAMPING if m == n else 0.0
            for k in range(len(whole)):
                total += rows[m, k] * rows[n, k]
            for k in range(n):
                total -= gram[m, k] * gram[n, k]
            if m == n:
                if not (total > 0.0 and total < math.inf):
                    return False
                gram[m, m] = math.sqrt(total)
            else:
                gram[m, n] = total / gram[n, n]
    for which in range(2):
        for m in range(size):
            for k in range(m):
                solved[which, m] -= gram[m, k] * solved[which, k]
            solved[which, m] /= gram[m, m]
        for back in range(size):
            m = size - 1 - back
            for k in range(m + 1, size):
                solved[which, m] -= gram[k, m] * solved[which, k]
            solved[which, m] /= gram[m, m]
    for k in range(len(whole)):
        whole[k] = path[k] = 0.0
        for m in range(size):
            whole[k] += solved[0, m] * rows[m, k]
            path[k] += solved[1, m] * rows[m, k]
        if not (math.isfinite(whole[k]) and math.isfinite(path[k])):
            return False
    return True


@part
def _inverse_left(phi, a):
    """The inverse left Jacobian of rotations at phi, times a: a - phi x a / 2 + beta phi x (phi x a)."""
    square = dot(phi, phi)
    if square < SMALL_ANGLE_RAD * SMALL_ANGLE_RAD:
        beta = 1 / 12 + square * (1 / 720 + square * (1 / 30240 + square * (1 / 1209600)))
    else:
        angle = math.sqrt(square)
        beta = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / square
    once = cross(phi, a)
    twice = cross(phi, once)
    return plus(minus(a, times(0.5, once)), times(beta, twice))


@part
def _coupling(rho, phi, a):
    """The upper right block of the left Jacobian of motions at (rho, phi), times a.

    With R and P the cross product matrices of rho and phi: R/2 + b (PR + RP + PRP)
    - c (PPR + RPP - 3 PRP) - (c - 3 e)/2 (PRPP + PPRP), b = (x - sin x)/x^3,
    c = (1 - x^2/2 - cos x)/x^4, e = (x - sin x - x^3/6)/x^5.
    """
    square = dot(phi, phi)
    if square < SMALL_ANGLE_RAD * SMALL_ANGLE_RAD:
        b = 1 / 6 - square * (1 / 120 - square * (1 / 5040 - square * (1 / 362880)))
        c = -1 / 24 + square * (1 / 720 - square * (1 / 40320 - square * (1 / 3628800)))
        e = -1 / 120 + square * (1 / 5040 - square * (1 / 362880 - square * (1 / 39916800)))
    else:
        x = math.sqrt(square)
        b = (x - math.sin(x)) / (square * x)
        c = (1.0 - 0.5 * square - math.cos(x)) / (square * square)
        e = (x - math.sin(x) - square * x / 6.0) / (square * square * x)
    p, r = cross(phi, a), cross(rho, a)
    pp, pr, rp = cross(phi, p), cross(phi, r), cross(rho, p)
    ppr, prp, rpp = cross(phi, pr), cross(phi, rp), cross(rho, pp)
    prpp, pprp = cross(phi, rpp), cross(phi, prp)
    out = plus(times(0.5, r), times(b, plus(plus(pr, rp), prp)))
    out = minus(out, times(c, minus(plus(ppr, rpp), times(3.0, prp))))
    return minus(out, times(0.5 * (c - 3.0 * e), plus(prpp, pprp)))

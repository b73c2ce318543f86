"""The tick's arithmetic, one pair at a time: what is compiled (docs/theory.md sections 2 to 6).

Each function says again, in scalars, what a NumPy function of `workcell.control` says for all pairs at
once; that function's docstring has the equations and the reasons, and its name is given here. None
allocates anything, none raises: what it cannot answer it leaves to NumPy (`answer[0] = REFUSED`).
Arguments are those of `arguments.SIGNATURES`. Numbers are added in the order written, on every machine:
nothing here may be reordered for speed (no fastmath).
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from workcell.control.kernels.arguments import DONE, REFUSED

# The tolerances of the NumPy code; tests/control/test_kernels.py holds them equal.
CROSSING_TOLERANCE_M = 1e-9
COINCIDENT_TOLERANCE_M = 1e-9
SURFACE_TOLERANCE_M = 1e-6
CROSSING_PARALLEL_SINE = 1e-6
PARALLEL_SIN_SQUARED = 1e-8
CLAMPED_TOLERANCE = 1e-9
FACE_MARGIN_M = 1e-6
GRAZING_TOLERANCE = 1e-12
DISTANCE_FLOOR_M = 1e-3
LEAST_MOTION_DAMPING = 1e-6
MINK_SMALL_TURN_SQUARED = 1e-10
UNBOUNDED = 1e30
EQUALITY = 5

SMALL_ANGLE_RAD = 0.1
"""Angle below which power series replace quotients of differences that would lose their digits; the terms
written leave out less than 1e-15 at this angle, the quotients lose no more above it."""

ARTC_SIGNED, ARTC_APPROACHING, ARMD, NONE, PUSH = 0, 1, 2, 3, 4
"""Values of the size `kind`; the last two only where the null space is for nothing, or for a push."""

# Division by zero gives infinity or NaN, as in NumPy; nothing is allocated, so nothing needs counting.
_OPTIONS: Any = {"error_model": "numpy", "_nrt": False}
_compiled = njit(**_OPTIONS)

# ---------------------------------------------------------------- vectors of three


@_compiled
def _row(array, k):
    return array[k, 0], array[k, 1], array[k, 2]


@_compiled
def _put(array, k, a):
    array[k, 0], array[k, 1], array[k, 2] = a


@_compiled
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_compiled
def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@_compiled
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@_compiled
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@_compiled
def _times(s, a):
    return s * a[0], s * a[1], s * a[2]


@_compiled
def _length(a):
    return math.sqrt(_dot(a, a))


@_compiled
def _half_axis(geom_xmat, geom, half_length):
    """From a geom's centre to an end of its axis, in the world."""
    return (
        geom_xmat[geom, 2] * half_length,
        geom_xmat[geom, 5] * half_length,
        geom_xmat[geom, 8] * half_length,
    )


# ---------------------------------------------------------------- distances and G


@_compiled
def _nearest_on_axis(point, centre, half, half_length):
    """`proximity._nearest_on_axis`."""
    along = 0.0
    if half_length > 0.0:
        along = _dot(_minus(point, centre), half) * (1.0 / (half_length * half_length))
        along = min(1.0, max(-1.0, along))
    return _plus(centre, _times(along, half))


@_compiled
def _perpendicular(u, v):
    """`proximity._perpendicular`."""
    crossed = _cross(u, v)
    if _length(crossed) > CROSSING_PARALLEL_SINE * (_length(u) * _length(v)):
        return crossed
    longer = u if _dot(u, u) >= _dot(v, v) else v
    x, y, z = abs(longer[0]), abs(longer[1]), abs(longer[2])
    if x <= y and x <= z:
        return _cross(longer, (1.0, 0.0, 0.0))
    if y <= z:
        return _cross(longer, (0.0, 1.0, 0.0))
    return _cross(longer, (0.0, 0.0, 1.0))


@_compiled
def measure(
    pairs, joints, geoms, bodies, sensors,
    sensordata, geom_xpos, geom_xmat, cdof, subtree_com, sensor_adr, geom, dof_root, radius,
    half_length, sign, screws, distance, normal, witness_i, witness_j, surface_i, surface_j,
    jacobian, degenerate, answer,
):  # fmt: skip
    """`PairGeometry.measure`."""
    answer[0] = DONE
    for joint in range(joints):
        omega = (cdof[joint, 0], cdof[joint, 1], cdof[joint, 2])
        moment = _cross(_row(subtree_com, dof_root[joint]), omega)
        for axis in range(3):
            screws[axis, joint] = omega[axis]
            screws[3 + axis, joint] = cdof[joint, 3 + axis] + moment[axis]
    for pair in range(pairs):
        at = sensor_adr[pair]
        on_i = (sensordata[at], sensordata[at + 1], sensordata[at + 2])
        on_j = (sensordata[at + 3], sensordata[at + 4], sensordata[at + 5])
        reading = _dot(on_i, on_i) + _dot(on_j, on_j)
        if reading == 0.0 or not math.isfinite(reading):
            answer[0] = REFUSED
            return
        _put(surface_i, pair, on_i)
        _put(surface_j, pair, on_j)
        geom_i, geom_j = geom[pair, 0], geom[pair, 1]
        centre_i, centre_j = _row(geom_xpos, geom_i), _row(geom_xpos, geom_j)
        half_i = _half_axis(geom_xmat, geom_i, half_length[pair, 0])
        half_j = _half_axis(geom_xmat, geom_j, half_length[pair, 1])
        radius_i, radius_j = radius[pair, 0], radius[pair, 1]
        radii = radius_i + radius_j
        round_i, round_j = radius_i > 0.0, radius_j > 0.0
        at_i, at_j = on_i, on_j
        if round_i:
            at_i = _nearest_on_axis(on_i, centre_i, half_i, half_length[pair, 0])
        if round_j:
            at_j = _nearest_on_axis(on_j, centre_j, half_j, half_length[pair, 1])
        gap = _minus(on_i, on_j)
        chosen = False
        if round_i and round_j:
            along = _minus(at_i, at_j)
            away = _length(along) - radii
            gap_m = _length(gap)
            if away < CROSSING_TOLERANCE_M and 2.0 * gap_m > radii:
                inwards = _times(-1.0, (gap[0] / gap_m, gap[1] / gap_m, gap[2] / gap_m))
                along, away = inwards, -gap_m
                at_i = _plus(on_i, _times(radius_i, inwards))
                at_j = _minus(on_j, _times(radius_j, inwards))
                if gap_m > radii - CROSSING_TOLERANCE_M:
                    along, chosen = _perpendicular(half_i, half_j), True
        elif round_i or round_j:
            along = _minus(at_i, on_i) if round_i else _times(-1.0, _minus(at_j, on_j))
            to_axis_m = _length(along)
            away = 0.0 if to_axis_m == 0.0 else _dot(along, gap) / to_axis_m
            if math.isfinite(away) and abs(to_axis_m - radii) > SURFACE_TOLERANCE_M:
                away, chosen = min(away, -radii), True
        else:
            centres = _minus(centre_i, centre_j)
            gap_m = _length(gap)
            side = -1.0 if _dot(gap, _minus(centres, gap)) < 0.0 else 1.0
            along, away = _times(side, gap), side * gap_m
            if gap_m < COINCIDENT_TOLERANCE_M:
                along, chosen = centres, True
        along_m = _length(along)
        if along_m == 0.0:
            along, along_m, chosen = (1.0, 0.0, 0.0), 1.0, True
        if not math.isfinite(away):
            answer[0] = REFUSED
            return
        n = (along[0] / along_m, along[1] / along_m, along[2] / along_m)
        distance[pair], degenerate[pair] = away, chosen
        _put(normal, pair, n)
        _put(witness_i, pair, at_i)
        _put(witness_j, pair, at_j)
        torque = _cross(at_i, n)
        for joint in range(joints):
            jacobian[pair, joint] = sign[pair, joint] * (
                torque[0] * screws[0, joint]
                + torque[1] * screws[1, joint]
                + torque[2] * screws[2, joint]
                + n[0] * screws[3, joint]
                + n[1] * screws[4, joint]
                + n[2] * screws[5, joint]
            )


# ---------------------------------------------------------------- second time derivative


@_compiled
def _upper(array, k):
    return array[k, 3], array[k, 4], array[k, 5]


@_compiled
def _may_slide(offset, half):
    """`second_order._may_slide`."""
    return abs(_dot(offset, half)) < (1.0 - CLAMPED_TOLERANCE) * _dot(half, half)


@_compiled
def _on_face(geom_xmat, geom, centre, face, pair, end, point):
    """`second_order._on_face`."""
    offset = _minus(point, centre)
    inside = 0
    for axis in range(3):
        local = (
            geom_xmat[geom, axis] * offset[0]
            + geom_xmat[geom, 3 + axis] * offset[1]
            + geom_xmat[geom, 6 + axis] * offset[2]
        )
        inside += abs(local) < face[pair, end, axis] - FACE_MARGIN_M
    return inside >= 2


@_compiled
def second_order(
    pairs, joints, geoms, bodies,
    geom_xpos, geom_xmat, cdof, cdof_dot, subtree_com, qvel, qacc, body_parent, body_root, dof_body,
    geom, body, radius, half_length, face, witness_i, witness_j, normal, degenerate, twist, change,
    accel, exact, parallel, answer,
):  # fmt: skip
    """`second_order.second_order`."""
    answer[0] = DONE
    joint = 0
    for link in range(bodies):
        for axis in range(6):
            twist[link, axis] = twist[body_parent[link], axis] if link else 0.0
            change[link, axis] = change[body_parent[link], axis] if link else 0.0
        while joint < joints and dof_body[joint] == link:
            for axis in range(6):
                twist[link, axis] += cdof[joint, axis] * qvel[joint]
                change[link, axis] += (
                    cdof_dot[joint, axis] * qvel[joint] + cdof[joint, axis] * qacc[joint]
                )
            joint += 1
    for pair in range(pairs):
        n, at_i, at_j = _row(normal, pair), _row(witness_i, pair), _row(witness_j, pair)
        geom_i, geom_j = geom[pair, 0], geom[pair, 1]
        body_i, body_j = body[pair, 0], body[pair, 1]
        omega_i, omega_j = _row(twist, body_i), _row(twist, body_j)
        arm_i = _minus(at_i, _row(subtree_com, body_root[body_i]))
        arm_j = _minus(at_j, _row(subtree_com, body_root[body_j]))
        velocity_i = _plus(_upper(twist, body_i), _cross(omega_i, arm_i))
        velocity_j = _plus(_upper(twist, body_j), _cross(omega_j, arm_j))
        acceleration_i = _plus(
            _plus(_upper(change, body_i), _cross(_row(change, body_i), arm_i)),
            _cross(omega_i, velocity_i),
        )
        acceleration_j = _plus(
            _plus(_upper(change, body_j), _cross(_row(change, body_j), arm_j)),
            _cross(omega_j, velocity_j),
        )
        centre_i, centre_j = _row(geom_xpos, geom_i), _row(geom_xpos, geom_j)
        u = _half_axis(geom_xmat, geom_i, half_length[pair, 0])
        v = _half_axis(geom_xmat, geom_j, half_length[pair, 1])
        free_i = _may_slide(_minus(at_i, centre_i), u)
        free_j = _may_slide(_minus(at_j, centre_j), v)
        between = _minus(at_i, at_j)
        relative = _minus(velocity_i, velocity_j)
        direct = _dot(n, _minus(acceleration_i, acceleration_j))
        round_i, round_j = radius[pair, 0] > 0.0, radius[pair, 1] > 0.0
        parallel[pair] = False
        if round_i and round_j:
            # The witness points slide so that they stay the nearest ones (`_sliding`).
            uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
            turned_i, turned_j = _cross(omega_i, u), _cross(omega_j, v)
            drift_i = _dot(turned_i, between) + _dot(u, relative)
            drift_j = _dot(turned_j, between) + _dot(v, relative)
            determinant = uu * vv - uv * uv
            offset = _dot(u, between)
            alike = (
                uu > 0.0
                and vv > 0.0
                and determinant <= PARALLEL_SIN_SQUARED * uu * vv
                and offset * offset <= PARALLEL_SIN_SQUARED * uu * _dot(between, between)
            )
            slide_i = slide_j = 0.0
            if free_i and free_j and not alike:
                slide_i = (uv * drift_j - vv * drift_i) / determinant
                slide_j = (uu * drift_j - uv * drift_i) / determinant
            else:
                if free_i and not free_j:
                    slide_i = -drift_i / uu
                if free_j:
                    slide_j = drift_j / vv
            turning = _minus(_times(slide_i, turned_i), _times(slide_j, turned_j))
            across = _minus(_plus(relative, _times(slide_i, u)), _times(slide_j, v))
            across = _minus(across, _times(_dot(n, across), n))
            axis_m = _length(between)
            apart = axis_m > CROSSING_TOLERANCE_M
            swing = _dot(across, relative) / axis_m if apart else 0.0
            value = direct + _dot(n, turning) + swing
            parallel[pair] = alike
            sure = apart and not alike
        else:
            # The flat geom is the half space behind its witness point, turning with it.
            flat_is_i = round_j
            turned = _cross(omega_i if flat_is_i else omega_j, n)
            value = direct + 2.0 * _dot(turned, relative) - _dot(n, between) * _dot(turned, turned)
            if flat_is_i:
                sure = not free_j and _on_face(geom_xmat, geom_i, centre_i, face, pair, 0, at_i)
            else:
                sure = (
                    round_i
                    and not free_i
                    and _on_face(geom_xmat, geom_j, centre_j, face, pair, 1, at_j)
                )
        if not math.isfinite(value):
            answer[0] = REFUSED
            return
        accel[pair] = value
        exact[pair] = sure and not degenerate[pair]


# ---------------------------------------------------------------- time to collision


@_compiled
def reciprocal_first_order(pairs, distance, rate, setting, kappa, answer):
    """`ttc.reciprocal_first_order`; the setting is its standoff."""
    answer[0] = DONE
    for pair in range(pairs):
        d, speed = distance[pair], rate[pair]
        if not (math.isfinite(d) and math.isfinite(speed)):
            answer[0] = REFUSED
            return
        gap = d - setting[0]
        if d <= 0.0 or (gap <= 0.0 and speed < 0.0):
            kappa[pair] = math.inf
        elif speed < 0.0:
            kappa[pair] = -speed / gap
        else:
            kappa[pair] = 0.0


@_compiled
def _second_order(d, speed, a, gap):
    """One entry of `ttc.reciprocal_second_order`."""
    if d <= 0.0 or (gap <= 0.0 and (speed < 0.0 or (speed == 0.0 and a < 0.0))):
        return math.inf
    if gap <= 0.0:
        return 0.0
    curvature = math.sqrt(abs(a)) * math.sqrt(gap)
    size = max(abs(speed), curvature)
    if size == 0.0:
        return 0.0
    part, share = speed / size, curvature / size
    direction = 1.0 if a > 0.0 else (-1.0 if a < 0.0 else 0.0)
    discriminant = part * part - 2.0 * direction * (share * share)
    if discriminant < -GRAZING_TOLERANCE:
        return 0.0
    root = math.sqrt(max(discriminant, 0.0))
    closing, opening = size * (root - part) / (2.0 * gap), -a / (size * (root + part))
    return max(opening if part > 0.0 else closing, 0.0)


@_compiled
def reciprocal_second_order(pairs, distance, rate, accel, setting, kappa, answer):
    """`ttc.reciprocal_second_order`; the setting is its standoff."""
    answer[0] = DONE
    for pair in range(pairs):
        d, speed, a = distance[pair], rate[pair], accel[pair]
        if not (math.isfinite(d) and math.isfinite(speed) and math.isfinite(a)):
            answer[0] = REFUSED
            return
        kappa[pair] = _second_order(d, speed, a, d - setting[0])


@_compiled
def smallest(pairs, kappa, ttc, pair, answer):
    """`ttc.smallest`."""
    answer[0] = DONE
    largest, which = 0.0, -1
    for k in range(pairs):
        value = kappa[k]
        if not value >= 0.0:
            answer[0] = REFUSED
            return
        if value > largest:
            largest, which = value, k
    ttc[0] = 1.0 / largest if largest > 0.0 else math.inf
    pair[0] = which if ttc[0] < math.inf else -1


# ---------------------------------------------------------------- criteria


@_compiled
def average(pairs, kind, distance, rate, value, answer):
    """`criteria.artc_signed`, `artc_approaching` and `armd`."""
    answer[0] = DONE
    total = 0.0
    for pair in range(pairs):
        d, speed = distance[pair], rate[pair]
        if not (math.isfinite(d) and math.isfinite(speed)):
            answer[0] = REFUSED
            return
        floored = max(d, DISTANCE_FLOOR_M)
        if kind == ARMD:
            total += 1.0 / floored
        elif kind == ARTC_SIGNED or speed < 0.0:
            total += -speed / floored
    value[0] = total / pairs if pairs else 0.0


@_compiled
def objective(pairs, joints, kind, distance, rate, rows, other, hessian, linear, answer):
    """`criteria.objective`."""
    answer[0] = DONE
    count = max(1, pairs)
    for a in range(joints):
        linear[a] = 0.0
        for b in range(joints):
            hessian[a, b] = 0.0
    for pair in range(pairs):
        d, speed, rest = distance[pair], rate[pair], other[pair]
        sound = math.isfinite(d) and math.isfinite(speed) and math.isfinite(rest)
        for a in range(joints):
            sound &= math.isfinite(rows[pair, a])
        if not sound:
            answer[0] = REFUSED
            return
        floored = max(d, DISTANCE_FLOOR_M)
        if kind == ARTC_APPROACHING:
            if speed < 0.0:
                for a in range(joints):
                    scaled = rows[pair, a] / floored
                    linear[a] += scaled * (rest / floored)
                    for b in range(joints):
                        hessian[a, b] += scaled * (rows[pair, b] / floored)
        else:
            weight = -1.0 / floored if kind == ARTC_SIGNED else -1.0 / (floored * floored)
            for a in range(joints):
                linear[a] += weight * rows[pair, a]
    for a in range(joints):
        linear[a] /= count
        for b in range(joints):
            hessian[a, b] /= count


@_compiled
def with_room_to_stops(joints, q, lower, upper, linear, setting, pushed, any, answer):
    """`criteria.with_room_to_stops`; the settings are its margin, its push and the weight."""
    answer[0] = DONE
    margin, push, weight = setting[0], setting[1], setting[2]
    any[0] = 0
    for k in range(joints):
        if not math.isfinite(q[k]):
            answer[0] = REFUSED
            return
        below = max(margin - (q[k] - lower[k]), 0.0) / margin
        above = max(margin - (upper[k] - q[k]), 0.0) / margin
        if below > 0.0 or above > 0.0:
            any[0] = 1
        pushed[k] = linear[k] - push * (below * below - above * above) / weight


# ---------------------------------------------------------------- the cell's pairs


@_compiled
def rates(
    pairs, joints, arms, order,
    jacobian, distance, velocity, accel, silent, owner, rate, ttc, which, part, answer,
):  # fmt: skip
    """`share.Watched.rates`; `which` are the first pair, the nearest and the arm that closes the first most."""
    answer[0] = REFUSED
    most, least, first, nearest = 0.0, math.inf, -1, 0
    for pair in range(pairs):
        total = 0.0
        for joint in range(joints):
            total += jacobian[pair, joint] * velocity[joint]
        d = distance[pair]
        if not math.isfinite(total + d):
            return
        rate[pair] = total
        if silent[pair]:
            continue
        if d < least:
            least, nearest = d, pair
        if order == 2:
            if not math.isfinite(accel[pair]):
                return
            kappa = _second_order(d, total, accel[pair], d)
        elif d <= 0.0:
            kappa = math.inf
        elif total < 0.0:
            kappa = -total / d
        else:
            continue
        if kappa > most:
            most, first = kappa, pair
    ttc[0] = 1.0 / most if most > 0.0 else math.inf
    which[0] = first if ttc[0] < math.inf else -1
    which[1], which[2] = nearest, -1
    if which[0] >= 0:
        for arm in range(arms):
            part[arm] = 0.0
        for joint in range(joints):
            if owner[joint] >= 0:
                part[owner[joint]] += jacobian[which[0], joint] * velocity[joint]
        which[2] = 0
        for arm in range(1, arms):
            if part[arm] < part[which[2]]:
                which[2] = arm
    answer[0] = DONE


@_compiled
def surroundings(pairs, averaged, kind, distance, rate, criterion, value, answer):
    """`share.Share.surroundings`; the kind is that of ARTC."""
    answer[0] = DONE
    artc = armd = 0.0
    for k in range(averaged):
        d, speed = distance[criterion[k]], rate[criterion[k]]
        floored = max(d, DISTANCE_FLOOR_M)
        armd += 1.0 / floored
        if kind == ARTC_SIGNED or speed < 0.0:
            artc += -speed / floored
    value[0] = artc / averaged if averaged else 0.0
    value[1] = armd / averaged if averaged else 0.0
    if not math.isfinite(value[0] + value[1]):
        answer[0] = REFUSED


# ---------------------------------------------------------------- what an arm may do


@_compiled
def self_motion_rows(
    pairs, joints, chosen, dofs,
    jacobian, distance, other, index, dof, task, speed, setting, rows, allowed, count, answer,
):  # fmt: skip
    """`share.Share.self_motion_rows`; the settings are standoff, t_min, d_min and the slack of the task."""
    answer[0] = DONE
    kept = 0
    for k in range(chosen):
        pair = index[k]
        gap = distance[pair] - setting[0]
        bound = 0.0 if gap <= setting[2] else gap * (-1.0 / setting[1])
        asked = reachable = 0.0
        for m in range(dofs):
            entry = jacobian[pair, dof[m]]
            rows[kept, m] = entry
            asked += entry * task[m]
            reachable -= abs(entry) * speed[m]
        bound = min(bound - other[pair], asked - setting[3])
        if not math.isfinite(bound + reachable):
            answer[0] = REFUSED
            return
        if bound > reachable:
            allowed[kept] = bound
            kept += 1
    count[0] = kept


@_compiled
def pairwise_factor(pairs, distance, own, other, setting, found, which, answer):
    """`scaling.pairwise_factor`; the settings are t_min and the standoff, found are factor, required, shortfall."""
    answer[0] = DONE
    least, limiting = math.inf, -1
    for pair in range(pairs):
        allowance = (distance[pair] - setting[1]) / setting[0] + other[pair]
        if not math.isfinite(allowance + own[pair]):
            answer[0] = REFUSED
            return
        if own[pair] < 0.0:
            required = allowance / -own[pair]
            if required < least:
                least, limiting = required, pair
    factor = 0.0 if least <= 0.0 else min(least, 1.0)
    lowest, worst = math.inf, -1
    for pair in range(pairs):
        allowance = (distance[pair] - setting[1]) / setting[0] + other[pair]
        margin = allowance + factor * own[pair]
        if own[pair] < 0.0 and allowance >= 0.0:
            margin = 0.0
        if margin < lowest:
            lowest, worst = margin, pair
    short = max(0.0, -lowest)
    found[0], found[1], found[2] = factor, least, short
    which[0] = limiting if least < 1.0 else -1
    which[1] = worst if short > 0.0 else -1


@_compiled
def acceleration_interval(dofs, previous, wanted, limit, setting, found, answer):
    """`scaling.acceleration_interval` where there is one; the setting is the period."""
    answer[0] = REFUSED
    lowest, highest = 0.0, 1.0
    for k in range(dofs):
        v, w, reach = previous[k], wanted[k], limit[k] * setting[0]
        if not (math.isfinite(v) and math.isfinite(w) and math.isfinite(reach) and limit[k] > 0.0):
            return
        if w == 0.0:
            if abs(v) > reach:
                return
        else:
            one, two = (v - reach) / w, (v + reach) / w
            lowest, highest = max(lowest, min(one, two)), min(highest, max(one, two))
    if lowest > highest:
        return
    found[0], found[1] = lowest, highest
    answer[0] = DONE


# ---------------------------------------------------------------- inverse kinematics


@_compiled
def _quaternion(m, k):
    """Unit quaternion of the rotation matrix in row k; its largest component is found first."""
    xx, yy, zz = m[k, 0], m[k, 4], m[k, 8]
    if xx + yy + zz > 0.0:
        w = 0.5 * math.sqrt(1.0 + xx + yy + zz)
        s = 0.25 / w
        return w, (m[k, 7] - m[k, 5]) * s, (m[k, 2] - m[k, 6]) * s, (m[k, 3] - m[k, 1]) * s
    if xx >= yy and xx >= zz:
        x = 0.5 * math.sqrt(1.0 + xx - yy - zz)
        s = 0.25 / x
        return (m[k, 7] - m[k, 5]) * s, x, (m[k, 1] + m[k, 3]) * s, (m[k, 2] + m[k, 6]) * s
    if yy >= zz:
        y = 0.5 * math.sqrt(1.0 - xx + yy - zz)
        s = 0.25 / y
        return (m[k, 2] - m[k, 6]) * s, (m[k, 1] + m[k, 3]) * s, y, (m[k, 5] + m[k, 7]) * s
    z = 0.5 * math.sqrt(1.0 - xx - yy + zz)
    s = 0.25 / z
    return (m[k, 3] - m[k, 1]) * s, (m[k, 2] + m[k, 6]) * s, (m[k, 5] + m[k, 7]) * s, z


@_compiled
def _turned_back(m, k, a):
    """A world vector in the frame of the rotation matrix in row k."""
    return (
        m[k, 0] * a[0] + m[k, 3] * a[1] + m[k, 6] * a[2],
        m[k, 1] * a[0] + m[k, 4] * a[1] + m[k, 7] * a[2],
        m[k, 2] * a[0] + m[k, 5] * a[1] + m[k, 8] * a[2],
    )


@_compiled
def _unturned(q, a):
    """A world vector in the frame of a unit quaternion (w, x, y, z)."""
    axis = (-q[1], -q[2], -q[3])
    crossed = _cross(axis, a)
    return _plus(a, _times(2.0, _plus(_times(q[0], crossed), _cross(axis, crossed))))


@_compiled
def _inverse_left(phi, a):
    """The inverse left Jacobian of rotations at phi, times a: a - phi x a / 2 + beta phi x (phi x a)."""
    square = _dot(phi, phi)
    if square < SMALL_ANGLE_RAD * SMALL_ANGLE_RAD:
        beta = 1 / 12 + square * (1 / 720 + square * (1 / 30240 + square * (1 / 1209600)))
    else:
        angle = math.sqrt(square)
        beta = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / square
    once = _cross(phi, a)
    twice = _cross(phi, once)
    return _plus(_minus(a, _times(0.5, once)), _times(beta, twice))


@_compiled
def _coupling(rho, phi, a):
    """The upper right block of the left Jacobian of motions at (rho, phi), times a.

    With R and P the cross product matrices of rho and phi: R/2 + b (PR + RP + PRP)
    - c (PPR + RPP - 3 PRP) - (c - 3 e)/2 (PRPP + PPRP), b = (x - sin x)/x^3,
    c = (1 - x^2/2 - cos x)/x^4, e = (x - sin x - x^3/6)/x^5.
    """
    square = _dot(phi, phi)
    if square < SMALL_ANGLE_RAD * SMALL_ANGLE_RAD:
        b = 1 / 6 - square * (1 / 120 - square * (1 / 5040 - square * (1 / 362880)))
        c = -1 / 24 + square * (1 / 720 - square * (1 / 40320 - square * (1 / 3628800)))
        e = -1 / 120 + square * (1 / 5040 - square * (1 / 362880 - square * (1 / 39916800)))
    else:
        x = math.sqrt(square)
        b = (x - math.sin(x)) / (square * x)
        c = (1.0 - 0.5 * square - math.cos(x)) / (square * square)
        e = (x - math.sin(x) - square * x / 6.0) / (square * square * x)
    p, r = _cross(phi, a), _cross(rho, a)
    pp, pr, rp = _cross(phi, p), _cross(phi, r), _cross(rho, p)
    ppr, prp, rpp = _cross(phi, pr), _cross(phi, rp), _cross(rho, pp)
    prpp, pprp = _cross(phi, rpp), _cross(phi, prp)
    out = _plus(_times(0.5, r), _times(b, _plus(_plus(pr, rp), prp)))
    out = _minus(out, _times(c, _minus(_plus(ppr, rpp), _times(3.0, prp))))
    return _minus(out, _times(0.5 * (c - 3.0 * e), _plus(prpp, pprp)))


@_compiled
def aim(
    joints, bodies, sites, dofs,
    site_xpos, site_xmat, cdof, subtree_com, site, dof, dof_root, moves, position, wxyz, velocity,
    turn, settings, free, rows, rates, gram, solved, whole, path, error, answer,
):  # fmt: skip
    """`ArmIk.aim` with mink's frame task: error log(T_bt), Jacobian minus its inverse left Jacobian times J.

    `settings` are mink's gain, the period, the largest speed of correction and the length that counts as a
    radian in it; `free` leaves the last row out; `error` is the distance to the target and the angle.
    """
    answer[0] = REFUSED
    given = wxyz[0] + wxyz[1] + wxyz[2] + wxyz[3]
    for axis in range(3):
        given += position[axis] + velocity[axis] + turn[axis]
    if not math.isfinite(given):
        return
    gain, period, catch_up = settings[0], settings[1], settings[2]
    tool = site[0]
    here = _row(site_xpos, tool)
    # The target as seen from the tool: q = conj(tool) target, and its logarithm.
    a, t = _quaternion(site_xmat, tool), (wxyz[0], wxyz[1], wxyz[2], wxyz[3])
    w = a[0] * t[0] + a[1] * t[1] + a[2] * t[2] + a[3] * t[3]
    v = (
        a[0] * t[1] - a[1] * t[0] - a[2] * t[3] + a[3] * t[2],
        a[0] * t[2] - a[2] * t[0] - a[3] * t[1] + a[1] * t[3],
        a[0] * t[3] - a[3] * t[0] - a[1] * t[2] + a[2] * t[1],
    )
    if w < 0.0:
        w, v = -w, _times(-1.0, v)
    sine = _length(v)
    error[1] = 2.0 * math.atan2(sine, w)
    phi = _times(error[1] / sine, v) if sine > 0.0 else (0.0, 0.0, 0.0)
    # For the Jacobian mink takes frames so little turned against each other as turned alike.
    turned_alike = _dot(phi, phi) < MINK_SMALL_TURN_SQUARED
    offset = (position[0] - here[0], position[1] - here[1], position[2] - here[2])
    error[0] = _length(offset)
    rho = _inverse_left(phi, _turned_back(site_xmat, tool, offset))
    # What the target does by itself, in its own frame; mink's gain is taken out of it again.
    rate = -gain / period
    ahead_v = _times(period / gain, _unturned(t, (velocity[0], velocity[1], velocity[2])))
    ahead_w = _times(period / gain, _unturned(t, (turn[0], turn[1], turn[2])))
    catching_v, catching_w = _times(rate, rho), _times(rate, phi)
    if catch_up < math.inf:
        turning = settings[3] * _length(catching_w)
        speed = math.sqrt(_dot(catching_v, catching_v) + turning * turning)
        if speed > catch_up:
            catching_v = _times(catch_up / speed, catching_v)
            catching_w = _times(catch_up / speed, catching_w)
    own_v, own_w = _times(rate, ahead_v), _times(rate, ahead_w)
    for axis in range(3):
        rates[axis] = catching_v[axis] + own_v[axis]
        rates[3 + axis] = catching_w[axis] + own_w[axis]
        solved[1, axis], solved[1, 3 + axis] = own_v[axis], own_w[axis]
    for k in range(dofs):
        if not moves[k]:
            for row in range(6):
                rows[row, k] = 0.0
            continue
        joint = dof[k]
        omega = _row(cdof, joint)
        lever = _minus(here, _row(subtree_com, dof_root[k]))
        linear = _turned_back(site_xmat, tool, _plus(_upper(cdof, joint), _cross(omega, lever)))
        angular = _turned_back(site_xmat, tool, omega)
        if not turned_alike:
            angular = _inverse_left(phi, angular)
            linear = _inverse_left(phi, _minus(linear, _coupling(rho, phi, angular)))
        for axis in range(3):
            rows[axis, k], rows[3 + axis, k] = -linear[axis], -angular[axis]
    # The least motion, (J J^T + damping) x = rates by Cholesky's factor.
    size = 5 if free[0] else 6
    for m in range(size):
        solved[0, m] = rates[m]
        for n in range(m + 1):
            total = LEAST_MOTION_DAMPING if m == n else 0.0
            for k in range(dofs):
                total += rows[m, k] * rows[n, k]
            for k in range(n):
                total -= gram[m, k] * gram[n, k]
            if m == n:
                if not (total > 0.0 and total < math.inf):
                    return
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
    for k in range(dofs):
        whole[k] = path[k] = 0.0
        for m in range(size):
            whole[k] += solved[0, m] * rows[m, k]
            path[k] += solved[1, m] * rows[m, k]
        if not (math.isfinite(whole[k]) and math.isfinite(path[k])):
            return
    answer[0] = DONE


@_compiled
def prepare(
    dofs, coordinates, room, constraints,
    qpos, address, lower_rad, upper_rad, speed, acceleration, previous, settings, counts, hessian,
    linear, tool_rows, tool_rates, rows, bounds, low, high, H, c, lower, upper, sense, answer,
):  # fmt: skip
    """`JointLimit.bounds` and the assembly of the first program of `ArmIk.solve`.

    `settings` are the period and the criterion's gain; `counts` the pairs' rows, already written into
    `rows` and `bounds`, and the tool's, which follow them.
    """
    answer[0] = REFUSED
    period, gain = settings[0], settings[1]
    pairs, tool = counts[0], counts[1]
    for k in range(dofs):
        q, a, fastest = qpos[address[k]], acceleration[k], speed[k]
        if not (math.isfinite(q) and math.isfinite(previous[k])):
            return
        towards_low = _braking(q - lower_rad[k], a, fastest, period)
        towards_high = _braking(upper_rad[k] - q, a, fastest, period)
        step = a * period
        # As in NumPy, both ends are clipped with the other end before it was clipped itself.
        low[k] = min(max(-towards_low, previous[k] - step), towards_high)
        high[k] = max(min(towards_high, previous[k] + step), -towards_low)
        c[k] = gain * linear[k]
        sound = math.isfinite(low[k]) and math.isfinite(high[k]) and math.isfinite(c[k])
        for m in range(dofs):
            H[k, m] = (1.0 if k == m else 0.0) + gain * hessian[k, m]
            sound &= math.isfinite(H[k, m])
        if not sound:
            return
        lower[k], upper[k], sense[k] = max(low[k], -UNBOUNDED), min(high[k], UNBOUNDED), 0
    for row in range(pairs):
        sound = math.isfinite(bounds[row])
        for k in range(dofs):
            sound &= math.isfinite(rows[row, k])
        if not sound:
            return
        lower[dofs + row], upper[dofs + row], sense[dofs + row] = bounds[row], UNBOUNDED, 0
    for row in range(tool):
        rate = tool_rates[row]
        sound = math.isfinite(rate)
        for k in range(dofs):
            rows[pairs + row, k] = tool_rows[row, k]
            sound &= math.isfinite(tool_rows[row, k])
        if not sound:
            return
        at = dofs + pairs + row
        lower[at], upper[at], sense[at] = rate, rate, EQUALITY
    answer[0] = DONE


@_compiled
def settle(dofs, velocity, low, high, setting, settled, answer):
    """`ik._within`; the setting is the solver's tolerance."""
    answer[0] = DONE
    for k in range(dofs):
        if not math.isfinite(velocity[k]):
            answer[0] = REFUSED
            return
        settled[k] = velocity[k]
        if velocity[k] <= low[k] + setting[0]:
            settled[k] = low[k]
        if velocity[k] >= high[k] - setting[0]:
            settled[k] = high[k]


@_compiled
def _braking(distance, acceleration, fastest, period):
    """`ik._approach`, capped by the joint's largest speed."""
    if distance < 0.0:
        return min(max(distance / period, -fastest), fastest)
    half_step = acceleration * (period / 2)
    speed = math.sqrt(half_step * half_step + 2.0 * acceleration * distance) - half_step
    return min(speed, fastest)


@_compiled
def followed(
    dofs, coordinates, qpos, address, lower_rad, upper_rad, speed, acceleration, previous, wanted,
    setting, within, answer,
):  # fmt: skip
    """`ArmIk.followed`; the setting is the period."""
    answer[0] = REFUSED
    period = setting[0]
    for k in range(dofs):
        q, a, fastest = qpos[address[k]], acceleration[k], speed[k]
        towards_low = _braking(q - lower_rad[k], a, fastest, period)
        towards_high = _braking(upper_rad[k] - q, a, fastest, period)
        step = a * period
        low = min(max(-towards_low, previous[k] - step), towards_high)
        high = max(min(towards_high, previous[k] + step), -towards_low)
        within[k] = min(max(wanted[k], low), high)
        if not math.isfinite(q + previous[k] + wanted[k] + within[k]):
            return
    answer[0] = DONE


# ---------------------------------------------------------------- a support arm's whole program and factor


@_compiled
def program(
    pairs, joints, chosen, averaged, dofs, coordinates, room, constraints,
    jacobian, distance, rate, ways, index, criterion, dof, task, push, qvel, counted_on,
    near_distance, near_rate, near_rows, near_other, q, rule, stops, pushed, any, count,
    qpos, address, lower_rad, upper_rad, speed, acceleration, previous, settings, counts, hessian,
    linear, tool_rows, tool_rates, rows, bounds, low, high, H, c, lower, upper, sense, choice, other,
    answer,
):  # fmt: skip
    """`share.Share.solve` up to the solver: `other_m_s`, the criterion or a push, the rows, the program.

    `choice` are how many of the others' ways count, the criterion's kind, whether the arm counts with its own part
    of the rates only, and the rows of the tool.
    """
    answer[0] = REFUSED
    for joint in range(joints):
        for way in range(3):
            counted_on[way, joint] = ways[way, joint]
    for k in range(dofs):
        for way in range(3):
            counted_on[way, dof[k]] = 0.0
    for k in range(chosen):
        pair = index[k]
        least = 0.0
        for way in range(choice[0]):
            total = 0.0
            for joint in range(joints):
                total += jacobian[pair, joint] * counted_on[way, joint]
            if way == 0 or total < least:
                least = total
            if not math.isfinite(total):
                return
        other[pair] = least
    kind = choice[1]
    if kind <= ARMD:
        for k in range(averaged):
            pair = criterion[k]
            near_distance[k], near_other[k] = distance[pair], other[pair]
            own = 0.0
            for m in range(dofs):
                entry = jacobian[pair, dof[m]]
                near_rows[k, m] = entry
                own += entry * qvel[dof[m]]
            near_rate[k] = own if choice[2] else rate[pair]
        objective(
            averaged, dofs, kind, near_distance, near_rate, near_rows, near_other, hessian, linear,
            answer,
        )  # fmt: skip
        if answer[0] != DONE:
            return
        if settings[1] != 0.0:
            for k in range(dofs):
                q[k] = qpos[address[k]]
            with_room_to_stops(dofs, q, lower_rad, upper_rad, linear, stops, pushed, any, answer)
            if answer[0] != DONE:
                return
            for k in range(dofs):
                linear[k] = pushed[k]
    else:
        for a in range(dofs):
            linear[a] = push[a] if kind == PUSH else 0.0
            for b in range(dofs):
                hessian[a, b] = 0.0
    self_motion_rows(
        pairs, joints, chosen, dofs, jacobian, distance, other, index, dof, task, speed, rule, rows,
        bounds, count, answer,
    )  # fmt: skip
    if answer[0] != DONE:
        return
    counts[0], counts[1] = count[0], choice[3]
    prepare(
        dofs, coordinates, room, constraints, qpos, address, lower_rad, upper_rad, speed,
        acceleration, previous, settings, counts, hessian, linear, tool_rows, tool_rates, rows,
        bounds, low, high, H, c, lower, upper, sense, answer,
    )  # fmt: skip


@_compiled
def allow(
    pairs, joints, owned, dofs,
    jacobian, distance, other, index, meeting, standing, dof, wanted, previous, limit, rule, period,
    factor_setting, counted, reached, own, rest, found, which, reach, told, answer,
):  # fmt: skip
    """`share.Share.allow` for the first-order rule by time.

    `rule` are standoff, t_min, d_min, the rate that counts as rest and the two that count as pressing; `told` whether the
    arm is pressed and whether its joints reach a factor.
    """
    standoff, t_min, d_min, rest_m_s = rule[0], rule[1], rule[2], rule[3]
    factor_setting[0], factor_setting[1] = t_min, standoff
    for k in range(owned):
        pair = index[k]
        total = 0.0
        for m in range(dofs):
            total += jacobian[pair, dof[m]] * wanted[m]
        own[k], rest[k], counted[k] = total, other[pair], distance[pair]
        reached[k] = distance[pair] <= d_min and not meeting[k]
        if reached[k]:
            counted[k] = min(counted[k], 0.0)
            if abs(own[k]) < rest_m_s:
                own[k] = 0.0
            if abs(rest[k]) < rest_m_s:
                rest[k] = 0.0
    told[0] = told[1] = 0
    pairwise_factor(owned, counted, own, rest, factor_setting, found, which, answer)
    if answer[0] != DONE:
        return
    if found[2] > rule[4]:
        for k in range(owned):
            spared = other[index[k]]
            if meeting[k]:
                spared += rule[5]
            if standing[k]:
                spared = max(spared, 0.0)
            if reached[k] and abs(spared) < rest_m_s:
                spared = 0.0
            rest[k] = spared
        factor, required, short = found[0], found[1], found[2]
        limiting, worst = which[0], which[1]
        pairwise_factor(owned, counted, own, rest, factor_setting, found, which, answer)
        if answer[0] != DONE:
            return
        told[0] = found[2] > rule[4]
        found[0], found[1], found[2] = factor, required, short
        which[0], which[1] = limiting, worst
    acceleration_interval(dofs, previous, wanted, limit, period, reach, answer)
    told[1] = answer[0] == DONE
    answer[0] = DONE


@_compiled
def keeps(
    pairs, joints, owned, dofs,
    jacobian, distance, other, index, meeting, dof, command, rule, kept_other, answer,
):  # fmt: skip
    """`share.Share.keeps`: refused where it is not so; `rule` as in `allow`, but with the task's slack last."""
    answer[0] = REFUSED
    standoff, t_min, d_min = rule[0], rule[1], rule[2]
    for k in range(owned):
        pair = index[k]
        opening = 0.0
        for m in range(dofs):
            opening += jacobian[pair, dof[m]] * command[m]
        reached = distance[pair] <= d_min and not meeting[k]
        counted = min(distance[pair], 0.0) if reached else distance[pair]
        slack = rule[3] if reached else rule[4]
        allowance = (counted - standoff) / t_min + other[pair]
        # Not "<", so that what is not a number is not kept.
        if not (opening >= min(-allowance, 0.0) - slack and allowance + opening >= -slack):
            return
    for k in range(owned):
        kept_other[k] = other[index[k]]
    answer[0] = DONE


ENTRIES = (
    with_room_to_stops,
    pairwise_factor,
    acceleration_interval,
    measure,
    second_order,
    reciprocal_first_order,
    reciprocal_second_order,
    smallest,
    average,
    objective,
    aim,
    settle,
    followed,
    rates,
    surroundings,
    program,
    allow,
    keeps,
)
"""What is called from Python; the rest is called by these."""

"""Vectors of three as tuples, and rotations: steps that other laws are written with."""

from __future__ import annotations

import math

from workcell.control.laws import part


@part
def row(array, k):
    """Row k of an array (K, 3 or more) as a vector."""
    return array[k, 0], array[k, 1], array[k, 2]


@part
def second_half(array, k):
    """The last three of row k of an array (K, 6): of a twist, its linear part."""
    return array[k, 3], array[k, 4], array[k, 5]


@part
def put(array, k, a):
    """Write a vector into row k."""
    array[k, 0], array[k, 1], array[k, 2] = a


@part
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@part
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@part
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part
def times(s, a):
    return s * a[0], s * a[1], s * a[2]


@part
def over(a, s):
    return a[0] / s, a[1] / s, a[2] / s


@part
def length(a):
    return math.sqrt(dot(a, a))


@part
def into_frame(m, k, a):
    """A world vector in the frame of the rotation matrix in row k of m (K, 9)."""
    return (
        m[k, 0] * a[0] + m[k, 3] * a[1] + m[k, 6] * a[2],
        m[k, 1] * a[0] + m[k, 4] * a[1] + m[k, 7] * a[2],
        m[k, 2] * a[0] + m[k, 5] * a[1] + m[k, 8] * a[2],
    )


@part
def into_frame_of_quaternion(q, a):
    """A world vector in the frame of a unit quaternion (w, x, y, z)."""
    axis = (-q[1], -q[2], -q[3])
    crossed = cross(axis, a)
    return plus(a, times(2.0, plus(times(q[0], crossed), cross(axis, crossed))))


@part
def quaternion(m, k):
    """Unit quaternion of the rotation matrix in row k of m (K, 9); its largest component is found first."""
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

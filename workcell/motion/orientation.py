"""Orientations: unit quaternions, scalar first, and what a tick asks of them.

In plain floats, since four numbers cost a library more to take in than to compute. A rotation vector
(axis times angle) is always in the world frame, so that turning by it is a product from the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def rotation_between(
    from_wxyz: NDArray[np.float64], to_wxyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(3,) rotation vector, in the world frame, that turns one orientation into the other the short way."""
    before, after = from_wxyz.tolist(), to_wxyz.tolist()
    if before == after:
        return np.zeros(3)
    w, x, y, z = product(after, _conjugate(before))
    sine = math.hypot(x, y, z)
    if sine == 0.0:  # q and -q
        return np.zeros(3)
    # Of the two quaternions of a rotation the one with w >= 0 turns the short way.
    scale = math.copysign(2.0 * math.atan2(sine, abs(w)) / sine, w)
    return np.array([scale * x, scale * y, scale * z])


def turned(wxyz: NDArray[np.float64], rotation_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4,) an orientation after a rotation vector in the world frame; unchanged by none."""
    x, y, z = rotation_rad.tolist()
    angle = math.hypot(x, y, z)
    if angle == 0.0:
        return wxyz
    scale = math.sin(0.5 * angle) / angle
    turn = (math.cos(0.5 * angle), scale * x, scale * y, scale * z)
    return np.array(unit(product(turn, wxyz.tolist())))


def turned_towards(
    wxyz: NDArray[np.float64], axis: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(4,) an orientation turned the shortest way so that a unit vector fixed to it points in a new direction."""
    cross, cosine = np.cross(axis, direction), float(axis @ direction)
    sine = math.hypot(*cross.tolist())
    if sine >= 1e-9:
        return turned(wxyz, cross / sine * math.atan2(sine, cosine))
    if cosine > 0.0:
        return wxyz
    # Opposite directions have no shortest way; any axis across is as good as another.
    across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    return turned(wxyz, math.pi * across / math.hypot(*across.tolist()))


def pointing(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) direction of an orientation's z axis in the world: that of a tool."""
    w, x, y, z = unit(wxyz.tolist())
    return np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])


def angular_velocity(wxyz: Sequence[Any], rate: Sequence[Any]) -> tuple[Any, Any, Any]:
    """ω = 2 q̇ q*, vector part: in the world frame, of a unit quaternion and its rate.

    The four components of each may be floats, or arrays of as many orientations as there are.
    """
    _, x, y, z = product(rate, _conjugate(wxyz))
    return 2.0 * x, 2.0 * y, 2.0 * z


def product(a: Sequence[Any], b: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
    """The product of two quaternions: the rotation b, then a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def unit(wxyz: Sequence[float]) -> list[float]:
    """A quaternion brought to length 1."""
    norm = math.hypot(*wxyz)
    return [part / norm for part in wxyz]


def _conjugate(wxyz: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
    w, x, y, z = wxyz
    return w, -x, -y, -z

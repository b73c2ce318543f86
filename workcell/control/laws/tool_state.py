"""What is sensed of one arm: where its tool and its elbow are, how fast the tool is, how near the surroundings are."""

from __future__ import annotations

import math

from workcell.control.laws import law
from workcell.control.laws.criteria import means
from workcell.control.laws.vectors import cross, dot, minus, plus, row, second_half


@law
def arm_state(
    site_xpos, cvel, subtree_com, site, body, root, elbow, distance, rate, averaged, approaching,
    position, elbow_position,
):  # fmt: skip
    """Of one arm from MuJoCo's arrays, after `mj_comVel`.

    Args:
        site_xpos, cvel, subtree_com: (S, 3), (B, 6), (B, 3) of MuJoCo.
        site, body, root: The tool's site, its body, and the root body of its tree.
        elbow: The elbow's site; -1 without one.
        distance, rate, averaged, approaching: As in `criteria.means`.
        position: (3,) written: the tool's.
        elbow_position: (3,) written where there is an elbow.

    Returns:
        The tool's speed in m/s, v = v_root + w x (p - p_root); ARTC, ARMD and the first bad pair as `criteria.means`.
    """
    for axis in range(3):
        position[axis] = site_xpos[site, axis]
        if elbow >= 0:
            elbow_position[axis] = site_xpos[elbow, axis]
    out = minus(row(site_xpos, site), row(subtree_com, root))
    velocity = plus(second_half(cvel, body), cross(row(cvel, body), out))
    artc, armd, bad = means(distance, rate, averaged, approaching)
    return math.sqrt(dot(velocity, velocity)), artc, armd, bad

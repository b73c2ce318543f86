"""Parts of one arm: which of them touch by design, told from poses within the joint ranges.

The final check decides the same question with code of its own (workcell/guard/self_pairs.py); this file shares
nothing with it. Two bodies three joints apart or more touch by design if they do so in every pose. Of nearer bodies,
parts interlock or graze by design; judged are those that can be clear of each other and yet enter one another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

POSES = 200
"""Random poses of all joints, in which far bodies are looked at."""
POSES_OF_ONE, POSES_OF_TWO = 40, 200
"""Random poses of the one or two joints between neighbours, beside the ends of their ranges."""
_MOST_KEPT = 1000
"""Answers that are kept for other arms of the same file, and for further runs of a study."""
_judged: dict[bytes, NDArray[np.bool_]] = {}
"""Answers for pairs of neighbours, by their shapes and where these are to one another."""
GRAZE_M = 0.002
"""Neighbours that enter one another by less were drawn a little too large (the PA10's wrist: 1.6 mm)."""
_WIDE = np.pi
"""Half the range of a joint that has none, rad or m."""


class OwnParts:
    """Looks at the arms of a scene in poses.

    Args:
        model: The scene.
        clear_m: Parts farther apart than this are clear of each other.
    """

    def __init__(self, model: mujoco.MjModel, clear_m: float):
        self._model, self._clear_m = model, clear_m
        single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        self._single: list[int] = np.flatnonzero(np.isin(model.jnt_type, single)).tolist()
        self._zero = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self._zero)
        limited = model.jnt_limited.astype(bool)[:, None]
        self._ranges = np.where(limited, model.jnt_range, [-_WIDE, _WIDE])

    def always_touch(self, pairs: Sequence[tuple[int, int]]) -> bool:
        """Whether any of some pairs of geoms touch in every pose."""
        return all(
            any(mujoco.mj_geomDistance(self._model, pose, g, h, 1.0, None) <= 0.0 for g, h in pairs)
            for pose in self._drawn(self._single, POSES)
        )

    def that_can_collide(
        self, joints: Sequence[int], pairs: Sequence[tuple[int, int]]
    ) -> list[tuple[int, int]]:
        """Of pairs of geoms that one or two joints move against each other, those that are judged."""
        key = self._signature(joints, pairs)
        if key not in _judged:
            while len(_judged) >= _MOST_KEPT:
                del _judged[next(iter(_judged))]
            _judged[key] = self._can_collide(joints, pairs)
        return [pair for pair, judged in zip(pairs, _judged[key], strict=True) if judged]

    def _can_collide(
        self, joints: Sequence[int], pairs: Sequence[tuple[int, int]]
    ) -> NDArray[np.bool_]:
        """(P,) for each pair."""
        model, geoms = self._model, np.array(pairs)
        count = POSES_OF_ONE if len(joints) == 1 else POSES_OF_TWO
        radii = model.geom_rbound[geoms].sum(axis=1)
        clear, entered = np.zeros((2, len(pairs)), dtype=bool)
        for pose in self._drawn(joints, count, corners=True):
            ways = pose.geom_xpos[geoms[:, 0]] - pose.geom_xpos[geoms[:, 1]]
            far = np.linalg.norm(ways, axis=1) - radii > self._clear_m
            clear |= far
            for k in np.flatnonzero(~far & ~(clear & entered)).tolist():
                distance = mujoco.mj_geomDistance(model, pose, *pairs[k], 2 * self._clear_m, None)
                clear[k] |= distance > self._clear_m
                entered[k] |= distance <= -GRAZE_M
        return clear & entered

    def _signature(self, joints: Sequence[int], pairs: Sequence[tuple[int, int]]) -> bytes:
        """Equal, but for rounding, where the same shapes move against one another in the same way."""
        model, zero, joint = self._model, self._zero, list(joints)
        geoms = sorted({g for pair in pairs for g in pair})
        body = model.geom_bodyid[geoms[0]]
        turn, origin = zero.xmat[body].reshape(3, 3), zero.xpos[body]
        numbers = (
            [geoms.index(g) for pair in pairs for g in pair],
            *(getattr(model, f"geom_{name}")[geoms] for name in ("type", "size", "aabb", "rbound")),
            (zero.geom_xpos[geoms] - origin) @ turn,
            turn.T @ zero.geom_xmat[geoms].reshape(-1, 3, 3),
            (zero.xanchor[joint] - origin) @ turn,
            zero.xaxis[joint] @ turn,
            model.jnt_type[joint],
            self._ranges[joint],
            [self._clear_m],
        )
        # Zeros have a sign, which rounding leaves.
        return b"|".join((np.round(part, 9) + 0.0).tobytes() for part in numbers)

    def _drawn(
        self, joints: Sequence[int], count: int, *, corners: bool = False
    ) -> Iterator[mujoco.MjData]:
        """Poses in which these joints are somewhere within their ranges; one object, filled again and again."""
        model, data, rng = self._model, mujoco.MjData(self._model), np.random.default_rng(1)
        lower, upper = self._ranges[list(joints)].T
        # More of them towards the ends of the ranges, where parts of one arm meet.
        shares = 0.5 + 0.5 * np.sin(rng.uniform(-0.5, 0.5, (count, len(joints))) * np.pi)
        values: list[NDArray[np.float64]] = list(lower + (upper - lower) * shares)
        if corners:
            ends = np.meshgrid(*zip(lower, upper, strict=True))
            values += list(np.stack([end.ravel() for end in ends], axis=1))
        for value in values:
            data.qpos[model.jnt_qposadr[list(joints)]] = value
            mujoco.mj_kinematics(model, data)
            yield data

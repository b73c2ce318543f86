"""Which pairs of geoms are watched, and why each of the rest is not.

The list is made once, in one place, for arms against arms, arms against the static surroundings,
and an arm against itself. A pair is left out only for a written reason:

* `static`: no joint lies between the two geoms, or none changes their distance;
* `neighbours`: within one arm, at most `NEIGHBOUR_JOINTS` joints apart, where housings interlock by design;
* `rests`: an instrument and the obstacle it lies on;
* `apart`: within one arm, never nearer than `APART_M` in the sampled poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.handles import ArmHandles, InstrumentHandles, arm_of_geom

NEIGHBOUR_JOINTS = 2
"""Links up to two joints apart share a housing joint (on the PA10: shoulder, elbow and wrist forks)."""
APART_M = 0.05
"""Self pairs that stay farther apart than this in all sampled poses cannot meet; the margin covers what sampling misses."""
SAMPLES = 500
_INVARIANT_M = 1e-6


@dataclass(frozen=True)
class WatchedPairs:
    """The watched list and the omissions."""

    geoms: NDArray[np.intp]
    """(P, 2) geom ids; the arm of lower scenario index first, surroundings last."""
    names: tuple[tuple[str, str], ...]
    """(P,) geom names."""
    owners: tuple[tuple[str, str | None], ...]
    """(P,) names of the arms or instruments the two geoms belong to; None is the static surroundings."""
    omitted: tuple[tuple[str, str, str], ...]
    """Every pair left out: geom, geom, reason."""

    def __len__(self) -> int:
        return len(self.names)


def watched_pairs(
    model: mujoco.MjModel,
    arms: tuple[ArmHandles, ...],
    instruments: tuple[InstrumentHandles, ...] = (),
) -> WatchedPairs:
    """Make the list for a compiled scene (sensors not needed).

    An instrument is watched against every arm and the surroundings all the time; who answers for
    such a pair, and whether it counts at all, depends on who holds it (control/grasp.py).
    """
    arm_names = tuple(arm.name for arm in arms)
    surroundings = [
        g
        for g in range(model.ngeom)
        if model.body_weldid[model.geom_bodyid[g]] == 0 and arm_of_geom(model, g, arm_names) is None
    ]
    candidates: list[tuple[int, int]] = []
    for index, arm in enumerate(arms):
        candidates += [(g, h) for k, g in enumerate(arm.geoms) for h in arm.geoms[k + 1 :]]
        for other in arms[index + 1 :]:
            candidates += [(g, h) for g in arm.geoms for h in other.geoms]
        candidates += [(g, h) for g in arm.geoms for h in surroundings]
    loose, rests = _instrument_pairs(model, arms, instruments, surroundings)
    nearest, farthest = _sampled_extremes(model, arms, candidates)
    kept: list[tuple[int, int]] = []
    omitted: list[tuple[str, str, str]] = []
    for (g, h), low, high in zip(candidates, nearest, farthest, strict=True):
        reason = _why_not(model, arm_names, g, h, low, high)
        if reason is None:
            kept.append((g, h))
        else:
            omitted.append((model.geom(g).name, model.geom(h).name, reason))
    kept += loose
    omitted += rests
    owner = {g: arm.name for arm in arms for g in arm.geoms} | {
        item.geom: item.name for item in instruments
    }
    return WatchedPairs(
        geoms=np.array(kept, dtype=np.intp).reshape(-1, 2),
        names=tuple((model.geom(g).name, model.geom(h).name) for g, h in kept),
        owners=tuple((owner[g], owner.get(h)) for g, h in kept),
        omitted=tuple(omitted),
    )


def _instrument_pairs(
    model: mujoco.MjModel,
    arms: tuple[ArmHandles, ...],
    instruments: tuple[InstrumentHandles, ...],
    surroundings: list[int],
) -> tuple[list[tuple[int, int]], list[tuple[str, str, str]]]:
    """Every instrument against arms, surroundings and other instruments; what it rests on is left out."""
    kept: list[tuple[int, int]] = []
    omitted: list[tuple[str, str, str]] = []
    for index, item in enumerate(instruments):
        name = model.geom(item.geom).name
        kept += [(item.geom, g) for arm in arms for g in arm.geoms]
        kept += [(item.geom, other.geom) for other in instruments[index + 1 :]]
        for g in surroundings:
            if model.geom(g).name in item.rests_on:
                omitted.append((name, model.geom(g).name, "rests: the instrument lies on it"))
            else:
                kept.append((item.geom, g))
    return kept, omitted


def _why_not(
    model: mujoco.MjModel,
    arms: tuple[str, ...],
    g: int,
    h: int,
    nearest_m: float,
    farthest_m: float,
) -> str | None:
    if _joints_between(model, g, h) == 0 or farthest_m - nearest_m < _INVARIANT_M:
        return "static: no joint changes their distance"
    if arm_of_geom(model, g, arms) == arm_of_geom(model, h, arms):
        if _joints_between(model, g, h) <= NEIGHBOUR_JOINTS:
            return f"neighbours: at most {NEIGHBOUR_JOINTS} joints apart, their housings interlock by design"
        if nearest_m > APART_M:
            return f"apart: never nearer than {nearest_m:.3f} m in {SAMPLES} sampled poses"
    return None


def _joints_between(model: mujoco.MjModel, g: int, h: int) -> int:
    """Number of joints that move one geom against the other."""
    return len(_joints_above(model, g) ^ _joints_above(model, h))


def _joints_above(model: mujoco.MjModel, geom: int) -> set[int]:
    joints: set[int] = set()
    body = model.geom_bodyid[geom]
    while body:
        start, count = model.body_jntadr[body], model.body_jntnum[body]
        joints.update(range(start, start + count))
        body = model.body_parentid[body]
    return joints


def _sampled_extremes(
    model: mujoco.MjModel, arms: tuple[ArmHandles, ...], candidates: list[tuple[int, int]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Smallest and largest distance of each candidate over home and seeded random poses.

    Only self pairs and pairs with the surroundings need many poses; between arms three tell whether
    the distance changes at all.
    """
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    nearest, farthest = np.full(len(candidates), np.inf), np.full(len(candidates), -np.inf)
    arm_names = tuple(arm.name for arm in arms)
    within = np.array(
        [
            arm_of_geom(model, g, arm_names) == arm_of_geom(model, h, arm_names)
            for g, h in candidates
        ],
        dtype=bool,
    )
    for sample in range(SAMPLES):
        for arm in arms:
            low = np.where(np.isfinite(arm.lower_rad), arm.lower_rad, -np.pi)
            high = np.where(np.isfinite(arm.upper_rad), arm.upper_rad, np.pi)
            data.qpos[arm.qpos] = arm.home_rad if sample == 0 else random.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        few = sample < 4
        for k, (g, h) in enumerate(candidates):
            if few or within[k]:
                distance = mujoco.mj_geomDistance(model, data, g, h, 100.0, None)
                nearest[k], farthest[k] = min(nearest[k], distance), max(farthest[k], distance)
    return nearest, farthest

"""Which pairs of geoms are watched, and why each of the rest is not.

The list is made once, in one place, for arms against arms, arms against the static surroundings,
and an arm against itself. A pair is left out only for a written reason:

* `static`: no joint lies between the two geoms, or none changes their distance;
* `neighbours`: within one arm, at most `NEIGHBOUR_JOINTS` joints apart, where housings interlock by design;
* `excluded`: within one arm, whose file excludes the two bodies by name (contact/exclude);
* `ignored`: the scenario says so (`[[ignore]]`), and gives its own reason;
* `rests`: an instrument and the obstacle it lies on;
* `apart`: within one arm, never nearer than `APART_M` in the sampled poses.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError, did_you_mean
from workcell.scenario import Ignore
from workcell.scene.addresses import ArmAddresses, InstrumentAddresses, arm_of_geom

SENSOR_CUTOFF_M = 100.0
"""Beyond the size of any cell: a smaller one would cut distances off in silence."""

NEIGHBOUR_JOINTS = 2
"""Links up to two joints apart share a housing joint (on the PA10: shoulder, elbow and wrist forks)."""
APART_M = 0.05
"""Self pairs that stay farther apart than this in all sampled poses cannot meet; the margin covers what sampling misses."""
SAMPLES = 500
FEW_SAMPLES = 4
"""What it takes to see whether a distance changes at all: home and three more."""
_INVARIANT_M = 1e-6
_KEPT = 8
"""Sets of arms whose self pairs are remembered; chosen larger than what one study has."""
_self_extremes: dict[str, list[tuple[float, float]]] = {}
"""What `_within` found, by the digest of the arms."""


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
    ignored: tuple[tuple[str, str, str], ...] = ()
    """Those of them that only the scenario leaves out: the user answers for them."""

    def __len__(self) -> int:
        return len(self.names)


def watched_pairs(
    model: mujoco.MjModel,
    arms: tuple[ArmAddresses, ...],
    instruments: tuple[InstrumentAddresses, ...] = (),
    *,
    arms_digest: str | None = None,
    ignore: tuple[Ignore, ...] = (),
) -> WatchedPairs:
    """Make the list for a compiled scene (sensors not needed).

    Args:
        model: The scene.
        arms: All of its arms.
        instruments: All of its instruments.
        arms_digest: Equal for the same arms, wherever they stand; what is found of their self pairs is kept by it.
        ignore: Pairs that the scenario leaves out.

    Raises:
        InputError: `ignore` names what is not in the scene.

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
    kept: list[tuple[int, int]] = []
    omitted: list[tuple[str, str, str]] = []
    excluded = {int(signature) for signature in model.exclude_signature}
    for candidate in _sampled(model, arms, candidates, arms_digest):
        reason = candidate.why_not()
        if reason is None and candidate.within and _signature(model, candidate.geoms) in excluded:
            reason = "excluded: the arm file excludes the two bodies by name (contact/exclude)"
        if reason is None:
            kept.append(candidate.geoms)
        else:
            g, h = candidate.geoms
            omitted.append((model.geom(g).name, model.geom(h).name, reason))
    kept += loose
    omitted += rests
    kept, ignored = _without_ignored(model, kept, ignore)
    omitted += ignored
    owner = {g: arm.name for arm in arms for g in arm.geoms} | {
        item.geom: item.name for item in instruments
    }
    return WatchedPairs(
        geoms=np.array(kept, dtype=np.intp).reshape(-1, 2),
        names=tuple((model.geom(g).name, model.geom(h).name) for g, h in kept),
        owners=tuple((owner[g], owner.get(h)) for g, h in kept),
        omitted=tuple(omitted),
        ignored=tuple(ignored),
    )


def _without_ignored(
    model: mujoco.MjModel, kept: list[tuple[int, int]], ignore: tuple[Ignore, ...]
) -> tuple[list[tuple[int, int]], list[tuple[str, str, str]]]:
    """The pairs that are left, and those that the scenario leaves out."""
    ignored: list[tuple[str, str, str]] = []
    faults: list[str] = []
    names = {
        g: {model.geom(g).name, model.body(model.geom_bodyid[g]).name} for g in range(model.ngeom)
    }
    known = {name for both in names.values() for name in both}
    for index, entry in enumerate(ignore):
        unknown = [name for name in entry.pair if name not in known]
        if unknown:
            faults.append(
                f"ignore.{index}.pair: no body or geom of the scene is named {unknown[0]!r}"
                f"{did_you_mean(unknown[0], known) or '; allowed: ' + ', '.join(sorted(known - {''}))}"
            )
            continue
        one, other = entry.pair
        off = {
            (g, h)
            for g, h in kept
            if (one in names[g] and other in names[h]) or (one in names[h] and other in names[g])
        }
        ignored += [
            (model.geom(g).name, model.geom(h).name, f"ignored: {entry.reason}")
            for g, h in kept
            if (g, h) in off
        ]
        kept = [pair for pair in kept if pair not in off]
    if faults:
        raise InputError(faults)
    return kept, ignored


def _instrument_pairs(
    model: mujoco.MjModel,
    arms: tuple[ArmAddresses, ...],
    instruments: tuple[InstrumentAddresses, ...],
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


@dataclass(slots=True)
class _Candidate:
    """A pair with an arm, and what the sampled poses tell of it so far."""

    geoms: tuple[int, int]
    joints: int
    """Number of joints that move one geom against the other."""
    within: bool
    """Whether both are the same arm's."""
    nearest_m: float = np.inf
    farthest_m: float = -np.inf

    @property
    def is_settled(self) -> bool:
        """Whether no further pose can change the answer for a self pair, or its reason."""
        if self.joints == 0:
            return True
        varies = self.farthest_m - self.nearest_m >= _INVARIANT_M
        return varies and (self.joints <= NEIGHBOUR_JOINTS or self.nearest_m <= APART_M)

    def see(self, *distances_m: float) -> None:
        """Take distances into account."""
        self.nearest_m = min(self.nearest_m, *distances_m)
        self.farthest_m = max(self.farthest_m, *distances_m)

    def why_not(self) -> str | None:
        """The reason to leave it out, None if it is watched."""
        if self.joints == 0 or self.farthest_m - self.nearest_m < _INVARIANT_M:
            return "static: no joint changes their distance"
        if self.within:
            if self.joints <= NEIGHBOUR_JOINTS:
                return f"neighbours: at most {NEIGHBOUR_JOINTS} joints apart, their housings interlock by design"
            if self.nearest_m > APART_M:
                return f"apart: never nearer than {self.nearest_m:.3f} m in {SAMPLES} sampled poses"
        return None


def _signature(model: mujoco.MjModel, geoms: tuple[int, int]) -> int:
    """MuJoCo's number of a pair of bodies: the smaller id high."""
    low, high = sorted(int(model.geom_bodyid[g]) for g in geoms)
    return (low << 16) + high


def _joints_above(model: mujoco.MjModel, geom: int) -> set[int]:
    joints: set[int] = set()
    body = model.geom_bodyid[geom]
    while body:
        start, count = model.body_jntadr[body], model.body_jntnum[body]
        joints.update(range(start, start + count))
        body = model.body_parentid[body]
    return joints


def _sampled(
    model: mujoco.MjModel,
    arms: tuple[ArmAddresses, ...],
    pairs: list[tuple[int, int]],
    arms_digest: str | None,
) -> list[_Candidate]:
    """Look at every pair at home and in seeded random poses.

    Only self pairs need many poses; for the rest a few tell whether the distance changes at all.
    """
    above = {g: _joints_above(model, g) for pair in pairs for g in pair}
    owner = {g: arm.name for arm in arms for g in arm.geoms}
    candidates = [
        _Candidate((g, h), len(above[g] ^ above[h]), owner[g] == owner.get(h)) for g, h in pairs
    ]
    lower = np.concatenate([arm.lower_rad for arm in arms])
    upper = np.concatenate([arm.upper_rad for arm in arms])
    poses = np.random.default_rng(0).uniform(
        np.where(np.isfinite(lower), lower, -np.pi),
        np.where(np.isfinite(upper), upper, np.pi),
        (SAMPLES - 1, len(lower)),
    )
    home = np.concatenate([arm.home_rad for arm in arms])
    _look(model, arms, [home, *poses[: FEW_SAMPLES - 1]], candidates)
    within = [pair for pair in candidates if pair.within]
    found = _self_extremes.get(arms_digest or "")
    if found is None:
        found = _within(model, arms, within, poses)
        if arms_digest is not None:
            while len(_self_extremes) >= _KEPT:
                del _self_extremes[next(iter(_self_extremes))]
            _self_extremes[arms_digest] = found
    for pair, extremes in zip(within, found, strict=True):
        pair.see(*extremes)
    return candidates


def _within(
    model: mujoco.MjModel,
    arms: tuple[ArmAddresses, ...],
    pairs: list[_Candidate],
    poses: NDArray[np.float64],
) -> list[tuple[float, float]]:
    """Smallest and largest distance of self pairs over the random poses, as far as these can change an answer.

    The arms stand at the origin, so that not even a last digit depends on where they stand in a scene.
    """
    model = copy.copy(model)
    for arm in arms:
        base = model.body_rootid[model.geom_bodyid[arm.geoms[0]]]
        model.body_pos[base], model.body_quat[base] = 0.0, (1.0, 0.0, 0.0, 0.0)
    afresh = [_Candidate(pair.geoms, pair.joints, within=True) for pair in pairs]
    _look(model, arms, poses, afresh)
    return [(pair.nearest_m, pair.farthest_m) for pair in afresh]


def _look(
    model: mujoco.MjModel,
    arms: tuple[ArmAddresses, ...],
    poses: Iterable[NDArray[np.float64]],
    pairs: list[_Candidate],
) -> None:
    """Measure the pairs in poses, each for as long as that can change the answer."""
    data = mujoco.MjData(model)
    addresses = np.concatenate([arm.qpos for arm in arms])
    for pose in poses:
        data.qpos[addresses] = pose
        mujoco.mj_kinematics(model, data)
        for pair in pairs:
            pair.see(mujoco.mj_geomDistance(model, data, *pair.geoms, 100.0, None))
        pairs = [pair for pair in pairs if not (pair.within and pair.is_settled)]

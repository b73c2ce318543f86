"""Where an adapted arm starts, and which of its parts touch by construction.

Both are found by looking at seeded random poses within the joint ranges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.adapt.capsules import Capsule
from workcell.scene.coverage import surface
from workcell.scene.pairs import NEIGHBOUR_JOINTS

SAMPLES = 200
NEAR_M = 0.012
"""Capsules this near count as touching: a little more than the default d_min, at which a start is refused."""
BY_CONSTRUCTION = 0.5
"""Share of poses in which two links touch from which on their touching is how the arm is built, not an accident."""
CLEAR_M = 0.03
"""Room that a home leaves between parts of the arm, and above the floor."""
OUTWARD = 0.3
"""Weight of a tool that points away from the base, beside a dexterity of about 0.2; chosen so that two arms can face one another."""
LACKING = 200.0
"""Weight of a metre of room that lacks, beside a dexterity of about 0.2; chosen so that a millimetre counts as much as dexterity."""
CANDIDATES = 800
TOOL = "tool"

HOUSING, CAPSULES = 2, 4
"""Groups of an adapted arm's geoms."""

Pairs = tuple[tuple[str, str], ...]
BodyPairs = dict[tuple[int, int], list[tuple[int, int]]]
"""Geom pairs by body pair."""


@dataclass(frozen=True)
class Touching:
    """Links that are not held apart."""

    pairs: Pairs
    """Names of bodies."""
    said: tuple[str, ...]


@dataclass(frozen=True)
class Home:
    """A start."""

    q: NDArray[np.float64]
    guessed: tuple[str, ...]
    reach_m: float
    floor_m: float
    """Height of the floor in the base's frame."""
    on_floor: tuple[str, ...]
    """Bodies that move level over the floor, nearer than `NEAR_M`."""


def poses(model: mujoco.MjModel) -> NDArray[np.float64]:
    """(SAMPLES, nq) within the joint ranges, to half a turn where a joint has none."""
    limited = model.jnt_limited.astype(bool)
    lower = np.where(limited, model.jnt_range[:, 0], -np.pi)
    upper = np.where(limited, model.jnt_range[:, 1], np.pi)
    return np.random.default_rng(0).uniform(lower, upper, (SAMPLES, model.nq))


def _pairs(model: mujoco.MjModel, group: int, fewest: int, most: int) -> BodyPairs:
    """Geom pairs of a group whose bodies are so many joints apart, by body pair."""
    above: dict[int, frozenset[int]] = {0: frozenset()}
    for body in range(1, model.nbody):
        start, count = model.body_jntadr[body], model.body_jntnum[body]
        above[body] = above[int(model.body_parentid[body])] | set(range(start, start + count))
    found: BodyPairs = {}
    for g, h in combinations(np.flatnonzero(model.geom_group == group).tolist(), 2):
        pair = int(model.geom_bodyid[g]), int(model.geom_bodyid[h])
        if fewest <= len(above[pair[0]] ^ above[pair[1]]) <= most:
            found.setdefault(pair, []).append((g, h))
    return found


def _far_pairs(model: mujoco.MjModel) -> BodyPairs:
    """Capsule pairs of bodies that are more than NEIGHBOUR_JOINTS joints apart."""
    return _pairs(model, CAPSULES, NEIGHBOUR_JOINTS + 1, model.njnt)


def _folding_pairs(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Housing pairs of nearer bodies that are near in some poses and apart in others: the arm may fold onto itself there."""
    data = mujoco.MjData(model)
    near = [p for pairs in _pairs(model, HOUSING, 1, NEIGHBOUR_JOINTS).values() for p in pairs]
    count = np.zeros(len(near), dtype=int)
    for pose in poses(model):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        count += [mujoco.mj_geomDistance(model, data, g, h, 0.1, None) < NEAR_M for g, h in near]
    return [pair for pair, c in zip(near, count, strict=True) if 0 < c < SAMPLES]


def touching_by_construction(model: mujoco.MjModel) -> Touching:
    """Links more than two joints apart whose capsules touch in most poses."""
    far, data = _far_pairs(model), mujoco.MjData(model)
    counts = dict.fromkeys(far, 0)
    for pose in poses(model):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        for pair, capsules in far.items():
            counts[pair] += any(
                mujoco.mj_geomDistance(model, data, g, h, 1.0, None) < NEAR_M for g, h in capsules
            )
    pairs, said = [], []
    for (i, j), count in counts.items():
        share = count / SAMPLES
        if share >= BY_CONSTRUCTION:
            names = model.body(i).name, model.body(j).name
            pairs.append(names)
            said.append(
                f"{names[0]} and {names[1]} touch in {100 * share:.0f} % of {SAMPLES} poses, thus by construction: not held apart (contact/exclude)"
            )
    return Touching(tuple(pairs), tuple(said))


def choose(
    model: mujoco.MjModel,
    excluded: Pairs,
    keyframe: tuple[str, NDArray[np.float64]] | None,
    beside: Callable[[mujoco.MjData], float] | None = None,
) -> Home:
    """The file's keyframe if the arm is clear of itself in it, else the sampled pose with most room to move.

    Args:
        model: The adapted arm.
        excluded: Links that are not held apart.
        keyframe: Name and positions of the file's own home.
        beside: Distance in m from what else stands there, in a pose.
    """
    data = mujoco.MjData(model)
    room = _Room(model, data, beside)
    site = model.site(TOOL).id
    sampled = poses(model)
    reach = 0.0
    for pose in sampled:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        reach = max(reach, float(np.linalg.norm(data.site_xpos[site])))
    skipped = {frozenset(pair) for pair in excluded}
    far = [
        pair
        for (i, j), capsules in _far_pairs(model).items()
        if frozenset((model.body(i).name, model.body(j).name)) not in skipped
        for pair in capsules
    ]
    folding = _folding_pairs(model)
    said = []
    if keyframe is not None:
        name, q = keyframe
        if (
            room.clearance(far, folding, q) > CLEAR_M
            and _dexterity(model, data, site, reach) > 0.02
        ):
            return Home(q, (f"home: keyframe {name}",), reach, room.floor_m, room.on_floor)
        said.append(
            f"keyframe {name} is no home: the arm is too near itself in it, or cannot move its tool every way"
        )
    # The middle of each range draws the arm together; half of it is room enough to find a pose.
    middle = model.jnt_range.mean(axis=1) * model.jnt_limited
    half = np.where(
        model.jnt_limited, np.minimum(np.ptp(model.jnt_range, axis=1) / 2, np.pi), np.pi
    )
    drawn = np.random.default_rng(1).uniform(-0.7, 0.7, (CANDIDATES, model.nq))
    best, best_score = middle, -np.inf
    for pose in (middle, *(middle + half * drawn)):
        clearance = room.clearance(far, folding, pose)
        tool = data.site_xpos[site].copy()
        out = float(np.hypot(*tool[:2])) / max(reach, 1e-9)
        score = _dexterity(model, data, site, reach)
        score -= (
            max(0.0, 0.4 - out)
            + max(0.0, out - 0.75)
            + max(0.0, 0.1 - (tool[2] - room.floor_m) / max(reach, 1e-9))
        )
        score -= LACKING * max(0.0, CLEAR_M - clearance)
        if score > best_score:
            best, best_score = pose, score
    said.append(
        f"home: of {CANDIDATES} poses the one in which the tool can move best, points outwards and the arm is clear of itself"
    )
    return Home(best, tuple(said), reach, room.floor_m, room.on_floor)


class _Room:
    """What an arm needs room from: itself, the floor, and what stands beside it."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        beside: Callable[[mujoco.MjData], float] | None,
    ):
        self._model, self._data, self._beside = model, data, beside
        self._moving = [
            g
            for g in np.flatnonzero(model.geom_group == CAPSULES).tolist()
            if model.body_weldid[model.geom_bodyid[g]]
        ]
        lowest = min([0.0, *self._lowest_of_base(), *self._lowest_of_links()])
        self.floor_m = lowest if lowest < -CLEAR_M else 0.0
        """Height of the floor in the base's frame: 0, unless base or links cannot but be well below it."""

    def _lowest_of_base(self) -> list[float]:
        """Heights of the lowest points of what stands still."""
        model, data = self._model, self._data
        mujoco.mj_kinematics(model, data)
        standing = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist()
        return [
            float(surface(model, data, g)[:, 2].min())
            for g in standing
            if model.geom_group[g] != CAPSULES
        ]

    def _lowest_of_links(self) -> list[float]:
        """Where the floor must be at least for each moving capsule to be clear of it in the best of the sampled poses.

        A capsule whose height never changes, as that of a link that turns about the vertical, needs no room.
        """
        heights = []
        for pose in poses(self._model):
            self._data.qpos[:] = pose
            mujoco.mj_kinematics(self._model, self._data)
            heights.append([self._bottom(g) for g in self._moving])
        heights = np.array(heights).reshape(SAMPLES, -1)
        turns_level = np.ptp(heights, axis=0) < 1e-6
        near = heights.max(axis=0, initial=-np.inf) < NEAR_M
        self.on_floor = tuple(
            dict.fromkeys(
                self._model.body(self._model.geom_bodyid[g]).name
                for g, level in zip(self._moving, turns_level & near, strict=True)
                if level and self._slides(int(self._model.geom_bodyid[g]))
            )
        )
        """Bodies that a slide joint moves level over the floor."""
        self._rising = [g for g, level in zip(self._moving, turns_level, strict=True) if not level]
        """Capsules whose height a pose changes."""
        best = heights.max(axis=0, initial=-np.inf) - 2 * CLEAR_M
        return best[~turns_level].tolist()

    def _slides(self, body: int) -> bool:
        model = self._model
        while body:
            start, count = model.body_jntadr[body], model.body_jntnum[body]
            if mujoco.mjtJoint.mjJNT_SLIDE in model.jnt_type[start : start + count]:
                return True
            body = int(model.body_parentid[body])
        return False

    def _bottom(self, geom: int) -> float:
        model, data = self._model, self._data
        half = abs(data.geom_xmat[geom].reshape(3, 3)[2, 2]) * model.geom_size[geom, 1]
        return float(data.geom_xpos[geom, 2] - half - model.geom_size[geom, 0])

    def clearance(
        self,
        far: list[tuple[int, int]],
        folding: list[tuple[int, int]],
        q: NDArray[np.float64],
    ) -> float:
        """Least distance of capsules that must stay apart, of moving ones above the floor and from what is beside.

        Neighbours that could fold onto one another are near by design: `NEAR_M` between them counts as `CLEAR_M`.
        """
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        least = min(
            [
                0.2,
                *(mujoco.mj_geomDistance(model, data, g, h, 0.2, None) for g, h in far),
                *(
                    mujoco.mj_geomDistance(model, data, g, h, 0.2, None) + CLEAR_M - NEAR_M
                    for g, h in folding
                ),
            ]
        )
        for g in self._rising:
            least = min(least, self._bottom(g) - self.floor_m)
        if self._beside is not None:
            least = min(least, self._beside(data))
        return float(least)


def capsule_at(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Capsule:
    """Where a capsule geom is, in the frame of the model's world."""
    axis = model.geom_size[geom, 1] * data.geom_xmat[geom].reshape(3, 3)[:, 2]
    ends = data.geom_xpos[geom] + np.array([-axis, axis])
    return Capsule(ends, float(model.geom_size[geom, 0]))


def gap(one: Capsule, other: Capsule, points: int = 9) -> float:
    """Distance of two capsules in m, measured from points along one axis: too large by at most half their spacing squared
    over twice the distance of the axes."""
    share = np.linspace(0.0, 1.0, points)[:, None]
    along = one.ends[0] + share * (one.ends[1] - one.ends[0])
    return float(other.beyond(along).min()) - one.radius_m


def _dexterity(model: mujoco.MjModel, data: mujoco.MjData, site: int, reach: float) -> float:
    """Smallest singular value of the tool's Jacobian, lengths in units of the reach."""
    position, rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, position, rotation, site)
    return float(
        np.linalg.svd(np.concatenate([position / max(reach, 1e-9), rotation]), compute_uv=False)[
            min(6, model.nv) - 1
        ]
    )

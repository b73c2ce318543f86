"""Times to collision of the watched capsules, from the plant's states and blamed pair by pair (docs/theory.md sections 4 and 9).

Each body's velocity is MuJoCo's, so a pair's rate falls apart into its two parties' shares: n · v at either nearest point.

    total   -d / (a + b)            whatever both do
    own     -d / (a + max(0, b))    what party a answers for where b is another arm's share: a that closes is not
                                    excused by b that closes too, and b that leaves makes room

A pair with what stands, or of an arm with itself, is the arm's alone: own is total. A pair is forced on an arm where
its total falls short of t_min, its own does not, and the other party closes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.judge.kinematics import Stretch, length, point_velocity
from workcell.judge.scene import JudgedScene
from workcell.judge.watch import PairWatch

Array = NDArray[np.float64]

SHORT_SHARE = 0.99
"""A time to collision below this share of t_min is too short; the bound of the scenarios' `[expect]`."""
RESTING_M_S = 1e-4
"""An arm's share that closes more slowly is the creep of an arm at rest."""
COINCIDENT_M = 1e-9
"""Nearest points this near to each other give no direction: the rate is then taken from centre to centre."""
LONGEST_TTC_S = 60.0
"""Times to collision beyond it are not looked for."""


@dataclass
class Smallest:
    """The smallest time to collision of a kind, and where it was."""

    ttc_s: float = np.inf
    time_s: float | None = None
    pair: int = -1

    def take(self, ttc_s: float, time_s: float, pair: int) -> None:
        """Keep it if it is smaller."""
        if ttc_s < self.ttc_s:
            self.ttc_s, self.time_s, self.pair = ttc_s, time_s, pair


@dataclass
class ArmApproach:
    """How one support arm kept its times to collision."""

    own: Smallest = field(default_factory=Smallest)
    """The smallest it answers for, by its commanded velocities."""
    share: float = np.inf
    """That or another as a share of the t_min of its tick, the smallest."""
    short_ticks: int = 0
    """Ticks in which what it answers for was below `SHORT_SHARE` of t_min."""
    forced_ticks: int = 0
    """Ticks in which a pair was, for what the other party did."""


class ApproachWatch:
    """Watches the capsule pairs of one run, tick by tick.

    Args:
        scene: The scene.
        pairs: Names of the two geoms of each watched pair.
        hands: Pairs that do not count while an arm holds an instrument, by `instrument=arm`.
        meeting: Pairs that jobs bring together: `apart_m` is without them.
    """

    def __init__(
        self,
        scene: JudgedScene,
        pairs: list[tuple[str, str]],
        hands: Mapping[str, list[int]] | None = None,
        meeting: list[tuple[str, str]] | None = None,
    ):
        self.scene = scene
        model = scene.model
        ids = np.array([[model.geom(n).id for n in pair] for pair in pairs], dtype=np.intp)
        self._pairs = ids.reshape(-1, 2)
        self._watch = PairWatch(model, self._pairs)
        self._data = mujoco.MjData(model)
        self._hands = hands or {}
        meets = {frozenset(pair) for pair in meeting or []}
        self._apart = np.array([frozenset(pair) not in meets for pair in pairs], dtype=bool)
        self._body = model.geom_bodyid.copy()
        self._holders: Mapping[str, str | None] | None = None
        self._assign({})
        self.smallest_m, self.smallest_pair, self.smallest_time_s = np.inf, -1, 0.0
        """Smallest distance of all pairs that count, m."""
        self.apart_m = np.inf
        self.measured, self.commanded = Smallest(), Smallest()
        """Smallest times to collision of all pairs, by true and by commanded velocities."""
        self.arms = {arm: ArmApproach() for arm in scene.support}

    def look(self, ticks: Stretch, holders: Mapping[str, str | None] | None = None) -> None:
        """Take some ticks into account.

        Args:
            ticks: Their kinematics.
            holders: For every instrument the arm that holds it in all of them.
        """
        if not len(self._pairs):
            return
        if holders is not None and holders is not self._holders:
            self._assign(holders)
            self._holders = holders
        found = self._measure(ticks)
        if not len(found.tick):
            return
        self._keep_distances(ticks, found)
        distance, now = found.distance, ticks.time_s[found.tick]
        total = _ttc(distance, self._shares(ticks, found, ticks.true).sum(axis=1))
        k = int(total.argmin())
        self.measured.take(float(total[k]), float(now[k]), int(found.pair[k]))
        self._blame(ticks, found, self._shares(ticks, found, ticks.told))

    def _measure(self, ticks: Stretch) -> _Found:
        """Distances of the pairs that can matter, tick by tick."""
        watch, data, i, j = self._watch, self._data, self._pairs[:, 0], self._pairs[:, 1]
        fastest = np.maximum(self._fastest(ticks, ticks.true), self._fastest(ticks, ticks.told))
        closing = fastest[:, i] + fastest[:, j]
        ways = watch.ways(ticks.position, ticks.rotation)
        known = max(self.measured.ttc_s, self.commanded.ttc_s)
        wanted = np.where(self._apart, max(self.smallest_m, self.apart_m), self.smallest_m)
        tick, pair, distance, ends = [], [], [], []
        for c in range(len(ticks)):
            watch.lower_m -= ways[c]
            horizon = min(max(ticks.t_min_s[c], known), LONGEST_TTC_S)
            near = watch.lower_m < np.maximum(closing[c] * horizon, wanted)
            near = np.flatnonzero(near & self._counts)
            if near.size:
                data.geom_xpos[:], data.geom_xmat[:] = ticks.position[c], ticks.rotation[c]
                distance.append(watch.measure(data, near))
                ends.append(watch.ends_m[near])
                pair.append(near)
                tick.append(np.full(len(near), c))
        if not tick:
            none = np.empty(0, dtype=np.intp)
            return _Found(none, none, np.empty(0), np.empty((0, 6)))
        return _Found(
            np.concatenate(tick),
            np.concatenate(pair),
            np.concatenate(distance),
            np.concatenate(ends),
        )

    def _keep_distances(self, ticks: Stretch, found: _Found) -> None:
        best = int(found.distance.argmin())
        if found.distance[best] < self.smallest_m:
            self.smallest_m = float(found.distance[best])
            self.smallest_time_s = float(ticks.time_s[found.tick[best]])
            self.smallest_pair = int(found.pair[best])
        apart = found.distance[self._apart[found.pair]]
        self.apart_m = min(self.apart_m, float(apart.min(initial=np.inf)))

    def _blame(self, ticks: Stretch, found: _Found, rates: Array) -> None:
        distance, now = found.distance, ticks.time_s[found.tick]
        total, t_min_s = _ttc(distance, rates.sum(axis=1)), ticks.t_min_s[found.tick]
        k = int(total.argmin())
        self.commanded.take(float(total[k]), float(now[k]), int(found.pair[k]))
        for arm, kept in self.arms.items():
            mine = self._party[found.pair] == self.scene.arms.index(arm)
            concerned = mine.any(axis=1)
            if not concerned.any():
                continue
            own_share = np.where(mine, rates, 0.0).sum(axis=1)
            other_share = np.where(mine, 0.0, rates).sum(axis=1)
            own = _ttc(distance, own_share + np.maximum(other_share, 0.0))
            own = np.where(concerned & (own_share < -RESTING_M_S), own, np.inf)
            k = int(own.argmin())
            kept.own.take(float(own[k]), float(now[k]), int(found.pair[k]))
            kept.share = min(kept.share, float((own / t_min_s).min()))
            short = own < SHORT_SHARE * t_min_s
            kept.short_ticks += len(np.unique(found.tick[short]))
            forced = concerned & (total < SHORT_SHARE * t_min_s) & ~short
            forced &= other_share < -RESTING_M_S
            kept.forced_ticks += len(np.unique(found.tick[forced]))

    def _assign(self, holders: Mapping[str, str | None]) -> None:
        """Who is the party of each geom, and with which body it moves, as the instruments are held now."""
        scene, model = self.scene, self.scene.model
        party = np.full(model.ngeom, -1)
        for g in range(model.ngeom):
            owner = scene.owner_of(g)
            holder = holders.get(owner, owner) if owner is not None else None
            if holder in scene.arms:
                party[g] = scene.arms.index(holder)
                if owner in scene.instruments:
                    self._body[g] = scene.tool_body[holder]
            elif owner in scene.instruments:
                self._body[g] = 0
        self._party = party[self._pairs]
        """(P, 2) number of the arm that moves each geom, -1 for none."""
        self._counts: NDArray[np.bool_] = np.any(self._party >= 0, axis=1)
        for held, pairs in self._hands.items():
            item, _, arm = held.partition("=")
            if holders.get(item) == arm:
                self._counts[pairs] = False

    def _fastest(self, ticks: Stretch, twist: Array) -> Array:
        """(C, G) bound on the speed of any point of each geom."""
        body = self._body
        at_centre = point_velocity(twist[:, body], ticks.centre[:, body], ticks.position)
        return length(at_centre) + length(twist[:, body, :3]) * self.scene.model.geom_rbound

    def _shares(self, ticks: Stretch, found: _Found, twist: Array) -> Array:
        """(K, 2) the parts of the rates that the two geoms of each pair have."""
        c, distance, ends = found.tick, found.distance, found.ends
        i, j = self._pairs[found.pair, 0], self._pairs[found.pair, 1]
        along = ends[:, :3] - ends[:, 3:]
        apart = np.abs(distance) > COINCIDENT_M
        normal = np.divide(along, distance[:, None], where=apart[:, None], out=np.zeros_like(along))
        if not apart.all():
            centres = ticks.position[c, i] - ticks.position[c, j]
            centres /= np.maximum(length(centres)[:, None], COINCIDENT_M)
            normal = np.where(apart[:, None], normal, centres)
        shares = []
        for geom, point, sign in ((i, ends[:, :3], 1.0), (j, ends[:, 3:], -1.0)):
            body = self._body[geom]
            moving = point_velocity(twist[c, body], ticks.centre[c, body], point)
            shares.append(sign * np.vecdot(normal, moving))
        return np.stack(shares, axis=1)


@dataclass(frozen=True)
class _Found:
    """Measured distances of a stretch, K of them."""

    tick: NDArray[np.intp]
    """(K,) place in the stretch, rising."""
    pair: NDArray[np.intp]
    """(K,)"""
    distance: Array
    """(K,)"""
    ends: Array
    """(K, 6) nearest points on the two geoms."""


def _ttc(distance: Array, rate: Array) -> Array:
    """(K,) -d / rate where a pair closes, 0 in contact, else infinite."""
    closing = rate < 0.0
    time = np.divide(
        np.maximum(distance, 0.0), -rate, where=closing, out=np.full(len(rate), np.inf)
    )
    return np.where(closing, time, np.inf)

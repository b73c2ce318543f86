"""Did solids touch, and whose motion closed the gap?

Watches the plant's true state, pose by pose. At a touch each arm's share of the closing speed of the pair is
taken: -∂d/∂q q̇ over its own joints and over what it holds, by central differences of the distance itself,
which exist on faces and edges and under penetration alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.judge.own_parts import GRAZE_M
from workcell.judge.scene import JudgedScene
from workcell.judge.watch import PairWatch

Array = NDArray[np.float64]

CAUSING_M_S = 1e-3
"""An arm whose own motion closes the gap faster has a part in it. Chosen as a tenth of the slowest closing
speed that matters, d_min / t_min at their defaults, and well above the creep of a servo."""
DIFFERENCE_S = 1e-4
"""Time over which distances are differenced: a few micrometres of motion at working speeds, far below any feature of a housing."""
CEILING_M = 0.1
"""Distances beyond it are of no interest to the search for one that a support arm closes."""
TOUCH_M = 1e-6
"""Nearer pairs are always measured, whatever the smallest distance was."""
MOST_CONTACTS = 20
"""Touching pairs that are told; a run that has touched goes on and touches much."""


@dataclass(frozen=True)
class Contact:
    """A touch: the first of its pair."""

    time_s: float
    """When, s of simulated time."""
    pair: tuple[str, str]
    """Names of the two solids."""
    closing_m_s: dict[str, float]
    """How fast each arm's own motion closed the gap, m/s; negative if it opened it."""
    support: tuple[str, ...] = field(default=(), repr=False)
    """Which of the arms are support arms."""

    @property
    def support_m_s(self) -> float:
        """The support arms' part."""
        return sum(v for arm, v in self.closing_m_s.items() if arm in self.support)

    @property
    def priority_m_s(self) -> float:
        """The priority arms' part."""
        return sum(v for arm, v in self.closing_m_s.items() if arm not in self.support)

    @property
    def causes(self) -> tuple[str, ...]:
        """The arms whose own motion closed the gap."""
        return tuple(arm for arm, v in self.closing_m_s.items() if v > CAUSING_M_S)

    @property
    def cause(self) -> str:
        """`support`, `priority`, `both`, or `none` where nobody's motion closed the gap."""
        kinds = {arm in self.support for arm in self.causes}
        if len(kinds) == 2:
            return "both"
        return "none" if not kinds else "support" if kinds == {True} else "priority"


class ContactWatch:
    """Watches one run, look by look.

    Args:
        scene: The scene.
        meeting: Pairs of watched geoms that jobs bring together: the solids of their bodies may come near,
            and are left out of the smallest distance; a touch of theirs is a touch.
        clear_m: Distance at which a hand is clear of what it has let go.
    """

    def __init__(
        self, scene: JudgedScene, meeting: list[tuple[str, str]] | None = None, *, clear_m: float
    ):
        self.scene = scene
        self._clear_m = clear_m
        model = scene.model
        pairs = np.concatenate([scene.solid_pairs, scene.neighbours])
        self._watch = PairWatch(model, pairs)
        neighbours = np.arange(len(pairs)) >= len(scene.solid_pairs)
        self._touch_m = np.where(neighbours, -GRAZE_M, 0.0)
        """(P,) distance from which on a pair touches."""
        self._watch.lower_m[
            neighbours
        ] = -np.inf  # Nothing is known of them yet, not even that they are apart.
        self._data, self._moved = mujoco.MjData(model), mujoco.MjData(model)
        bodies = model.geom_bodyid[pairs]
        meets = {
            frozenset(int(model.geom_bodyid[model.geom(name).id]) for name in pair)
            for pair in meeting or []
        }
        self._apart = ~neighbours & np.array(
            [frozenset(pair) not in meets for pair in bodies.tolist()], dtype=bool
        )
        """(P,) pairs whose distance counts as the smallest: not those that are meant to meet, nor neighbours."""
        self._in_hand = {
            (item, arm): np.array(
                [
                    {scene.owner[a], scene.owner[b]} == {item, arm} and bool({a, b} & hand)
                    for a, b in bodies.tolist()
                ],
                dtype=bool,
            )
            for item in scene.instruments
            for arm, hand in scene.hands.items()
        }
        self._let_off: set[tuple[str, str]] = set()
        """Instrument and arm: held, or let go and not clear yet."""
        self._touching: set[int] = set()
        self._before: tuple[Array, Array] | None = None
        """The state at the last look."""
        self.smallest_m = np.inf
        """Smallest distance seen over all pairs that are not meeting, m."""
        self.smallest_pair: tuple[str, str] | None = None
        self.smallest_time_s = 0.0
        self.smallest_support_m = np.inf
        """Smallest distance seen that a support arm's own motion was closing, m."""
        self.contacts: list[Contact] = []
        """The first touch of every pair that has touched, in order."""

    @property
    def contact(self) -> Contact | None:
        """The first touch."""
        return self.contacts[0] if self.contacts else None

    def look(
        self,
        time_s: float,
        qpos: Array,
        qvel: Array,
        holders: Mapping[str, str | None] | None = None,
    ) -> None:
        """Take one true state into account.

        Args:
            time_s: When.
            qpos, qvel: (nq,), (nv,).
            holders: For every instrument the arm that holds it.
        """
        holders = holders or {}
        watch, data = self._watch, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.scene.model, data)
        watch.move(data)
        off = self._off(data, holders)
        limit = max(self.smallest_m, min(self.smallest_support_m, CEILING_M), TOUCH_M)
        limit = np.where(self._touch_m < 0.0, self._touch_m, limit)
        near = np.flatnonzero((watch.lower_m < limit) & ~off)
        if not near.size:
            self._touching.clear()
            self._before = np.array(qpos), np.array(qvel)
            return
        distance = watch.measure(data, near)
        touching = near[distance <= self._touch_m[near]].tolist()
        for k in touching:
            if k not in self._touching and len(self.contacts) < MOST_CONTACTS:
                shares = self._shares(k, qpos, qvel, holders)
                if self._before and max(map(abs, shares.values()), default=0.0) <= CAUSING_M_S:
                    # Of some shapes MuJoCo tells no depth: then what closed the gap at the last look counts.
                    shares = self._shares(k, *self._before, holders)
                self.contacts.append(Contact(time_s, self._names(k), shares, self.scene.support))
        self._before = np.array(qpos), np.array(qvel)
        self._touching = set(touching)
        apart = self._apart[near]
        if apart.any():
            best = near[apart][distance[apart].argmin()]
            if watch.lower_m[best] < self.smallest_m:
                self.smallest_m = float(watch.lower_m[best])
                self.smallest_pair, self.smallest_time_s = self._names(best), time_s
        self._support_closes(near[apart], qpos, qvel, holders)

    def _off(self, data: mujoco.MjData, holders: Mapping[str, str | None]) -> NDArray[np.bool_]:
        """(P,) pairs of instruments with hands that hold them, or have let go and are not clear yet."""
        off = np.zeros(len(self._watch.pairs), dtype=bool)
        for key, pairs in self._in_hand.items():
            item, arm = key
            if holders.get(item) == arm:
                self._let_off.add(key)
            elif key in self._let_off:
                numbers = np.flatnonzero(pairs)
                if self._watch.measure(data, numbers).min(initial=np.inf) > self._clear_m:
                    self._let_off.discard(key)
            if key in self._let_off:
                off |= pairs
        return off

    def _support_closes(
        self, numbers: NDArray[np.intp], qpos: Array, qvel: Array, holders: Mapping[str, str | None]
    ) -> None:
        """Keep the smallest distance that a support arm's motion was closing."""
        order = numbers[np.argsort(self._watch.lower_m[numbers])]
        for k in order.tolist():
            distance = float(self._watch.lower_m[k])
            if distance >= min(self.smallest_support_m, CEILING_M):
                return
            shares = self._shares(k, qpos, qvel, holders)
            if any(shares.get(arm, 0.0) > CAUSING_M_S for arm in self.scene.support):
                self.smallest_support_m = distance
                return

    def _shares(
        self, pair: int, qpos: Array, qvel: Array, holders: Mapping[str, str | None]
    ) -> dict[str, float]:
        """How fast each party's own motion alone closes a pair, m/s."""
        owners = {self.scene.owner_of(g) for g in self._watch.pairs[pair].tolist()}
        parties = {holders.get(owner, owner) for owner in owners if owner is not None}
        return {
            arm: self.closing_m_s(pair, qpos, qvel, arm, holders)
            for arm in self.scene.arms
            if arm in parties
        }

    def closing_m_s(
        self,
        pair: int,
        qpos: Array,
        qvel: Array,
        arm: str,
        holders: Mapping[str, str | None] | None = None,
    ) -> float:
        """How fast the motion of one arm and of what it holds closes a pair of solids, m/s."""
        own = np.zeros(self.scene.model.nv)
        own[self.scene.dofs[arm]] = qvel[self.scene.dofs[arm]]
        for item, holder in (holders or {}).items():
            if holder == arm:
                start = int(self.scene.model.body_dofadr[self.scene.model.body(item).id])
                own[start : start + 6] = qvel[start : start + 6]
        ahead, behind = (
            self._distance_m(pair, qpos, own, dt) for dt in (DIFFERENCE_S, -DIFFERENCE_S)
        )
        return (behind - ahead) / (2.0 * DIFFERENCE_S)

    def _distance_m(self, pair: int, qpos: Array, qvel: Array, dt_s: float) -> float:
        model, data = self.scene.model, self._moved
        moved = np.array(qpos)
        mujoco.mj_integratePos(model, moved, qvel, dt_s)
        data.qpos[:] = moved
        mujoco.mj_kinematics(model, data)
        i, j = self._watch.pairs[pair].tolist()
        return float(mujoco.mj_geomDistance(model, data, i, j, 1.0, None))

    def _names(self, pair: int) -> tuple[str, str]:
        i, j = self._watch.pairs[pair].tolist()
        return self.scene.name(i), self.scene.name(j)

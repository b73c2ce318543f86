"""Whose each geom is, and which pairs of solids may touch: from the scene file and the scenario's settings alone.

A solid is a geom of the housings (group 2), or of a body without any whatever is not a watched capsule
(group 4), or its capsules if it has nothing else. Not judged, since they touch by design: parts of one arm
of which poses say so (own_parts.py); the first moving link and what its base stands on; what the model
excludes or the scenario ignores; an instrument and what it lies on; and, while it is held and until it
has been clear once, an instrument and the hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.judge.own_parts import OwnParts

HOUSING_GROUP, CAPSULE_GROUP = 2, 4
FAR_JOINTS = 3
"""Bodies of one arm so many joints apart can meet anywhere; nearer ones interlock."""
STANDING_M = 0.005
"""A base stands on what it comes this near to in the reference pose."""
HAND_LINKS = 3
"""Moving bodies that make up a hand, from the tool on: the fingers of what grips reach back so far."""


class JudgedScene:
    """A compiled scene with its owners.

    Args:
        model: The scene.
        settings: The resolved scenario, as the trace carries it.
        dofs: Of each arm by name, its places in velocity vectors.
    """

    def __init__(
        self, model: mujoco.MjModel, settings: Mapping[str, Any], dofs: Mapping[str, Sequence[int]]
    ):
        self.model = model
        self.arms = tuple(dofs)
        self.dofs = {arm: np.asarray(found, dtype=np.intp) for arm, found in dofs.items()}
        self.about = {arm["name"]: arm for arm in settings["arm"]}
        self.support = tuple(arm for arm in self.arms if self.about[arm].get("job"))
        """Arms that do jobs; the others are driven by people."""
        self._clear_m = float(settings["control"]["d_min_m"])
        self.instruments = {item["name"]: item for item in settings.get("instrument", [])}
        self._ignore = settings.get("ignore", [])
        self.tool_site = {
            arm: model.site(f"{arm}/{self.about[arm]['tool_site']}").id for arm in self.arms
        }
        self.tool_body = {arm: int(model.site_bodyid[s]) for arm, s in self.tool_site.items()}
        self.owner = [self._owner(body) for body in range(model.nbody)]
        """(nbody,) name of the arm or instrument each body belongs to; None for what stands."""
        self._above = [self._joints_above(body) for body in range(model.nbody)]

    def owner_of(self, geom: int) -> str | None:
        """The arm or instrument a geom belongs to."""
        return self.owner[int(self.model.geom_bodyid[geom])]

    @cached_property
    def hands(self) -> dict[str, frozenset[int]]:
        """The bodies of each arm that touch what it holds."""
        found = {}
        for arm, body in self.tool_body.items():
            solid = {int(self.model.geom_bodyid[g]) for g in self.solids}
            bodies, moved, touches = [], 0, False
            while body and moved < HAND_LINKS:
                bodies.append(body)
                touches |= body in solid
                moved += touches and bool(self.model.body_jntnum[body])
                body = int(self.model.body_parentid[body])
            found[arm] = frozenset(bodies)
        return found

    @cached_property
    def solids(self) -> list[int]:
        """Geoms of the finest geometry there is of each body."""
        model, found = self.model, []
        for body in range(model.nbody):
            own = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
            housings = [g for g in own if model.geom_group[g] == HOUSING_GROUP]
            rest = [g for g in own if model.geom_group[g] != CAPSULE_GROUP]
            found += housings or rest or own
        return found

    @property
    def solid_pairs(self) -> NDArray[np.intp]:
        """(P, 2) geoms that may not touch, neighbours apart."""
        return self._pairs[0]

    @property
    def neighbours(self) -> NDArray[np.intp]:
        """(Q, 2) geoms of one arm, one or two joints apart, that may not enter one another."""
        return self._pairs[1]

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        model, reference = self.model, mujoco.MjData(self.model)
        mujoco.mj_kinematics(model, reference)
        parts = OwnParts(model, self._clear_m)
        of_body: dict[int, list[int]] = {}
        for g in self.solids:
            of_body.setdefault(int(model.geom_bodyid[g]), []).append(g)
        far: list[tuple[int, int]] = []
        near: list[tuple[int, int]] = []
        for a, b in combinations(sorted(of_body), 2):
            if not self._may_meet(a, b):
                continue
            pairs = [(g, h) for g in of_body[a] for h in of_body[b]]
            joints = sorted(self._above[a] ^ self._above[b])
            if self.owner[a] != self.owner[b]:
                far += pairs
            elif len(joints) < FAR_JOINTS:
                near += parts.that_can_collide(joints, pairs)
            elif not parts.always_touch(pairs):
                far += pairs
        by_design = self._standing(reference, of_body) | self._resting() | self._ignored()
        judged, neighbours = (
            np.array([p for p in found if frozenset(p) not in by_design], np.intp).reshape(-1, 2)
            for found in (far, near)
        )
        return judged, neighbours

    def name(self, geom: int) -> str:
        """The geom's name; of an unnamed one its body's, and which of its geoms it is."""
        model = self.model
        body = int(model.geom_bodyid[geom])
        nth = geom - int(model.body_geomadr[body])
        return model.geom(geom).name or f"{model.body(body).name}#{nth}"

    def _owner(self, body: int) -> str | None:
        while body:
            name = self.model.body(body).name
            if name in self.instruments:
                return name
            if name.partition("/")[0] in self.arms and "/" in name:
                return name.partition("/")[0]
            body = int(self.model.body_parentid[body])
        return None

    def _joints_above(self, body: int) -> frozenset[int]:
        found: list[int] = []
        while body:
            start = int(self.model.body_jntadr[body])
            found += range(start, start + int(self.model.body_jntnum[body]))
            body = int(self.model.body_parentid[body])
        return frozenset(found)

    def _may_meet(self, a: int, b: int) -> bool:
        """Whether two bodies can come to touch and should not."""
        joints = len(self._above[a] ^ self._above[b])
        signature = (min(a, b) << 16) + max(a, b)
        if joints == 0 or signature in self.model.exclude_signature:
            return False
        return {self.owner[a], self.owner[b]} != {None}

    def _standing(
        self, reference: mujoco.MjData, of_body: Mapping[int, list[int]]
    ) -> set[frozenset[int]]:
        """First moving links with what their arm's base stands on."""
        model, found = self.model, set()
        of_world = [g for body, own in of_body.items() if self.owner[body] is None for g in own]
        for arm in self.arms:
            base, first = (
                [
                    g
                    for body, own in of_body.items()
                    if self.owner[body] == arm and len(self._above[body]) == joints
                    for g in own
                ]
                for joints in (0, 1)
            )
            for ground in of_world:
                if any(
                    mujoco.mj_geomDistance(model, reference, g, ground, 2 * STANDING_M, None)
                    <= STANDING_M
                    for g in base
                ):
                    found |= {frozenset((g, ground)) for g in first}
        return found

    def _ignored(self) -> set[frozenset[int]]:
        """Solids that the scenario leaves out by name."""
        model = self.model
        named = [{model.geom(g).name, model.body(model.geom_bodyid[g]).name} for g in self.solids]
        found = set()
        for entry in self._ignore:
            if entry.get("final_check"):
                continue
            sides = [
                [g for g, names in zip(self.solids, named, strict=True) if name in names]
                for name in entry["pair"]
            ]
            found |= {frozenset((g, h)) for g in sides[0] for h in sides[1]}
        return found

    def _resting(self) -> set[frozenset[int]]:
        """Instruments with what they lie on."""
        model = self.model
        return {
            frozenset((g, model.geom(support).id))
            for name, item in self.instruments.items()
            for support in item.get("rests_on", ())
            for g in self.solids
            if self.owner_of(g) == name
        }

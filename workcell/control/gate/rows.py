"""One arm's pairs as the gate takes them: which joints move what, resolved once; rows at each configuration.

Of each watched pair that the arm is a party to, one geom is its own: the one on the arm, of two on the arm the
one nearer to its tip. A round geom is spanned by its axis, a box by its corners; any other geom by the
corners of its bounding box, of which only their displacement counts (docs/theory.md section 9).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.gate.data import GateLinks, GateRows
from workcell.control.laws import gate_ends, gate_points
from workcell.control.proximity import Proximity

_GEOM = mujoco.mjtGeom
_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class GateGeometry:
    """What never changes about one arm's pairs, until an instrument changes hands.

    Args:
        model: The model.
        dofs: (n,) the arm's joints, indices into qvel.
        pairs: (W, 2) geom ids of all watched pairs.
        concerned: Numbers of those that the arm is a party to; `pair` has those of them that its joints change.
        held: For each instrument geom that the arm holds, the body that carries it.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        dofs: Sequence[int] | NDArray[np.intp],
        pairs: NDArray[np.intp],
        concerned: Sequence[int] | NDArray[np.intp],
        *,
        held: Mapping[int, int] | None = None,
    ):
        self.dofs = np.ascontiguousarray(dofs, dtype=np.int64)
        """(n,)"""
        self.roots = model.body_rootid[model.dof_bodyid[self.dofs]].astype(np.int64)
        """(n,) root bodies of their trees."""
        held = held or {}
        number, side, geom, order, sign = [], [], [], [], []
        for w in concerned:
            geoms = [int(g) for g in np.asarray(pairs)[w]]
            chains = [self._chain(model, g, held) for g in geoms]
            own = int(len(chains[1]) > len(chains[0]))
            mine = [k for k in chains[own] if k not in chains[1 - own]]
            theirs = [k for k in chains[1 - own] if k not in chains[own]]
            if not mine:
                continue
            number.append(w)
            side.append(-1.0 if own else 1.0)
            geom.append(geoms[own])
            # Seen from the other geom, the chain runs down its branch and out along the own one.
            chain = mine + theirs[::-1]
            order.append(chain + [-1] * (len(self.dofs) - len(chain)))
            sign.append([float(k in mine) - float(k in theirs) for k in range(len(self.dofs))])
        n = len(self.dofs)
        points = [_points(model, g) for g in geom]
        self.pair = np.array(number, dtype=np.intp)
        self.first = np.cumsum([0, *(len(local) for local, _ in points)]).astype(np.intp)
        self.order = np.array(order, dtype=np.intp).reshape(-1, n)
        self.pairs = (
            self.pair,
            np.array(side, dtype=float),
            np.array(geom, dtype=np.intp),
            np.array([exact for _, exact in points], dtype=bool),
            self.first,
            np.concatenate([np.empty((0, 3)), *(local for local, _ in points)]),
            self.order,
            np.array(sign, dtype=float).reshape(-1, n),
        )
        """Arguments `pairs` to `sign` of `laws.gate_points.end_rows`."""
        self.capsules = _capsules(model, np.asarray(pairs), self.pair, geom)
        """Arguments `against`, `half` and `radii` of `laws.gate_ends.jump_rows`."""
        self.outline = _outline(model, sorted(set(geom)), lambda g: self._chain(model, g, held), n)
        """Geom, moving joints, radius and place of the corners of the arm's geoms, as in `laws.gate_points.point_speeds`."""

    @property
    def points(self) -> int:
        """E, the points of all pairs."""
        return int(self.first[-1])

    @property
    def corners(self) -> int:
        """C, the corners of all own geoms."""
        return len(self.outline[0])

    def rows(self, data: mujoco.MjData, proximity: Proximity) -> GateRows:
        """At the configuration of `data`, after `mj_comPos`, with the proximity of all watched pairs."""
        P, E, n = len(self.pair), self.points, len(self.dofs)
        near, own = np.empty(P), np.empty((P, n))
        rows, levers, low = np.empty((E, n)), np.empty((E, n)), np.empty(E)
        gate_points.end_rows(
            data.cdof[self.dofs],
            data.subtree_com[self.roots],
            data.geom_xpos,
            data.geom_xmat,
            proximity.distance_m,
            proximity.normal,
            proximity.witness_i_m,
            proximity.witness_j_m,
            *self.pairs,
            near,
            own,
            rows,
            levers,
            low,
        )
        jump = np.empty((4 * P, n)), np.empty(4 * P), np.empty(4 * P, dtype=np.intp)
        _, _, geom, _, _, _, order, sign = self.pairs
        ends = gate_ends.jump_rows(
            data.cdof[self.dofs],
            data.subtree_com[self.roots],
            data.geom_xpos,
            data.geom_xmat,
            near,
            geom,
            *self.capsules,
            order,
            sign,
            np.inf,
            *jump,
        )
        return GateRows(
            self.pair,
            near,
            own,
            self.first,
            self.order,
            rows,
            levers,
            low,
            jump[0][:ends],
            jump[1][:ends],
            jump[2][:ends],
        )

    def links(self, data: mujoco.MjData) -> GateLinks:
        """The corners of the arm's own geoms at the configuration of `data`, after `mj_comPos`."""
        return GateLinks(
            data.cdof[self.dofs],
            data.subtree_com[self.roots],
            data.geom_xpos,
            data.geom_xmat,
            *self.outline,
        )

    def _chain(self, model: mujoco.MjModel, geom: int, held: Mapping[int, int]) -> list[int]:
        """The arm's joints that move a geom, from its tip on."""
        body = held.get(geom, int(model.geom_bodyid[geom]))
        above: set[int] = set()
        while body:
            start = int(model.body_dofadr[body])
            above.update(range(start, start + int(model.body_dofnum[body])))
            body = int(model.body_parentid[body])
        return [k for k in range(len(self.dofs) - 1, -1, -1) if int(self.dofs[k]) in above]


def no_ends(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]]:
    """`GateRows.jump` and what follows where no capsules are near-parallel, for n joints."""
    return np.empty((0, n)), np.empty(0), np.empty(0, dtype=np.intp)


def _capsules(
    model: mujoco.MjModel, pairs: NDArray[np.intp], numbers: NDArray[np.intp], own: list[int]
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """(P,) other geom, (P, 2) half lengths of both axes, -1 where there is none, and (P,) sum of the radii."""
    both = pairs[numbers].reshape(-1, 2).astype(np.intp)
    against = np.where(both[:, 0] == np.array(own, dtype=np.intp), both[:, 1], both[:, 0])
    geoms = np.stack([np.array(own, dtype=np.intp), against], axis=1)
    capsule = model.geom_type[geoms] == _GEOM.mjGEOM_CAPSULE
    half = np.where(capsule, model.geom_size[geoms, 1], -1.0)
    return against, half, model.geom_size[geoms, 0].sum(axis=1)


def _outline(
    model: mujoco.MjModel, geoms: list[int], chain: Callable[[int], list[int]], n: int
) -> tuple[NDArray[np.intp], NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64]]:
    """Geom (C,), moving joints (C, n), radius (C,) and place (C, 3) of the corners of geoms."""
    corners = [_points(model, g)[0] for g in geoms]
    count = [len(local) for local in corners]
    moves = np.zeros((len(geoms), n), dtype=bool)
    for row, g in zip(moves, geoms, strict=True):
        row[chain(g)] = True
    return (
        np.repeat(np.array(geoms, dtype=np.intp), count),
        np.repeat(moves, count, axis=0),
        np.repeat(np.array([_radius(model, g) for g in geoms], dtype=float), count),
        np.concatenate([np.empty((0, 3)), *corners]),
    )


def _radius(model: mujoco.MjModel, geom: int) -> float:
    """Of the round hull about the core that `_points` spans: 0 where it spans the whole geom."""
    is_round = model.geom_type[geom] in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE)
    return float(model.geom_size[geom, 0]) if is_round else 0.0


def _points(model: mujoco.MjModel, geom: int) -> tuple[NDArray[np.float64], bool]:
    """(E, 3) points in a geom's frame whose hull is the core of the geom; and whether it is no larger."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _GEOM.mjGEOM_SPHERE:
        return np.zeros((1, 3)), True
    if kind == _GEOM.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), True
    if kind == _GEOM.mjGEOM_BOX:
        return _CORNERS * size, True
    box = model.geom_aabb[geom]
    return box[:3] + _CORNERS * box[3:], False

"""Which pieces are held against which, and why the rest is not.

The pieces of a scene come in; out go the body pairs that are watched (as a symmetric table over
pieces), the body pairs left out, each with its reason, and which piece pairs belong to which
exemption or which hand that holds an instrument. Watched is everything between two arms, between
an arm or an instrument and its surroundings, and within an arm what could collide there
(self_pairs.py), unless a rule below says why not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import combinations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.guard.geometry import WORLD, Geometry, Piece
from workcell.guard.self_pairs import FAR_JOINTS, GRAZE_M, SAMPLES, SelfPairs
from workcell.guard.settings import Exemption, Held

# An arm's base stands on whatever its own geometry comes this near to, m. Chosen for a base
# plate modelled a few millimetres above its table, and far below any gap a tool is led through.
STANDING_M = 0.005


@dataclass(frozen=True)
class LeftOut:
    """A pair of bodies that is not watched."""

    body_i: str
    """Name of one body, or of the one geom of it that this is about."""
    body_j: str
    """The other, likewise."""
    reason: str
    """Why."""
    by_name: bool = False
    """Whether the two could move against one another, so that a reader should know them by name."""


@dataclass(frozen=True)
class PairTable:
    """What is watched among n pieces."""

    watched: NDArray[np.bool_]
    """(n, n), symmetric, false on the diagonal."""
    close: NDArray[np.bool_]
    """(n, n), likewise: pieces of one arm, one or two joints apart, that could collide. They are near one
    another all the time, so their distance is told only where it is too small."""
    exempt: NDArray[np.bool_]
    """(number of exemptions, n, n): the watched pairs an exemption lifts while it is open."""
    held: NDArray[np.bool_]
    """(number of instruments, number of arms, n, n): the pairs let off while that arm holds it."""
    left_out: tuple[LeftOut, ...]
    """Every pair of bodies of which no, or not every, piece pair is watched."""

    @property
    def count(self) -> int:
        """Number of piece pairs that are held apart."""
        return int(np.count_nonzero(self.watched | self.close)) // 2


def choose_pairs(
    model: mujoco.MjModel,
    geometry: Geometry,
    arms: tuple[str, ...],
    exemptions: tuple[Exemption, ...] = (),
    instruments: tuple[Held, ...] = (),
    hands: tuple[tuple[str, ...], ...] = (),
    home: tuple[float, ...] = (),
    ignored: tuple[tuple[str, str, str], ...] = (),
    d_min_m: float = 0.01,
) -> PairTable:
    """Decides every pair of bodies once.

    Args:
        model: The compiled scene.
        geometry: Its pieces.
        arms: Names of the arms.
        exemptions: Pairs that may meet in a window.
        instruments: Loose bodies that arms can hold.
        hands: For each arm, the bodies that touch what it holds.
        home: (nq,) positions of all joints at the start; empty for the model's own zero pose,
            brought into the joint ranges.
        ignored: Names of geoms or bodies that are not held apart, and why.
        d_min_m: Distance at which the check halts.

    Raises:
        InputError: If an exemption, instrument or hand names a geom or body that no piece has, or
            an exemption lifts no pair.
    """
    pieces = geometry.pieces
    resting = _resting(pieces, instruments)
    owners = (*arms, *(item.name for item in instruments))
    of_body: dict[int, list[int]] = {}
    for index, piece in enumerate(pieces):
        of_body.setdefault(piece.body, []).append(index)
    within = SelfPairs(model, pieces, home, d_min_m)
    standing = _standing_on(model, within.poses[0], pieces, arms)

    watched = np.zeros((len(pieces), len(pieces)), dtype=bool)
    close = np.zeros_like(watched)
    left_out: list[LeftOut] = []
    for body_i, body_j in combinations(sorted(of_body), 2):
        own_i, own_j = of_body[body_i], of_body[body_j]
        names = pieces[own_i[0]].body_name, pieces[own_j[0]].body_name
        one_arm = pieces[own_i[0]].owner == pieces[own_j[0]].owner
        reason = _reason_to_leave_out(model, pieces[own_i[0]], pieces[own_j[0]], owners)
        if reason:
            left_out.append(LeftOut(*names, reason, "model excludes" in reason))
        elif one_arm and joints_between(model, body_i, body_j) < FAR_JOINTS:
            near = within.near(_way(model, body_i, body_j), own_i, own_j)
            close[np.ix_(own_i, own_j)] = near.watched
            close[np.ix_(own_j, own_i)] = near.watched.T
            left_out += [
                LeftOut(
                    pieces[own_i[a]].name,
                    pieces[own_j[b]].name,
                    f"same arm, grazing by {-1e3 * near.nearest_m[a, b]:.1f} mm, less than {1e3 * GRAZE_M:g} mm, in some poses",
                    by_name=True,
                )
                for a, b in np.argwhere(near.grazing)
            ]
            if near.reason:
                left_out.append(LeftOut(*names, near.reason))
        elif one_arm and within.always_overlap(own_i, own_j):
            # What overlaps at home but not everywhere could collide: it is watched, and stops at the start.
            reason = f"same arm, and overlapping at home and in all of {SAMPLES} poses within the joint ranges, thus by design"
            left_out.append(LeftOut(*names, reason, by_name=True))
        else:
            watched[np.ix_(own_i, own_j)] = watched[np.ix_(own_j, own_i)] = True
    let_off = {(index, support) for index, support in standing if watched[index, support]}
    for index, support in let_off:
        watched[index, support] = watched[support, index] = False
    reason = "the first moving link turns next to what its base stands on"
    for body_name, name in sorted({(pieces[i].body_name, pieces[k].name) for i, k in let_off}):
        left_out.append(LeftOut(body_name, name, reason, by_name=True))
    for one, other, why in ignored:
        sides = [_names(pieces, name) for name in (one, other)]
        both = np.outer(sides[0], sides[1])
        both |= both.T
        if ((watched | close) & both).any():
            watched &= ~both
            close &= ~both
            left_out.append(LeftOut(one, other, f"ignored: {why}", by_name=True))
    for index, support in resting:
        watched[index, support] = watched[support, index] = False
        reason = "the instrument lies on it"
        left_out.append(LeftOut(pieces[index].body_name, pieces[support].name, reason))
    exempt = (
        np.stack([_lifted(pieces, watched, e) for e in exemptions])
        if exemptions
        else (np.zeros((0, *watched.shape), dtype=bool))
    )
    return PairTable(
        watched,
        close,
        exempt,
        _in_hands(pieces, watched, instruments, hands),
        tuple(left_out),
    )


def joints_between(model: mujoco.MjModel, body_i: int, body_j: int) -> int:
    """Number of joints on the way through the tree from one body to the other."""
    return int(sum(model.body_jntnum[body] for body in _way(model, body_i, body_j)))


def _way(model: mujoco.MjModel, body_i: int, body_j: int) -> list[int]:
    """The bodies on the way through the tree from one body to the other, without their common ancestors."""
    return sorted(set(_chain(model, body_i)) ^ set(_chain(model, body_j)))


def _reason_to_leave_out(
    model: mujoco.MjModel, piece_i: Piece, piece_j: Piece, movable: tuple[str, ...]
) -> str | None:
    """Why two bodies, each told by one of its pieces, are not held apart in any pose; None if they may be."""
    if piece_i.owner not in movable and piece_j.owner not in movable:
        return "neither belongs to an arm or is an instrument"
    if joints_between(model, piece_i.body, piece_j.body) == 0:
        return "no joint lies between them, so their distance never changes"
    if _excluded_by_model(model, piece_i.body, piece_j.body):
        return "the model excludes the pair by name (contact/exclude)"
    return None


def _standing_on(
    model: mujoco.MjModel,
    reference: mujoco.MjData,
    pieces: tuple[Piece, ...],
    arms: tuple[str, ...],
) -> set[tuple[int, int]]:
    """Piece pairs (first moving link, world geom that its arm's base stands on)."""
    pairs: set[tuple[int, int]] = set()
    supports = [k for k, piece in enumerate(pieces) if piece.owner == WORLD]
    for arm in arms:
        own = [k for k, piece in enumerate(pieces) if piece.owner == arm]
        base = [k for k in own if joints_between(model, pieces[k].body, 0) == 0]
        first = [k for k in own if joints_between(model, pieces[k].body, 0) == 1]
        for support in supports:
            near = any(
                mujoco.mj_geomDistance(
                    model, reference, pieces[k].geom, pieces[support].geom, 2 * STANDING_M, None
                )
                <= STANDING_M
                for k in base
            )
            if near:
                pairs.update((k, support) for k in first)
    return pairs


def _resting(pieces: tuple[Piece, ...], instruments: tuple[Held, ...]) -> list[tuple[int, int]]:
    """Piece pairs (instrument, what it lies on)."""
    pairs, faults = [], []
    for item in instruments:
        own = [k for k, piece in enumerate(pieces) if piece.owner == item.name]
        if not own:
            faults.append(f"instruments.{item.name}: no body of the scene has this name")
        for name in item.rests_on:
            supports = [k for k, piece in enumerate(pieces) if piece.name == name]
            if not supports:
                faults.append(f"instruments.{item.name}.rests_on: no geom is named '{name}'")
            pairs += [(i, k) for i in own for k in supports]
    if faults:
        raise InputError(faults)
    return pairs


def _in_hands(
    pieces: tuple[Piece, ...],
    watched: NDArray[np.bool_],
    instruments: tuple[Held, ...],
    hands: tuple[tuple[str, ...], ...],
) -> NDArray[np.bool_]:
    """See `PairTable.held`."""
    known = {piece.body_name for piece in pieces}
    # A body of a hand may be without geometry, but not every body of it.
    faults = [
        f"hands: none of {', '.join(bodies) or 'no bodies'} has geometry"
        for bodies in hands
        if not known & set(bodies)
    ]
    if faults:
        raise InputError(faults)
    held = np.zeros((len(instruments), len(hands), *watched.shape), dtype=bool)
    for k, item in enumerate(instruments):
        rod = np.array([piece.owner == item.name for piece in pieces])
        for a, bodies in enumerate(hands):
            hand = np.array([piece.body_name in bodies for piece in pieces])
            held[k, a] = (np.outer(rod, hand) | np.outer(hand, rod)) & watched
    return held


def _lifted(
    pieces: tuple[Piece, ...], watched: NDArray[np.bool_], exemption: Exemption
) -> NDArray[np.bool_]:
    key = f"exemptions.{exemption.name}"
    sides = []
    faults: list[str] = []
    for side in ("geoms_i", "geoms_j"):
        hits = np.zeros(len(pieces), dtype=bool)
        for pattern in getattr(exemption, side):
            found = [_is_named(piece, pattern) for piece in pieces]
            if not any(found):
                known = ", ".join(_shortened(piece.body_name for piece in pieces))
                faults.append(f"{key}.{side}: no geom or body is named '{pattern}'; known: {known}")
            hits |= np.array(found)
        sides.append(hits)
    if faults:
        raise InputError(faults)
    lifted = np.outer(sides[0], sides[1])
    lifted = (lifted | lifted.T) & watched
    if not lifted.any():
        raise InputError(f"{key}: none of its pairs is watched, so there is nothing to exempt")
    return lifted


def _names(pieces: tuple[Piece, ...], name: str) -> NDArray[np.bool_]:
    """(n,) pieces of this name, or of a body of this name."""
    return np.array([name in (piece.name, piece.body_name) for piece in pieces], dtype=bool)


def _is_named(piece: Piece, pattern: str) -> bool:
    return fnmatchcase(piece.name, pattern) or fnmatchcase(piece.body_name, pattern)


def _shortened(names: Iterable[str], most: int = 30) -> list[str]:
    unique = list(dict.fromkeys(names))
    return unique if len(unique) <= most else [*unique[:most], "..."]


def _chain(model: mujoco.MjModel, body: int) -> list[int]:
    chain = [body]
    while body != 0:
        body = int(model.body_parentid[body])
        chain.append(body)
    return chain


def _excluded_by_model(model: mujoco.MjModel, body_i: int, body_j: int) -> bool:
    # MuJoCo keeps the two body ids of an exclusion in one integer, the smaller one high.
    signature = (min(body_i, body_j) << 16) + max(body_i, body_j)
    return bool(np.any(model.exclude_signature == signature))

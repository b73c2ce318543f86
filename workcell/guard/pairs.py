"""Which pieces are held against which, and why the rest is not.

The pieces of a scene come in; out go the body pairs that are watched (as a symmetric table over
pieces), the body pairs left out, each with its reason, and which piece pairs belong to which
exemption or which hand that holds an instrument. Watched is everything between two arms, between
an arm or an instrument and its surroundings, and within an arm from `FAR_JOINTS` joints on, unless
a rule below says why not.
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
from workcell.guard.settings import Exemption, Held

# Neighbouring housings of an arm overlap by design up to two joints apart (their hubs and forks
# enclose one another, and joint limits keep them from meeting); from three on they can meet.
FAR_JOINTS = 3
# Poses within the joint ranges, beside home, in which parts of one arm are looked at.
SAMPLES = 100
# Where a joint has no range, poses are drawn from this to either side, rad or m.
UNLIMITED = np.pi
# An arm's base stands on whatever its own geometry comes this near to, m. Chosen for a base
# plate modelled a few millimetres above its table, and far below any gap a tool is led through.
STANDING_M = 0.005


@dataclass(frozen=True)
class LeftOut:
    """A pair of bodies that is not watched."""

    body_i: str
    """Name of one body."""
    body_j: str
    """Name of the other body, or of the one geom of it that this is about."""
    reason: str
    """Why."""
    by_name: bool = False
    """Whether the two could move against one another, so that a reader should know them by name."""


@dataclass(frozen=True)
class PairTable:
    """What is watched among n pieces."""

    watched: NDArray[np.bool_]
    """(n, n), symmetric, false on the diagonal."""
    exempt: NDArray[np.bool_]
    """(number of exemptions, n, n): the watched pairs an exemption lifts while it is open."""
    held: NDArray[np.bool_]
    """(number of instruments, number of arms, n, n): the pairs let off while that arm holds it."""
    left_out: tuple[LeftOut, ...]
    """Every pair of bodies of which no, or not every, piece pair is watched."""

    @property
    def count(self) -> int:
        """Number of watched piece pairs."""
        return int(np.count_nonzero(self.watched)) // 2


def choose_pairs(
    model: mujoco.MjModel,
    geometry: Geometry,
    arms: tuple[str, ...],
    exemptions: tuple[Exemption, ...] = (),
    instruments: tuple[Held, ...] = (),
    hands: tuple[tuple[str, ...], ...] = (),
    home: tuple[float, ...] = (),
    ignored: tuple[tuple[str, str, str], ...] = (),
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
    poses = _poses(model, home)
    standing = _standing_on(model, poses[0], pieces, arms)

    watched = np.zeros((len(pieces), len(pieces)), dtype=bool)
    left_out: list[LeftOut] = []
    for body_i, body_j in combinations(sorted(of_body), 2):
        first_i, first_j = pieces[of_body[body_i][0]], pieces[of_body[body_j][0]]
        reason = _reason_to_leave_out(model, poses, pieces, owners, of_body, body_i, body_j)
        if reason:
            left_out.append(
                LeftOut(
                    first_i.body_name,
                    first_j.body_name,
                    reason,
                    "design" in reason or "model excludes" in reason,
                )
            )
            continue
        for i in of_body[body_i]:
            for j in of_body[body_j]:
                watched[i, j] = watched[j, i] = True
    let_off = {(index, support) for index, support in standing if watched[index, support]}
    for index, support in let_off:
        watched[index, support] = watched[support, index] = False
    reason = "the first moving link turns next to what its base stands on"
    for body_name, name in sorted({(pieces[i].body_name, pieces[k].name) for i, k in let_off}):
        left_out.append(LeftOut(body_name, name, reason, by_name=True))
    for one, other, why in ignored:
        sides = [_names(pieces, name) for name in (one, other)]
        both = np.outer(sides[0], sides[1])
        if (watched & (both | both.T)).any():
            watched &= ~(both | both.T)
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
        watched, exempt, _in_hands(pieces, watched, instruments, hands), tuple(left_out)
    )


def joints_between(model: mujoco.MjModel, body_i: int, body_j: int) -> int:
    """Number of joints on the way through the tree from one body to the other."""
    ancestors_i, ancestors_j = _chain(model, body_i), _chain(model, body_j)
    apart = set(ancestors_i) ^ set(ancestors_j)
    return int(sum(model.body_jntnum[body] for body in apart))


def _reason_to_leave_out(
    model: mujoco.MjModel,
    poses: list[mujoco.MjData],
    pieces: tuple[Piece, ...],
    movable: tuple[str, ...],
    of_body: dict[int, list[int]],
    body_i: int,
    body_j: int,
) -> str | None:
    owner_i, owner_j = pieces[of_body[body_i][0]].owner, pieces[of_body[body_j][0]].owner
    if owner_i not in movable and owner_j not in movable:
        return "neither belongs to an arm or is an instrument"
    if joints_between(model, body_i, body_j) == 0:
        return "no joint lies between them, so their distance never changes"
    if _excluded_by_model(model, body_i, body_j):
        return "the model excludes the pair by name (contact/exclude)"
    if owner_i != owner_j:
        return None
    joints = joints_between(model, body_i, body_j)
    if joints < FAR_JOINTS:
        return f"same arm, only {joints} joint{'s' * (joints > 1)} apart"
    # What overlaps at home but not everywhere could collide: it is watched, and stops at the start.
    if all(_overlap(model, pose, pieces, of_body[body_i], of_body[body_j]) for pose in poses):
        return f"same arm, and overlapping at home and in all of {SAMPLES} poses within the joint ranges, thus by design"
    return None


def _poses(model: mujoco.MjModel, home: tuple[float, ...]) -> list[mujoco.MjData]:
    """Home, then seeded random poses within the ranges of hinges and slides; other joints stay at home."""
    start = np.array(home) if home else model.qpos0.copy()
    single = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    addresses = model.jnt_qposadr[single]
    limited = model.jnt_limited[single].astype(bool)
    lower = np.where(limited, model.jnt_range[single, 0], -UNLIMITED)
    upper = np.where(limited, model.jnt_range[single, 1], UNLIMITED)
    if not home:
        start[addresses] = np.clip(start[addresses], lower, upper)
    rng = np.random.default_rng(0)
    poses = []
    for k in range(1 + SAMPLES):
        data = mujoco.MjData(model)
        data.qpos[:] = start
        if k:
            data.qpos[addresses] = rng.uniform(lower, upper)
        mujoco.mj_kinematics(model, data)
        poses.append(data)
    return poses


def _overlap(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    pieces: tuple[Piece, ...],
    first: list[int],
    second: list[int],
) -> bool:
    """Whether any piece of one body is inside a piece of the other."""
    return any(
        mujoco.mj_geomDistance(model, data, pieces[i].geom, pieces[j].geom, 1.0, None) <= 0.0
        for i in first
        for j in second
    )


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

"""An arm file -> an adapted arm file: the spine of the importer, in the order of its steps.

The file is compiled by MuJoCo first, so that degrees, defaults, includes, mesh folders, tendons and
sensors need no care of their own. Then: which chain (choose), which links (links), what housing
(hulls), which capsules (capsules), how strong and how fast (servos, limits), where it starts (home).
The result is written (write) and held against the original.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.adapt import choose, home, write
from workcell.scene.adapt.capsules import Capsule, fit
from workcell.scene.adapt.hulls import Piece, hull_corners, piece_of
from workcell.scene.adapt.links import Link, composite, links_of
from workcell.scene.adapt.source import read
from workcell.scene.adapt.stated import limits, torque
from workcell.scene.arm_file import ArmFile

CHECKED_POSES = 50
SAME = 1e-9
"""Largest difference between the adapted arm and its original: m, rad, kg, kg m²."""
MUCH_LARGER = 1.5
"""A hull of so many times the volume of its mesh is worth a word: a decomposition would hug it closer."""


@dataclass(frozen=True)
class Wishes:
    """What the user says of the arm; everything may be left open."""

    name: str | None = None
    tool: str | None = None
    """A site or body."""
    tool_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the site or body to the tool point, in its frame."""
    root: str | None = None
    """A body: what is not below it is left out."""
    locked: dict[str, float] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    """Bodies that are left out with all below them."""
    only: str | None = None
    """The one body that is kept with all below it; the arm's base is then the file's, without geometry."""


@dataclass(frozen=True)
class Adapted:
    """An adapted arm."""

    name: str
    xml: str
    home_rad: tuple[float, ...]
    did: tuple[str, ...]
    """What was done, a sentence each."""
    guessed: tuple[str, ...]
    unknown: tuple[str, ...]
    """What the file does not say and nothing could tell."""
    reach_m: float
    """Farthest the tool was from the base in the sampled poses."""
    on_floor: tuple[str, ...] = ()
    """Bodies that move level over the floor, as those of a mobile base, and cannot be held apart from it."""
    floor_m: float = 0.0
    """Height of the floor in the base's frame: 0, or below it where the base reaches lower."""


def adapt(path: Path, wishes: Wishes) -> Adapted:
    """Adapt an arm file.

    Raises:
        InputError: the file does not compile, or a wish names something it does not have.
    """
    file = read(path)
    chain = choose.chain(
        file, wishes.tool, wishes.root, wishes.locked, without=wishes.without, only=wishes.only
    )
    name = wishes.name or choose.name_of(path)
    configuration, said_of_locked = choose.start(file, chain, wishes.locked)
    zero = _pose(file.model, _at_zero(file, configuration, chain.driven))
    links = links_of(file.model, zero, chain.driven, chain.bodies, chain.root)
    housing, coarse = _housing(file, zero, links)
    capsules = {
        link.first: fit([p.corners for p in housing[link.first]])
        for link in links
        if housing[link.first]
    }
    known = limits(file, name, chain.driven)
    parts = write.Parts(
        name=name,
        source=path.name,
        file=file,
        links=links,
        housing=housing,
        capsules=capsules,
        tool_link=chain.tool_link(file.model),
        tool=chain.tool_pose(file, zero, wishes.tool_offset_m),
        velocity=known.velocity,
        acceleration=known.acceleration,
        torque=torque(file, chain.driven),
    )
    bare = mujoco.MjModel.from_xml_string(write.xml(parts))
    gains = _gains(bare)
    excluded = home.touching_by_construction(bare)
    model = mujoco.MjModel.from_xml_string(write.xml(parts, gains, excluded.pairs))
    chosen = home.choose(model, excluded.pairs, _keyframe(file, chain.driven))
    _hold_against(file, model, chain, configuration, links, zero, wishes.tool_offset_m)
    home_rad = tuple(round(float(q), 4) for q in chosen.q)
    return Adapted(
        name=name,
        xml=write.xml(parts, gains, excluded.pairs, home_rad),
        home_rad=home_rad,
        did=(
            f"{len(chain.driven)} joints from {chain.root_name(file)} to {chain.tool_name}: {', '.join(file.joints[j] for j in chain.driven)}",
            *said_of_locked,
            *_volumes(file, links, housing, capsules),
            *coarse,
            *excluded.said,
            f"servos: kp = I (2 pi 15 Hz)², critically damped, I the largest inertia of {home.SAMPLES} poses at the joint",
            "gravity is carried by the drives (gravcomp), as real arms do",
            f"held against the original: tool in {CHECKED_POSES} poses, masses and inertias equal to {SAME:g}",
        ),
        guessed=(*chain.guessed, *known.guessed, *chosen.guessed),
        unknown=(*_unknown(file, chain.driven), *known.unknown),
        reach_m=chosen.reach_m,
        floor_m=chosen.floor_m,
        on_floor=chosen.on_floor,
    )


def _pose(model: mujoco.MjModel, qpos: NDArray[np.float64]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def _at_zero(
    file: ArmFile, configuration: NDArray[np.float64], driven: tuple[int, ...]
) -> NDArray[np.float64]:
    """The configuration with its driven joints at the file's zero, where body frames are as written."""
    qpos = configuration.copy()
    addresses = file.model.jnt_qposadr[list(driven)]
    qpos[addresses] = file.model.qpos0[addresses]
    return qpos


def _housing(
    file: ArmFile, zero: mujoco.MjData, links: tuple[Link, ...]
) -> tuple[dict[int, list[Piece]], list[str]]:
    """Convex pieces of every link in its own frame: of its colliding geoms, else of what is drawn."""
    model, said = file.model, []
    found: dict[int, list[Piece]] = {}
    for link in links:
        geoms = [
            g
            for body in link.bodies
            for g in range(
                model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]
            )
            if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_PLANE
        ]
        colliding = [g for g in geoms if model.geom_contype[g] or model.geom_conaffinity[g]]
        pieces = []
        for g in colliding or geoms:
            piece = piece_of(model, g)
            body = int(model.geom_bodyid[g])
            turn = link.rotation.T @ zero.xmat[body].reshape(3, 3)
            pieces.append(piece.moved(link.rotation.T @ (zero.xpos[body] - link.position_m), turn))
            if piece.surface_volume_m3 and piece.volume_m3 > MUCH_LARGER * piece.surface_volume_m3:
                said.append(
                    f"hull of {file.geoms[g]} is {piece.volume_m3 / piece.surface_volume_m3:.1f} times as large as its mesh"
                )
        found[link.first] = pieces
    return found, said


def _volumes(
    file: ArmFile,
    links: tuple[Link, ...],
    housing: dict[int, list[Piece]],
    capsules: dict[int, list[Capsule]],
) -> Iterator[str]:
    """Link by link how much larger its capsules are than its hull."""
    for link in links:
        if link.first not in capsules:
            continue
        corners = np.concatenate([piece.corners for piece in housing[link.first]])
        hull = write.volume(hull_corners(corners))
        own = capsules[link.first]
        name = file.bodies[link.first] if link.first else "base"
        yield (
            f"{name}: {len(housing[link.first])} convex pieces, {len(own)} capsule{'s' * (len(own) > 1)} of "
            f"{sum(c.volume_m3 for c in own) / hull:.2f} times the volume of its hull"
        )


def _unknown(file: ArmFile, driven: tuple[int, ...]) -> Iterator[str]:
    limited = torque(file, driven)
    without = [file.joints[j] for j in driven if j not in limited]
    if without:
        yield f"torque limits of {', '.join(without)}: none stated, none set"
    unlimited = [file.joints[j] for j in driven if not file.model.jnt_limited[j]]
    if unlimited:
        yield f"ranges of {', '.join(unlimited)}: none stated, they turn without end"
    yield "where the tool points: the z axis of its frame should point out of the hand; --tool and --tool-offset say otherwise"


def _gains(model: mujoco.MjModel) -> list[tuple[float, float]]:
    """kp and kv of each joint by the one rule (mjcf/pa10/README.md, step 6)."""
    omega = 2 * np.pi * 15
    largest = np.zeros(model.nv)
    data = mujoco.MjData(model)
    for pose in home.poses(model):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        largest = np.maximum(largest, full.diagonal())
    damping = model.dof_damping
    kp = np.maximum(largest * omega**2, damping / 0.5e-3)
    kv = np.maximum(2 * np.sqrt(kp * largest) - damping, 0.1 * np.sqrt(kp * largest))
    return [(float(f"{p:.4g}"), float(f"{v:.4g}")) for p, v in zip(kp, kv, strict=True)]


def _keyframe(file: ArmFile, driven: tuple[int, ...]) -> tuple[str, NDArray[np.float64]] | None:
    """The keyframe called home, else the first one."""
    model = file.model
    names = [model.key(k).name for k in range(model.nkey)]
    if not names:
        return None
    index = names.index("home") if "home" in names else 0
    return names[index], model.key_qpos[index][model.jnt_qposadr[list(driven)]]


def _hold_against(
    file: ArmFile,
    model: mujoco.MjModel,
    chain: choose.Chain,
    configuration: NDArray[np.float64],
    links: tuple[Link, ...],
    zero: mujoco.MjData,
    offset_m: tuple[float, float, float],
) -> None:
    """The adapted arm against the original: tool poses, masses, inertias.

    Raises:
        RuntimeError: they differ, which is a fault of the importer.
    """
    rng = np.random.default_rng(0)
    base = links[0]
    new = mujoco.MjData(model)
    addresses = file.model.jnt_qposadr[list(chain.driven)]
    lower = np.where(model.jnt_limited, model.jnt_range[:, 0], -np.pi)
    upper = np.where(model.jnt_limited, model.jnt_range[:, 1], np.pi)
    for _ in range(CHECKED_POSES):
        q = rng.uniform(lower, upper)
        qpos = configuration.copy()
        qpos[addresses] = q
        old = _pose(file.model, qpos)
        new.qpos[:] = q
        mujoco.mj_kinematics(model, new)
        position, rotation = chain.tool_pose_in_world(file, old, offset_m)
        site = new.site(write.TOOL)
        _same("tool position", base.rotation.T @ (position - base.position_m), site.xpos)
        _same("tool orientation", base.rotation.T @ rotation, site.xmat.reshape(3, 3))
    mujoco.mj_comPos(model, new)
    for link in links:
        if link.mass_kg == 0.0:
            continue
        body = model.body(write.body_name(file, link)).id
        new.qpos[:] = model.qpos0
        mujoco.mj_kinematics(model, new)
        mujoco.mj_comPos(model, new)
        mass, centre, inertia = composite(model, new, [body])
        turn, at = new.xmat[body].reshape(3, 3), new.xpos[body]
        whole = composite(file.model, zero, list(link.bodies))
        _same("mass", mass, whole[0])
        _same(
            "centre of mass", turn.T @ (centre - at), link.rotation.T @ (whole[1] - link.position_m)
        )
        _same("inertia", turn.T @ inertia @ turn, link.rotation.T @ whole[2] @ link.rotation)


def _same(what: str, found: object, wanted: object) -> None:
    worst = float(np.max(np.abs(np.asarray(found) - np.asarray(wanted))))
    if not worst <= SAME:
        raise RuntimeError(f"the adapted arm differs from its original: {what} by {worst:.3g}")

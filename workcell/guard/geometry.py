"""Which geometry stands for what in the final check.

A compiled scene comes in, a list of convex pieces goes out, each with the body that carries it
and the arm (or the surroundings) that owns it. Finest geometry first: group 2 (housings), else
whatever else a body has besides the watched capsules of group 4. The capsules themselves never
count for an arm: the check exists because it does not trust them. A mesh counts as its convex
hull, which contains it, so a hollow or open mesh can only be reported nearer than it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco

from workcell.errors import InputError
from workcell.files import require_files

HOUSING_GROUP = 2
CAPSULE_GROUP = 4
WORLD = "world"

_GEOM = mujoco.mjtGeom
# What `mj_geomDistance` measures exactly: planes, and everything convex.
_MEASURABLE = {
    int(kind)
    for kind in (
        _GEOM.mjGEOM_PLANE,
        _GEOM.mjGEOM_SPHERE,
        _GEOM.mjGEOM_CAPSULE,
        _GEOM.mjGEOM_ELLIPSOID,
        _GEOM.mjGEOM_CYLINDER,
        _GEOM.mjGEOM_BOX,
        _GEOM.mjGEOM_MESH,
    )
}


@dataclass(frozen=True)
class Piece:
    """One convex solid of the high-resolution model."""

    geom: int
    """Geom id in the scene."""
    body: int
    """Body id in the scene."""
    name: str
    """The geom's name; `<body>#<k>` for the k-th unnamed geom of a body."""
    body_name: str
    """The body's name."""
    owner: str
    """An arm's name, `world` for what stands still, else the root body of a loose object."""


@dataclass(frozen=True)
class Geometry:
    """All pieces of a scene and what is missing."""

    pieces: tuple[Piece, ...]
    """In order of geom id."""
    missing: tuple[str, ...]
    """Bodies of arms that have watched capsules but no geometry of their own, and arms that have
    no geometry at all."""


def load_scene(scene_xml: Path) -> mujoco.MjModel:
    """Compiles a scene file.

    Raises:
        InputError: If the file is missing or does not compile; names file and MuJoCo's complaint.
    """
    if not scene_xml.is_file():
        raise InputError("there is no such scene file", file=scene_xml)
    try:
        require_files(scene_xml.parent)
        return mujoco.MjModel.from_xml_path(str(scene_xml))
    except (OSError, ValueError) as error:
        raise InputError(f"the scene does not compile: {error}", file=scene_xml) from error


def collect_geometry(model: mujoco.MjModel, arms: tuple[str, ...]) -> Geometry:
    """Chooses the pieces of every body.

    Raises:
        InputError: If an arm has no body in the scene, or a geom is of a
            type whose distance cannot be measured. Names each.
    """
    owners = [body_owner(model, body, arms) for body in range(model.nbody)]
    faults = [f"arm '{arm}': no body is named '{arm}/...'" for arm in arms if arm not in owners]
    pieces: list[Piece] = []
    missing: list[str] = []
    for body in range(model.nbody):
        of_arm = owners[body] in arms
        chosen = _chosen_geoms(model, body, of_arm)
        if of_arm and not chosen and model.body_geomnum[body] > 0:
            missing.append(_body_name(model, body))
        for geom in chosen:
            name = _geom_name(model, geom)
            fault = _geom_fault(model, geom, name)
            if fault:
                faults.append(fault)
            pieces.append(Piece(geom, body, name, _body_name(model, body), owners[body]))
    if faults:
        raise InputError(faults)
    covered = {piece.owner for piece in pieces}
    missing += [arm for arm in arms if arm not in covered]
    return Geometry(tuple(sorted(pieces, key=lambda piece: piece.geom)), tuple(missing))


def body_owner(model: mujoco.MjModel, body: int, arms: tuple[str, ...]) -> str:
    """Who a body belongs to: an arm by the prefix of its name, the world, or its root body."""
    prefix, slash, _ = _body_name(model, body).partition("/")
    if slash and prefix in arms:
        return prefix
    if model.body_weldid[body] == 0 and model.body_mocapid[body] < 0:
        return WORLD
    return _body_name(model, int(model.body_rootid[body]))


def _chosen_geoms(model: mujoco.MjModel, body: int, of_arm: bool) -> list[int]:
    first = int(model.body_geomadr[body])
    geoms = list(range(first, first + int(model.body_geomnum[body])))
    if body == 0:
        # Geoms of the world body are unrelated things: none of them stands in for another.
        return geoms
    housing = [geom for geom in geoms if model.geom_group[geom] == HOUSING_GROUP]
    others = [geom for geom in geoms if model.geom_group[geom] != CAPSULE_GROUP]
    # An obstacle that is nothing but a watched primitive is that primitive.
    return housing or others or ([] if of_arm else geoms)


def _geom_fault(model: mujoco.MjModel, geom: int, name: str) -> str | None:
    kind = int(model.geom_type[geom])
    if kind not in _MEASURABLE:
        allowed = "plane, sphere, capsule, ellipsoid, cylinder, box, mesh"
        return f"geom '{name}': distances to type {_GEOM(kind).name} are unknown; use {allowed}"
    return None


def _body_name(model: mujoco.MjModel, body: int) -> str:
    return model.body(body).name or f"body#{body}"


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    body = int(model.geom_bodyid[geom])
    ordinal = geom - int(model.body_geomadr[body])
    return model.geom(geom).name or f"{_body_name(model, body)}#{ordinal}"

"""An arm file by itself: compiled alone with MuJoCo, so that it means what the file says.

Degrees (the default of MJCF), Euler sequences, defaults, includes, automatic limits and total mass are
settings of one file. Two files beside one another would share them. So each is compiled alone, and
what is attached to a cell is what came out (normal_form.py). Refused here, by name: what a cell
cannot carry, whoever asks for the arm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from workcell.errors import InputError
from workcell.scene.content import digest as content_digest
from workcell.scene.not_carried import namer, not_carried

KEPT = 8
"""Arm files, and skeletons, that are kept; chosen larger than the number any one study has."""

VELOCITY_LIMIT_NUMERIC = "joint_velocity_limit_rad_s"
ACCELERATION_LIMIT_NUMERIC = "joint_acceleration_limit_rad_s2"
"""`<numeric>` of an arm file with one limit a joint; MJCF has no attribute for them."""

_OF_THE_CELL = (
    "timestep",
    "gravity",
    "integrator",
    "cone",
    "jacobian",
    "solver",
    "iterations",
    "ls_iterations",
    "noslip_iterations",
    "ccd_iterations",
    "tolerance",
    "impratio",
    "wind",
    "magnetic",
    "density",
    "viscosity",
    "disableflags",
    "enableflags",
    "disableactuator",
)
"""Options of MuJoCo that a cell has once: an arm file's own are not used."""
_NAMES_OF_OPTIONS = {
    "integrator": mujoco.mjtIntegrator,
    "cone": mujoco.mjtCone,
    "jacobian": mujoco.mjtJacobian,
    "solver": mujoco.mjtSolver,
}
_JOINT_KINDS = {
    int(mujoco.mjtJoint.mjJNT_FREE): "free",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
}
HINGE, SLIDE, FREE = "hinge", "slide", "free"


@dataclass(frozen=True, eq=False)
class ArmFile:
    """What an arm file means, compiled alone; never to be changed."""

    path: Path
    digest: str
    """Of its content and of all that it names."""
    model: mujoco.MjModel
    """The file compiled by itself."""
    bodies: tuple[str, ...]
    """Name of each body of the model; the first is the world of the file."""
    joints: tuple[str, ...]
    """Name of each joint, of the body and a number where the file has none."""
    kinds: tuple[str, ...]
    """`hinge` or `slide`, or what a cell cannot carry: `ball`, `free`."""
    geoms: tuple[str, ...]
    sites: tuple[str, ...]
    actuators: tuple[str, ...]
    meshes: tuple[str, ...]
    materials: tuple[str, ...]
    neutralised: tuple[str, ...]
    """What belongs to the whole cell and is therefore not taken from this file, a sentence each."""


def read(path: Path) -> ArmFile:
    """Compile an arm file by itself.

    Raises:
        InputError: the file does not compile, or has a part that no cell can carry. The message
            does not name the scenario's key; the caller does.
    """
    return _read(path, content_digest(path))


@lru_cache(maxsize=KEPT)
def _read(path: Path, digest: str) -> ArmFile:
    """`digest` is that of the content, by which the result is kept."""
    # MuJoCo knows a mesh file again by its date; what is compiled here must be what is there now.
    mujoco.mj_clearCache(mujoco.mj_getCache())
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        raise InputError(
            f"is not a readable MJCF file: {str(error).strip()}; mend it until `python -m mujoco.viewer --mjcf={path}` shows it"
        ) from error
    faults = list(not_carried(model))
    if faults:
        raise InputError(faults)
    bodies = _names(model, mujoco.mjtObj.mjOBJ_BODY, model.nbody, lambda k: f"body{k}")
    of_body = ["base", *bodies[1:]]
    return ArmFile(
        path=path,
        digest=digest,
        model=model,
        bodies=bodies,
        joints=_names(
            model,
            mujoco.mjtObj.mjOBJ_JOINT,
            model.njnt,
            lambda k: f"{of_body[model.jnt_bodyid[k]]}_joint",
        ),
        kinds=tuple(_JOINT_KINDS[int(kind)] for kind in model.jnt_type),
        geoms=_names(
            model,
            mujoco.mjtObj.mjOBJ_GEOM,
            model.ngeom,
            lambda k: f"{of_body[model.geom_bodyid[k]]}_geom",
        ),
        sites=_names(
            model,
            mujoco.mjtObj.mjOBJ_SITE,
            model.nsite,
            lambda k: f"{of_body[model.site_bodyid[k]]}_site",
        ),
        actuators=_names(
            model, mujoco.mjtObj.mjOBJ_ACTUATOR, model.nactuator, lambda k: "actuator"
        ),
        meshes=_names(model, mujoco.mjtObj.mjOBJ_MESH, model.nmesh, lambda k: "mesh"),
        materials=_names(model, mujoco.mjtObj.mjOBJ_MATERIAL, model.nmat, lambda k: "material"),
        neutralised=tuple(_neutralised(model)),
    )


def plain(name: str) -> str:
    """A name as it is used in a cell, where a slash parts an arm's name from its part's."""
    return name.replace("/", ".")


def _names(
    model: mujoco.MjModel, kind: mujoco.mjtObj, count: int, base: Callable[[int], str]
) -> tuple[str, ...]:
    """The names of one kind without slashes; what has none gets `<base>`, numbered where that is taken."""
    given = [plain(mujoco.mj_id2name(model, kind, k) or "") for k in range(count)]
    taken: set[str] = set()
    # Given names come first: a made-up one must not take the place of one that is there.
    for k in sorted(range(count), key=lambda k: not given[k]):
        stem = given[k] or base(k)
        name, number = stem, 0
        while name in taken:
            name, number = f"{stem}{number}", number + 1
        taken.add(name)
        given[k] = name
    return tuple(given)


def _neutralised(model: mujoco.MjModel) -> Iterator[str]:
    """What the file sets for a whole model, and what stands in it that a cell has itself."""
    usual = mujoco.MjOption()
    said = []
    for key in _OF_THE_CELL:
        own, default = getattr(model.opt, key), getattr(usual, key)
        if not np.array_equal(own, default):
            said.append(f"{key} = {_as_text(key, own)}")
    if said:
        yield f"option {', '.join(said)}: not used, the cell has its own"
    name = namer(model)
    planes = [
        name("GEOM", geom)
        for geom in range(model.ngeom)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    ]
    if planes:
        yield f"plane {', '.join(planes)}: left out, the cell has its own floor"
    for count, what in (
        (model.nsensor, "sensors"),
        (model.ncam, "cameras"),
        (model.nlight, "lights"),
        (model.nskin, "skins"),
        (model.ntex, "textures"),
        (model.npair, "contact pairs"),
    ):
        if count:
            yield f"{count} {what}: left out, nothing in a cell uses them"


def _as_text(key: str, value: object) -> str:
    if key in _NAMES_OF_OPTIONS:
        return _NAMES_OF_OPTIONS[key](int(value)).name.split("_", 1)[1]  # type: ignore[arg-type]
    return np.array2string(np.asarray(value), separator=" ", precision=6)

"""What of an arm file no cell can carry: each part by name, with what to do.

In: an arm file compiled alone. MuJoCo takes names and numbers that nothing behind it can use: control
characters, NaN, infinite sizes. They are refused here, before a part of them reaches a scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np

_NAMED = {
    "BODY": "nbody",
    "JOINT": "njnt",
    "GEOM": "ngeom",
    "SITE": "nsite",
    "ACTUATOR": "nactuator",
    "MESH": "nmesh",
    "MATERIAL": "nmat",
    "NUMERIC": "nnumeric",
    "KEY": "nkey",
}
"""Kinds of objects whose names go into a cell or a message, and where a model counts them."""
_NUMBERED = {"body": "BODY", "jnt": "JOINT", "dof": "JOINT", "geom": "GEOM", "site": "SITE"} | {
    "actuator": "ACTUATOR",
    "key": "KEY",
    "mat": "MATERIAL",
}
"""Prefixes of a model's arrays, and the kind of object that each of their rows belongs to."""


def not_carried(model: mujoco.MjModel) -> Iterator[str]:
    """Faults of an arm file, a sentence each; where names cannot be read, those alone."""
    faults = list(_unreadable_names(model))
    yield from faults
    if not faults:
        yield from _not_finite(model)
        yield from _parts(model)


def _unreadable_names(model: mujoco.MjModel) -> Iterator[str]:
    for kind, count in _NAMED.items():
        for number in range(getattr(model, count)):
            try:
                name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), number)
            except UnicodeDecodeError as error:
                yield f"name of {kind.lower()} number {number} = {error.object!r}: is not UTF-8 text; write it in UTF-8"
                continue
            if name and not name.isprintable():
                yield f"name of {kind.lower()} number {number} = {name!r}: has a character that cannot be printed; rename it"


def _not_finite(model: mujoco.MjModel) -> Iterator[str]:
    """Numbers that are not finite, the first of each array."""
    name = namer(model)
    for field in sorted(dir(model)):
        kind = _NUMBERED.get(field.split("_")[0])
        values = getattr(model, field) if kind else None
        if not isinstance(values, np.ndarray) or values.dtype.kind != "f" or not values.size:
            continue
        bad = ~np.isfinite(values.reshape(len(values), -1)).all(axis=1)
        if bad.any():
            row = int(np.argmax(bad))
            number = int(model.dof_jntid[row]) if field.startswith("dof") else row
            yield (
                f"{str(kind).lower()} {name(str(kind), number)!r}: {field} = {np.array2string(values[row], precision=6)}: "
                "is not finite; give numbers, and leave out a range or limit where there is none"
            )


def _parts(model: mujoco.MjModel) -> Iterator[str]:
    name = namer(model)
    for body in range(model.nbody):
        if model.body_mocapid[body] >= 0:
            yield (
                f"body {name('BODY', body)!r} is a mocap body, which a controller outside this cell would move; "
                "remove it (an operator's target is not part of the arm)"
            )
        if model.body_plugin[body] >= 0:
            yield f"body {name('BODY', body)!r} is moved by a plugin, which a cell does not carry; remove it"
    for geom in range(model.ngeom):
        kind = mujoco.mjtGeom(int(model.geom_type[geom]))
        if kind in (mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF):
            yield (
                f"geom {name('GEOM', geom)!r} is of type {kind.name.removeprefix('mjGEOM_').lower()}, to which no distance can be measured; "
                "make it a mesh or a primitive"
            )
    for flex in range(model.nflex):
        yield f"flex {name('FLEX', flex)!r} is deformable, which a cell does not carry; remove it"
    for joint in range(model.njnt):
        dof = int(model.jnt_dofadr[joint])
        if np.any(model.jnt_stiffnesspoly[joint]) or np.any(model.dof_dampingpoly[dof]):
            yield (
                f"joint {name('JOINT', joint)!r} has polynomial stiffness or damping, which a cell does not carry; "
                "give one number"
            )
    for actuator in range(model.nactuator):
        if model.actuator_damping[actuator] or model.actuator_armature[actuator]:
            yield (
                f"actuator {name('ACTUATOR', actuator)!r} adds damping or armature of its own, which a cell does not carry; "
                "give them to the joint"
            )


def namer(model: mujoco.MjModel) -> Callable[[str, int], str]:
    """A function that gives an object's name by kind and number, or its number where it has none."""

    def name(kind: str, number: int) -> str:
        found = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), number)
        return found or f"number {number}"

    return name

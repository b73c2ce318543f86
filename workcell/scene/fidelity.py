"""Is an arm in a composed cell still what its file says?

The file compiled alone and the cell are two models of one arm. At home they must agree: frames of
bodies and sites, joint axes, anchors and ranges, masses and inertias, and every piece of geometry.
A difference is a fault of this product, not of the user's file, and stops.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.arm_file import ArmFile
from workcell.scene.normal_form import SIZES, NormalForm

TOLERANCE = 1e-9
"""m, rad (as a difference of rotation matrices), kg and kg m²: far above rounding, far below what anyone could measure."""
MESH_TOLERANCE_M = 1e-6
"""Of the vertices of meshes, which MuJoCo keeps in single precision."""


class ArmDiffers(RuntimeError):
    """An arm of a composed cell is not what its file says: a fault of the program."""


def compare(
    model: mujoco.MjModel, name: str, file: ArmFile, form: NormalForm, home: NDArray[np.float64]
) -> None:
    """Hold one arm of a cell against its file.

    Args:
        model: The composed cell.
        name: The arm's name in the cell.
        file: Its file, compiled alone.
        form: What was attached.
        home: (nq,) home configuration of the file's model.

    Raises:
        ArmDiffers: naming every part that differs.
    """
    alone = mujoco.MjData(file.model)
    alone.qpos[:] = home
    mujoco.mj_kinematics(file.model, alone)
    model = copy.copy(model)
    frame = model.body(f"{name}/").id
    # At the origin, where no last digit depends on where the arm stands.
    model.body_pos[frame], model.body_quat[frame] = 0.0, (1.0, 0.0, 0.0, 0.0)
    data = mujoco.MjData(model)
    for number in form.driven:
        address = model.joint(f"{name}/{file.joints[number]}").qposadr[0]
        data.qpos[address] = home[file.model.jnt_qposadr[number]]
    mujoco.mj_kinematics(model, data)
    differences = [
        *_bodies(model, data, name, file, form, alone),
        *_joints(model, data, name, file, form, alone),
        *_sites(model, data, name, file, alone),
        *_geoms(model, data, name, file, alone),
    ]
    if differences:
        shown = "; ".join(differences[:10])
        raise ArmDiffers(f"arm {name} in the cell is not what {file.path} says: {shown}")


def _differs(what: str, found, wanted, tolerance: float = TOLERANCE) -> Iterator[str]:
    worst = float(np.max(np.abs(np.asarray(found, float) - np.asarray(wanted, float)), initial=0.0))
    if not worst <= tolerance:
        yield f"{what} differs by {worst:.3g}"


def _bodies(model, data, name, file: ArmFile, form: NormalForm, alone) -> Iterator[str]:
    for number, body_name in form.bodies.items():
        body = model.body(f"{name}/{body_name}").id
        yield from _differs(f"position of body {body_name}", data.xpos[body], alone.xpos[number])
        yield from _differs(f"orientation of body {body_name}", data.xmat[body], alone.xmat[number])
        mass = file.model.body_mass[number]
        yield from _differs(f"mass of body {body_name}", model.body_mass[body], mass)
        if mass > 0:
            yield from _differs(
                f"inertia of body {body_name}",
                _inertia(model, body),
                _inertia(file.model, number),
                TOLERANCE * max(1.0, float(mass)),
            )
        yield from _differs(
            f"gravity compensation of body {body_name}",
            model.body_gravcomp[body],
            file.model.body_gravcomp[number],
        )


def _inertia(model: mujoco.MjModel, body: int) -> NDArray[np.float64]:
    """(3, 4) centre of mass, and inertia about it, in the body's frame."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[body])
    turn = rotation.reshape(3, 3)
    return np.column_stack(
        [model.body_ipos[body], turn @ np.diag(model.body_inertia[body]) @ turn.T]
    )


def _joints(model, data, name, file: ArmFile, form: NormalForm, alone) -> Iterator[str]:
    for number in form.driven:
        joint_name = file.joints[number]
        joint = model.joint(f"{name}/{joint_name}").id
        for field in ("xaxis", "xanchor"):
            yield from _differs(
                f"{field} of joint {joint_name}",
                getattr(data, field)[joint],
                getattr(alone, field)[number],
            )
        for field in ("jnt_type", "jnt_limited", "jnt_range", "jnt_actfrcrange"):
            yield from _differs(
                f"{field} of joint {joint_name}",
                getattr(model, field)[joint],
                getattr(file.model, field)[number],
            )
        dof, own = model.jnt_dofadr[joint], file.model.jnt_dofadr[number]
        for field in ("dof_armature", "dof_damping", "dof_frictionloss"):
            yield from _differs(
                f"{field} of joint {joint_name}",
                getattr(model, field)[dof],
                getattr(file.model, field)[own],
            )


def _sites(model, data, name, file: ArmFile, alone) -> Iterator[str]:
    for number, site_name in enumerate(file.sites):
        site = model.site(f"{name}/{site_name}").id
        for field in ("site_xpos", "site_xmat"):
            yield from _differs(
                f"{field} of site {site_name}",
                getattr(data, field)[site],
                getattr(alone, field)[number],
            )


def _geoms(model, data, name, file: ArmFile, alone) -> Iterator[str]:
    for number, geom_name in enumerate(file.geoms):
        kind = file.model.geom_type[number]
        if kind == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        geom = model.geom(f"{name}/{geom_name}").id
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            # The frame of a mesh is MuJoCo's own choice; where its vertices are is what counts.
            found, wanted = _vertices(model, data, geom), _vertices(file.model, alone, number)
            if len(found) != len(wanted):
                yield f"mesh of geom {geom_name} has {len(found)} vertices, not {len(wanted)}"
            else:
                yield from _differs(f"mesh of geom {geom_name}", found, wanted, MESH_TOLERANCE_M)
            continue
        for field in ("geom_xpos", "geom_xmat"):
            yield from _differs(
                f"{field} of geom {geom_name}",
                getattr(data, field)[geom],
                getattr(alone, field)[number],
            )
        # MuJoCo keeps what a file says beyond the numbers that a type has: a radius with two more is a sphere.
        _, sizes = SIZES[int(kind)]
        yield from _differs(
            f"size of geom {geom_name}",
            model.geom_size[geom, :sizes],
            file.model.geom_size[number, :sizes],
        )


def _vertices(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
    """(n, 3) where the vertices of a mesh are in the world."""
    mesh = int(model.geom_dataid[geom])
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count].astype(float)
    return data.geom_xpos[geom] + vertices @ data.geom_xmat[geom].reshape(3, 3).T

"""The cell in 3D, as a recording shows it: housings, watched capsules and the line of the closest pair."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.readings import control_setting
from workcell.trace.table import Trace
from workcell.view.columns import send
from workcell.view.frames import Frames, is_watched
from workcell.view.limits import DANGER_MARGIN, FALLBACK_T_MIN_S
from workcell.view.palette import CLOSEST, DANGER, Rgb, arm_colour
from workcell.view.scene3d import geom_triangles, joined

DRAWN_GROUPS = (0, 1, 2)
"""Geom groups that are drawn as they are: those MuJoCo's own viewer shows."""
_CAPSULE_ALPHA = 110


def body_surfaces(
    model: mujoco.MjModel, arms: Sequence[str]
) -> Iterator[tuple[int, str, rr.Mesh3D]]:
    """What is drawn of every body that has anything to draw: its index, its entity, its surface in its own frame."""
    for body in range(model.nbody):
        drawn = [
            geom
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] == body and _is_drawn(model, geom)
        ]
        if not drawn:
            continue
        name = model.body(body).name or f"body_{body}"
        owner, slash, part = name.partition("/")
        if slash and owner in arms:
            entity = f"world/{owner}/housing/{part or 'base'}"
        else:
            entity = f"world/surroundings/{name.replace('/', '_')}"
        parts = [geom_triangles(model, geom) for geom in drawn]
        surface = joined(parts)
        colours = [
            np.tile(_geom_rgba(model, geom), (len(piece.vertices), 1))
            for geom, piece in zip(drawn, parts, strict=True)
        ]
        yield (
            body,
            entity,
            rr.Mesh3D(
                vertex_positions=surface.vertices.astype(np.float32),
                vertex_normals=surface.normals.astype(np.float32),
                vertex_colors=np.concatenate(colours),
                triangle_indices=surface.faces.astype(np.uint32),
            ),
        )


def log_geometry(
    recording: rr.RecordingStream, trace: Trace, model: mujoco.MjModel, frames: Frames
) -> None:
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    arms = trace.layout.arms
    for body, entity, surface in body_surfaces(model, arms):
        recording.log(entity, surface, static=True)
        position, xyzw = frames.body(body)
        if model.body_weldid[body] == 0:
            pose = rr.Transform3D(translation=position[0], quaternion=rr.Quaternion(xyzw=xyzw[0]))
            recording.log(entity, pose, static=True)
        else:
            send(
                recording, trace, entity, frames.rows,
                lambda s, p=position, q=xyzw: rr.Transform3D.columns(
                    translation=p[s], quaternion=q[s]
                ),
            )  # fmt: skip
    for index, arm in enumerate(arms):
        _log_capsules(recording, trace, model, frames, arm, arm_colour(index))
    if trace.layout.pairs:
        _log_witness(recording, trace, frames.rows)


def _is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    """Planes have no end and are left to the viewer's grid."""
    plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    return model.geom_group[geom] in DRAWN_GROUPS and not plane


def _geom_rgba(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Colour of a geom; a pattern becomes its mean, for meshes here carry no texture."""
    material = int(model.geom_matid[geom])
    if material < 0:
        return np.round(255 * model.geom_rgba[geom]).astype(np.uint8)
    rgba = model.mat_rgba[material].astype(float)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0:
        channels = int(model.tex_nchannel[texture])
        size = int(model.tex_height[texture] * model.tex_width[texture]) * channels
        first = int(model.tex_adr[texture])
        pixels = model.tex_data[first : first + size].reshape(-1, channels)
        rgba[:3] *= pixels[:, :3].mean(axis=0) / 255
    return np.round(255 * rgba).astype(np.uint8)


def _log_capsules(
    recording: rr.RecordingStream,
    trace: Trace,
    model: mujoco.MjModel,
    frames: Frames,
    arm: str,
    colour: Rgb,
) -> None:
    """The watched capsules and spheres of an arm: shapes once, their poses as columns."""
    geoms = [
        geom
        for geom in range(model.ngeom)
        if is_watched(model, geom) and model.geom(geom).name.startswith(f"{arm}/")
    ]
    if not geoms:
        return
    is_capsule = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CAPSULE
    length = np.where(is_capsule, 2 * model.geom_size[geoms, 1], 0.0)
    entity = f"world/{arm}/capsules"
    recording.log(
        entity,
        rr.Capsules3D(
            lengths=length,
            radii=model.geom_size[geoms, 0],
            # The viewer's capsule stands on its origin, MuJoCo's is centred on it.
            translations=np.column_stack([np.zeros((len(geoms), 2)), -length / 2]),
            colors=[[*colour, _CAPSULE_ALPHA]] * len(geoms),
            fill_mode="Solid",
        ),
        static=True,
    )
    position, xyzw = frames.capsules(geoms)
    send(
        recording, trace, entity, frames.rows,
        lambda s: rr.InstancePoses3D.columns(
            translations=position[s].reshape(-1, 3),
            quaternions=xyzw[s].reshape(-1, 4),
        ).partition([len(geoms)] * len(position[s])),
    )  # fmt: skip


def _log_witness(recording: rr.RecordingStream, trace: Trace, rows: NDArray[np.int64]) -> None:
    """A line between the witness points that matter now, red when time runs out."""
    strips = np.stack([trace["witness_i_m"][rows], trace["witness_j_m"][rows]], axis=1)
    known = np.isfinite(strips).all(axis=(1, 2))
    rows, strips = rows[known], strips[known].astype(np.float32)
    t_min_s = control_setting(trace, "t_min_s") or FALLBACK_T_MIN_S
    danger = trace["ttc_s"][rows] < DANGER_MARGIN * t_min_s
    colours = np.where(danger[:, None], [DANGER], [CLOSEST]).astype(np.uint8)
    send(
        recording, trace, "world/witness", rows,
        lambda s: rr.LineStrips3D.columns(
            strips=strips[s], colors=colours[s], radii=np.full(len(strips[s]), 0.005, np.float32)
        ),
    )  # fmt: skip

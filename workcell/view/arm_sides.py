"""An arm from three sides: housing filled, capsules as outlines, the tool as a cross."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

SIDES = (
    ("from the front (y, z)", 1, 2),
    ("from the side (x, z)", 0, 2),
    ("from above (x, y)", 0, 1),
)
HOUSING, WATCHED = 2, 4


def draw(xml: str, home_rad: tuple[float, ...], path: Path) -> None:
    """Draw an arm file at home into a PNG.

    Args:
        xml: Text of the file; must stand alone.
        home_rad: Joint positions.
        path: Where to.
    """
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[:] = home_rad
    mujoco.mj_kinematics(model, data)
    figure = Figure(figsize=(12, 4.6), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, (title, i, j) in zip(axes, SIDES, strict=True):
        for g in range(model.ngeom):
            outline = _outline(_points(model, data, g)[:, [i, j]])
            if model.geom_group[g] == HOUSING:
                ax.fill(*outline.T, facecolor="0.72", edgecolor="0.4", linewidth=0.4)
            elif model.geom_group[g] == WATCHED:
                ax.fill(
                    *outline.T,
                    facecolor=(0.2, 0.45, 0.85, 0.12),
                    edgecolor=(0.1, 0.3, 0.7),
                    linewidth=0.9,
                )
        tool = data.site("tool")
        ax.plot(tool.xpos[i], tool.xpos[j], "+", color="crimson", markersize=10)
        tip = tool.xpos + 0.1 * tool.xmat.reshape(3, 3)[:, 2]
        ax.plot([tool.xpos[i], tip[i]], [tool.xpos[j], tip[j]], color="crimson", linewidth=1.2)
        ax.set_aspect("equal")
        ax.set_title(title, fontsize=9)
        ax.set_xlabel(f"{'xyz'[i]} in m", fontsize=8)
        ax.set_ylabel(f"{'xyz'[j]} in m", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.grid(linewidth=0.3)
    figure.suptitle("housing grey, watched capsules blue, tool and its z axis red", fontsize=9)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def _points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> NDArray[np.float64]:
    """(n, 3) points around which the outline of a geom is drawn."""
    size, kind = model.geom_size[geom], model.geom_type[geom]
    k = np.arange(24)
    circle = np.stack([np.cos(k * np.pi / 12), np.sin(k * np.pi / 12), 0 * k], axis=1)
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        local = model.mesh_vert[start : start + count].astype(float)
    elif kind == kinds.mjGEOM_BOX:
        local = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
    elif kind == kinds.mjGEOM_CYLINDER:
        shift = np.array([0, 0, size[1]])
        local = np.concatenate([circle * size[0] + shift, circle * size[0] - shift])
    else:
        ball = np.concatenate(
            [circle * np.cos(a) + [0, 0, np.sin(a)] for a in np.linspace(-np.pi / 2, np.pi / 2, 13)]
        )
        if kind == kinds.mjGEOM_ELLIPSOID:
            local = ball * size
        else:
            shift = np.array([0, 0, size[1] if kind == kinds.mjGEOM_CAPSULE else 0.0])
            local = np.concatenate([ball * size[0] + shift, ball * size[0] - shift])
    return data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T


def _outline(points: NDArray[np.float64]) -> NDArray[np.float64]:
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    return np.concatenate([hull, hull[:1]])

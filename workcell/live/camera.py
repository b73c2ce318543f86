"""Where to look from, so that all tools are seen: chosen from the scene, or given in `[view]`."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scenario import View
from workcell.scene.cell import Cell

FIELD_OF_VIEW_RAD = math.radians(50.0)
"""Vertical, of the page's camera; chosen as what shows a cell with little distortion."""
MARGIN = 1.8
"""Share by which the picture is larger than what is to be seen."""
SMALLEST_RADIUS_M = 0.5
_AZIMUTHS_DEG = range(0, 360, 15)
_ELEVATIONS_DEG = (25.0, 40.0, 55.0)
_USUAL_ELEVATION_DEG = 25.0
_OWN_M = 0.12
"""What is hit this close to a tool is the tool's own body."""


@dataclass(frozen=True)
class CameraView:
    """A place to look from."""

    position_m: NDArray[np.float64]
    """(3,)"""
    look_at_m: NDArray[np.float64]
    """(3,)"""


def view_from(
    look_at_m: NDArray[np.float64], azimuth_deg: float, elevation_deg: float, distance_m: float
) -> CameraView:
    """The view at an azimuth (0 looks along x, 90 along y), from above the horizon."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    ahead = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            -math.sin(elevation),
        ]
    )
    return CameraView(look_at_m - distance_m * ahead, np.array(look_at_m))


def best_view(cell: Cell, data: mujoco.MjData, settings: View) -> CameraView:
    """The view from which every tool is seen, the tools lie side by side, and the driven arm does not hide them.

    Args:
        cell: What is seen.
        data: In the configuration that counts, kinematics done.
        settings: `[view]`; what it gives is kept.
    """
    azimuths, elevations = _AZIMUTHS_DEG, _ELEVATIONS_DEG
    if settings.camera_azimuth_deg is not None:
        azimuths = (settings.camera_azimuth_deg,)
    if settings.camera_elevation_deg is not None:
        elevations = (settings.camera_elevation_deg,)
    centre, radius = _seen(cell, data)
    distance = settings.camera_distance_m or MARGIN * radius / math.tan(FIELD_OF_VIEW_RAD / 2.0)
    views = [
        (view_from(centre, azimuth, elevation, distance), elevation)
        for azimuth, elevation in itertools.product(azimuths, elevations)
    ]
    return max(views, key=lambda view: _worth(cell, data, *view))[0]


def presets(best: CameraView) -> dict[str, CameraView]:
    """The views a person can choose from, the best first."""
    centre = best.look_at_m
    distance = float(np.linalg.norm(best.position_m - centre))
    return {
        "best": best,
        "front": view_from(centre, 90.0, 15.0, distance),
        "left": view_from(centre, 0.0, 15.0, distance),
        "right": view_from(centre, 180.0, 15.0, distance),
        "back": view_from(centre, 270.0, 15.0, distance),
        "top": view_from(centre, 90.0, 89.0, distance),
    }


def tool_is_seen(cell: Cell, data: mujoco.MjData, eye_m: NDArray[np.float64], site: int) -> bool:
    """Whether nothing stands between an eye and a tool."""
    way = data.site_xpos[site] - eye_m
    distance = float(np.linalg.norm(way))
    # What is drawn: everything but the watched capsules (group 4) and what is hidden (3, 5).
    drawn = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
    met = np.array([-1], dtype=np.int32)
    hit = mujoco.mj_ray(cell.model, data, eye_m, way / distance, drawn, 1, -1, met)
    return hit < 0.0 or hit > distance - _OWN_M


def _seen(cell: Cell, data: mujoco.MjData) -> tuple[NDArray[np.float64], float]:
    """Middle of what is to be seen, and how far it reaches: tools and the arms' bases."""
    model = cell.model
    points = [data.site_xpos[arm.tool_site] for arm in cell.arms]
    points += [data.xpos[model.body_rootid[model.site_bodyid[a.tool_site]]] for a in cell.arms]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    return (low + high) / 2.0, max(SMALLEST_RADIUS_M, float(np.linalg.norm(high - low)) / 2.0)


def _worth(
    cell: Cell, data: mujoco.MjData, view: CameraView, elevation_deg: float
) -> tuple[int, float]:
    """How many tools are seen; then how far apart they lie in the picture, less what is unusual to look at."""
    sites = [arm.tool_site for arm in cell.arms]
    seen = sum(tool_is_seen(cell, data, view.position_m, site) for site in sites)
    ahead = view.look_at_m - view.position_m
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= max(float(np.linalg.norm(right)), 1e-9)
    across = [float(right @ data.site_xpos[site]) for site in sites]
    apart = min((abs(a - b) for a, b in itertools.combinations(across, 2)), default=0.0)
    # Looking along y, x to the right, is what keys and drawings of a cell have in common.
    usual = 0.02 * float(ahead[1]) - 0.002 * abs(elevation_deg - _USUAL_ELEVATION_DEG)
    return seen, round(apart, 2) + usual

"""What drives a priority arm: the tool pose wanted at a time.

Every operator is one interface, `target(time_s)`; the clock is the run's, since a priority arm is
never slowed down.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.path import PathGeometry, Target, TimedPath, standing


class Operator(Protocol):
    """Anything that knows the tool pose wanted at a time."""

    name: str
    """Logged as the arm's job."""

    def target(self, time_s: float) -> Target:
        """The pose and twist wanted at a time of the run."""
        ...


class HoldOperator:
    """Keeps the pose the tool starts with."""

    name = "hold"

    def __init__(self, position_m: NDArray[np.float64], wxyz: NDArray[np.float64]):
        self._target = standing(position_m, wxyz)

    def target(self, time_s: float) -> Target:
        return self._target


class WaypointsOperator:
    """Moves through waypoints once, starting where the tool is."""

    name = "waypoints"

    def __init__(
        self,
        settings: scenario.Waypoints,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
    ):
        self._path = TimedPath(
            path_through(settings.waypoints, position_m, wxyz),
            speed_m_s=settings.speed_m_s,
            acceleration_m_s2=settings.acceleration_m_s2,
        )
        self._start_s = settings.start_s

    def target(self, time_s: float) -> Target:
        return self._path.target(time_s - self._start_s)


def path_through(
    waypoints: tuple[scenario.Waypoint, ...],
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
) -> PathGeometry:
    """The curve from a pose through waypoints of a scenario; a missing orientation keeps the one before."""
    positions, orientations = [position_m], [np.asarray(wxyz, dtype=float)]
    for waypoint in waypoints:
        positions.append(np.array(waypoint.position_m))
        orientations.append(orientations[-1] if waypoint.wxyz is None else np.array(waypoint.wxyz))
    return PathGeometry(np.array(positions), np.array(orientations))


def make_operator(
    settings: scenario.Operator, position_m: NDArray[np.float64], wxyz: NDArray[np.float64]
) -> Operator:
    """The operator a scenario asks for, for a tool that starts at the given pose."""
    if isinstance(settings, scenario.Hold):
        return HoldOperator(position_m, wxyz)
    return WaypointsOperator(settings, position_m, wxyz)

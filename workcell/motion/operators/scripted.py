"""Scripted operators: a tool that stands still, and one that moves through waypoints.

In comes the time of the run, out comes the setpoint; the path and its clock are those of
`workcell.motion.path`. A priority arm is never slowed down, so that the clock is the run's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.path import PathGeometry, TimedPath, path_through, standing
from workcell.motion.setpoint import Setpoint


class HoldOperator:
    """Keeps the pose the tool starts with."""

    def __init__(self, position_m: NDArray[np.float64], wxyz: NDArray[np.float64]):
        self._setpoint = Setpoint(standing(position_m, wxyz), "hold")

    def setpoint(self, time_s: float) -> Setpoint:
        return self._setpoint


class WaypointsOperator:
    """Moves through waypoints, starting where the tool is; with `repeat`, back and forth between first and last."""

    def __init__(
        self,
        settings: scenario.Waypoints,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
    ):
        profile = {
            "speed_m_s": settings.speed_m_s,
            "acceleration_m_s2": settings.acceleration_m_s2,
        }
        approach = path_through(settings.waypoints, position_m, wxyz)
        # A single waypoint has no other end than where the tool started.
        only = len(settings.waypoints) == 1
        sweep = approach if only else path_through(settings.waypoints[1:], *_first(approach))
        self._approach = TimedPath(approach, **profile)
        self._legs = (
            TimedPath(sweep, **profile, start_m=sweep.length_m, end_m=0.0),
            TimedPath(sweep, **profile),
        )
        self._start_s, self._pause_s = settings.start_s, settings.pause_s
        self._repeat = settings.repeat

    def setpoint(self, time_s: float) -> Setpoint:
        clock = time_s - self._start_s
        after = clock - self._approach.duration_s - self._pause_s
        if after < 0.0 or not self._repeat:
            return Setpoint(self._approach.target(clock), "waypoints")
        leg_s = self._legs[0].duration_s + self._pause_s
        index = min(int(after / leg_s), self._repeat - 1) if leg_s > 0.0 else 0
        return Setpoint(self._legs[index % 2].target(after - index * leg_s), "waypoints")


def _first(geometry: PathGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The first waypoint after the start, with the orientation it inherited."""
    k = min(1, len(geometry.positions_m) - 1)
    return geometry.positions_m[k], geometry.wxyz[k]

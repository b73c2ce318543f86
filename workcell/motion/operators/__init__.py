"""What drives a priority arm: the tool motion wanted at a time, and whether the input is sound.

Every operator is one interface, `setpoint(time_s)` (workcell.motion.setpoint); the clock is the run's, since
a priority arm is never slowed down. Here are the scripted ones, and the choice between all.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators.human import HumanOperator
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.recording import RecordingOperator
from workcell.motion.path import PathGeometry, TimedPath, standing
from workcell.motion.setpoint import Operator, Setpoint


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
    settings: scenario.Operator,
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
    *,
    seed: int = 0,
    name: str = "",
    period_s: float = 0.002,
) -> Operator:
    """The operator a scenario asks for.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        seed: The scenario's seed.
        name: The arm's name; two simulated people in one scenario do not move alike.
        period_s: Control period.

    Raises:
        InputError: the file of a recording is missing or not sound.
    """
    match settings:
        case scenario.Waypoints():
            return WaypointsOperator(settings, position_m, wxyz)
        case scenario.Recording():
            return RecordingOperator(settings, position_m, wxyz, period_s=period_s)
        case scenario.Human():
            random = np.random.default_rng([seed, zlib.crc32(name.encode())])
            return HumanOperator(settings, position_m, wxyz, random)
        case scenario.Live():
            return LiveOperator(settings, position_m, wxyz, period_s=period_s)
    return HoldOperator(position_m, wxyz)

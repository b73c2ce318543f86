"""Smooth tool paths: waypoints -> pose and twist at a time along the path.

Geometry and timing are apart. `PathGeometry` is a twice continuously differentiable curve through
the waypoints, parametrised by length; `TimedPath` runs along it at a cruise speed, from rest to
rest. Its clock is the path's own: an arm that is slowed down advances the clock more slowly and
stays on the curve.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly
from scipy.spatial.transform import Rotation, RotationSpline

from workcell import scenario
from workcell.motion.cubic import Cubic
from workcell.motion.orientation import angular_velocity, rotation_between, unit

TURN_LENGTH_M_PER_RAD = 0.25
"""Turning counts as length, so that a turn on the spot takes time too; chosen: about a hand's distance from the wrist."""
SLOWEST_SHARE = 0.25
"""Share of a curve's mean rate that its parameter never falls below; chosen so that a reversal costs little time."""
BEND_SHARE = 0.5
"""Share of the acceleration that a bend may need; the rest is for slowing down before it and going on after it."""
RATE_TOLERANCE = 1e-3
"""Relative excess of speed that is let pass; ordinary paths stay far below."""
_STEP_M = 0.005
"""Spacing of the table a geometry is tabulated in; its cubic interpolation is then good to about 1e-8 m."""


class Target(NamedTuple):
    """Where a tool should be and how it should move, in the world frame."""

    position_m: NDArray[np.float64]
    """(3,)"""
    wxyz: NDArray[np.float64]
    """(4,) unit quaternion"""
    velocity_m_s: NDArray[np.float64]
    """(3,) of the tool point"""
    angular_velocity_rad_s: NDArray[np.float64]
    """(3,)"""

    def reversed(self) -> Target:
        """The same pose on the way back."""
        return Target(self.position_m, self.wxyz, -self.velocity_m_s, -self.angular_velocity_rad_s)


def standing(position_m: NDArray[np.float64], wxyz: NDArray[np.float64]) -> Target:
    """A target that does not move."""
    return Target(np.array(position_m), np.array(wxyz), np.zeros(3), np.zeros(3))


def length(vector: NDArray[np.float64]) -> float:
    """Of a vector of a few entries; NumPy's norm takes a microsecond more."""
    return math.hypot(*vector.tolist())


class PathGeometry:
    """A smooth curve of tool poses.

    Args:
        positions_m: (K, 3) waypoints in the world, K >= 1.
        wxyz: (K, 4) unit quaternions.
    """

    def __init__(
        self,
        positions_m: Sequence[Sequence[float]] | NDArray[np.float64],
        wxyz: Sequence[Sequence[float]] | NDArray[np.float64],
    ):
        positions, quaternions = _without_repeats(
            np.asarray(positions_m, dtype=float), np.asarray(wxyz, dtype=float)
        )
        self.positions_m, self.wxyz = positions, quaternions
        if len(positions) == 1:
            self.length_m = 0.0
            return
        straight = len(positions) == 2 and np.array_equal(quaternions[0], quaternions[1])
        self._curve = (
            _line(positions, quaternions[0]) if straight else _spline(positions, quaternions)
        )
        self._table = Cubic(self._curve)
        self.length_m = self._table.end

    def pose(self, s_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and unit quaternion at a length along the curve, clamped to its ends."""
        if self.length_m == 0.0:
            return self.positions_m[0], self.wxyz[0]
        value = self._table.value(s_m)
        return np.array(value[:3]), np.array(unit(value[3:]))

    def target(self, s_m: float, speed_m_s: float) -> Target:
        """Pose at a length along the curve, clamped to its ends, and the twist at a speed along it; negative is backwards."""
        if speed_m_s == 0.0 or self.length_m == 0.0:
            return standing(*self.pose(s_m))
        value, slope = self._table.value_and_slope(s_m)
        wxyz = unit(value[3:])
        motion = [*slope[:3], *angular_velocity(wxyz, slope[3:])]
        told = np.array([*value[:3], *wxyz, *(speed_m_s * part for part in motion)])
        return Target(told[:3], told[3:7], told[7:10], told[10:])

    def bend(self, s_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) how much the slope changes along the curve at evenly spaced lengths, turning counted as length, 1/m.

        At speed v the tool needs the acceleration bend v² there, that along the curve aside.
        """
        if self.length_m == 0.0 or len(s_m) < 3:
            return np.zeros(len(s_m))
        value, rate = self._curve(s_m), self._curve(s_m, 1)
        wxyz = value[:, 3:] / np.linalg.norm(value[:, 3:], axis=1, keepdims=True)
        angular = np.transpose(angular_velocity(wxyz.T, rate[:, 3:].T))
        slope = np.hstack([rate[:, :3], TURN_LENGTH_M_PER_RAD * angular])
        return np.linalg.norm(np.gradient(slope, np.abs(s_m[1] - s_m[0]), axis=0), axis=1)


class TimedPath:
    """Runs along a geometry from one length to another, from rest to rest.

    The speed rises and falls along a smooth step (3x² - 2x³), whose steepest slope is the
    acceleration; a path too short for the cruise speed gets a lower one. Where the curve bends so much
    that the cruise speed would need more than that acceleration across it, it runs more slowly: such a
    stretch counts as longer.

    Args:
        geometry: The curve.
        speed_m_s: Cruise speed along it.
        acceleration_m_s2: Largest acceleration along it.
        start_m, end_m: Lengths where the run starts and ends; end before start runs backwards.
    """

    def __init__(
        self,
        geometry: PathGeometry,
        *,
        speed_m_s: float,
        acceleration_m_s2: float,
        start_m: float = 0.0,
        end_m: float | None = None,
    ):
        self.geometry = geometry
        self.start_m = start_m
        self.end_m = geometry.length_m if end_m is None else end_m
        distance = abs(self.end_m - self.start_m)
        self._sign = 1.0 if self.end_m >= self.start_m else -1.0
        # The two ramps together cover v * ramp, and ramp = 1.5 v / a.
        self.speed_m_s = min(speed_m_s, math.sqrt(distance * acceleration_m_s2 / 1.5))
        self._slowed = _slowed_in_bends(
            geometry, self.start_m, self.end_m, self.speed_m_s, acceleration_m_s2
        )
        if self._slowed is not None:
            distance = self._slowed.end
        self._ramp_s = 1.5 * self.speed_m_s / acceleration_m_s2
        self._cruise_s = distance / self.speed_m_s - self._ramp_s if self.speed_m_s > 0 else 0.0
        self._distance_m = distance
        self.duration_s = 2 * self._ramp_s + self._cruise_s

    def target(self, clock_s: float) -> Target:
        """Pose and twist at a time of the path's own clock, at rest outside its span."""
        travelled, speed = self._travel(clock_s)
        if self._slowed is not None:
            (travelled,), (share,) = self._slowed.value_and_slope(travelled)
            speed *= share
        return self.geometry.target(self.start_m + self._sign * travelled, self._sign * speed)

    def length_at(self, clock_s: float) -> float:
        """Length along the geometry at a time of the clock."""
        travelled, _ = self._travel(clock_s)
        if self._slowed is not None:
            (travelled,) = self._slowed.value(travelled)
        return self.start_m + self._sign * travelled

    def _travel(self, clock_s: float) -> tuple[float, float]:
        """Distance travelled and speed, slow stretches counted as longer."""
        if self._distance_m == 0.0 or clock_s <= 0.0:
            return 0.0, 0.0
        if clock_s >= self.duration_s:
            return self._distance_m, 0.0
        v, ramp = self.speed_m_s, self._ramp_s
        if clock_s > ramp + self._cruise_s:
            left, speed = _ramp_up(self.duration_s - clock_s, v, ramp)
            return self._distance_m - left, speed
        if clock_s > ramp:
            return v * (clock_s - ramp / 2), v
        return _ramp_up(clock_s, v, ramp)


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


def _line(positions: NDArray[np.float64], wxyz: NDArray[np.float64]) -> PPoly:
    """What `_spline` makes of two waypoints of one orientation, at no cost: a goal that moves asks for it in mid-run."""
    way = positions[1] - positions[0]
    end = length(way)
    coefficients = np.zeros((4, 1, 7))
    coefficients[2, 0, :3] = way / end
    coefficients[3, 0] = np.concatenate([positions[0], unit(wxyz.tolist())])
    return PPoly(coefficients, np.array([0.0, end]))


def _spline(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> PPoly:
    """The curve of position and quaternion through waypoints, by its length."""
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    knots = np.concatenate([[0.0], np.cumsum(_chords(positions, rotations))])
    # Two waypoints make a straight line; from three on the curve is a spline with natural ends.
    position = CubicSpline(knots, positions, bc_type="natural")
    orientation = RotationSpline(knots, rotations)
    grid = np.linspace(0.0, knots[-1], max(3, int(np.ceil(knots[-1] / _STEP_M)) + 1))
    fine = np.linspace(0.0, knots[-1], 8 * len(grid))
    rate = np.hypot(
        np.linalg.norm(position(fine, 1), axis=1),
        TURN_LENGTH_M_PER_RAD * np.linalg.norm(orientation(fine, 1), axis=1),
    )
    # Where the curve turns back on itself it hardly moves; counting it as moving a little keeps the
    # parameter regular there, and the tool below the speed asked for rather than above.
    # The sixteenth-power mean is a maximum without the kink.
    floor = SLOWEST_SHARE * rate.mean()
    rate = floor * ((rate / floor) ** 16 + 1.0) ** (1 / 16)
    run = np.concatenate([[0.0], np.cumsum(np.diff(fine) * (rate[1:] + rate[:-1]) / 2)])
    at = np.linspace(0.0, run[-1], len(grid))
    where = PchipInterpolator(run, fine)(at)
    quats = _continuous(orientation(where).as_quat(scalar_first=True))
    ends = "not-a-knot" if len(at) > 3 else "natural"
    curve = CubicSpline(at, np.hstack([position(where), quats]), bc_type=ends)
    # Between the table's entries a sharp turn can come out faster than it should: counted as longer.
    stretch = max(1.0, _peak_rate(curve, 8 * len(at)))
    if stretch > 1.0 + RATE_TOLERANCE:
        curve = CubicSpline(at * stretch, curve(at), bc_type=ends)
    return curve


def _peak_rate(curve: CubicSpline, samples: int) -> float:
    """Largest speed along a curve of position and quaternion, turning counted as length."""
    at = np.linspace(curve.x[0], curve.x[-1], samples)
    value, rate = curve(at), curve(at, 1)
    # |ω| = 2 |q̇| for a unit quaternion.
    turning = 2.0 * np.linalg.norm(rate[:, 3:], axis=1) / np.linalg.norm(value[:, 3:], axis=1)
    speed = np.hypot(np.linalg.norm(rate[:, :3], axis=1), TURN_LENGTH_M_PER_RAD * turning)
    return float(speed.max())


def _slowed_in_bends(
    geometry: PathGeometry, start_m: float, end_m: float, speed_m_s: float, acceleration_m_s2: float
) -> Cubic | None:
    """Way along a curve for the way counted, both from the start; None where no bend needs less than the speed.

    The speed allowed is sqrt(share / bend) for a share of the acceleration, and rises from it and falls to
    it with no more than that share; a step of way counts as much longer as it is slower.
    """
    if speed_m_s == 0.0:
        return None
    way = np.linspace(0.0, abs(end_m - start_m), 2 + int(abs(end_m - start_m) / (_STEP_M / 2)))
    bend = geometry.bend(start_m + np.sign(end_m - start_m) * way)
    share = BEND_SHARE * acceleration_m_s2
    allowed = np.minimum(speed_m_s**2, share / np.maximum(bend, 1e-9))
    if allowed.min() >= speed_m_s**2:
        return None
    gain = 2.0 * share * way[1]
    climb = gain * np.arange(len(way))
    allowed = climb + np.minimum.accumulate(allowed - climb)
    allowed = (climb + np.minimum.accumulate(allowed[::-1] - climb))[::-1]
    slowness = speed_m_s / np.sqrt(allowed)
    counted = np.concatenate([[0.0], np.cumsum(way[1] * (slowness[1:] + slowness[:-1]) / 2)])
    return Cubic(PchipInterpolator(counted, way))


def _ramp_up(time_s: float, speed_m_s: float, ramp_s: float) -> tuple[float, float]:
    """Distance and speed on the smooth step from rest."""
    x = time_s / ramp_s
    return speed_m_s * ramp_s * x**3 * (1 - x / 2), speed_m_s * x * x * (3 - 2 * x)


def _chords(positions: NDArray[np.float64], rotations: Rotation) -> NDArray[np.float64]:
    turns = (rotations[:-1].inv() * rotations[1:]).magnitude()
    return np.hypot(
        np.linalg.norm(np.diff(positions, axis=0), axis=1), TURN_LENGTH_M_PER_RAD * turns
    )


def _without_repeats(
    positions: NDArray[np.float64], wxyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A waypoint equal to the one before adds nothing and would make the spline's knots coincide."""
    keep = [0]
    for k in range(1, len(positions)):
        last = keep[-1]
        turn = length(rotation_between(wxyz[last], wxyz[k]))
        if math.hypot(length(positions[k] - positions[last]), TURN_LENGTH_M_PER_RAD * turn) > 1e-6:
            keep.append(k)
    return positions[keep], wxyz[keep]


def _continuous(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """q and -q are the same rotation: choose signs so that neighbours are near each other."""
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", wxyz[1:], wxyz[:-1]) < 0, -1.0, 1.0))
    return np.vstack([wxyz[:1], wxyz[1:] * flips[:, None]])

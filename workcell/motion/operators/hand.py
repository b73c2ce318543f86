"""What a hand's motion is made of: minimum-jerk pieces one after another, and tremor.

A piece is x = 10τ³ - 15τ⁴ + 6τ⁵ of its way (Flash and Hogan 1985), from rest to rest; its duration
follows from a peak speed and a peak acceleration. Pieces are added at the end of the list and asked
for by time, so that a motion does not depend on when it is asked for.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target

PEAK_SPEED = 1.875
"""Peak of the minimum-jerk speed, in mean speeds."""
PEAK_ACCELERATION = 5.7735
"""Peak of its acceleration, in distance over duration squared: 10/√3."""
TREMOR_HZ = (8.0, 12.0)
"""Band of physiological hand tremor; a peak near 8 to 10 Hz is found by Sutton and Sykes (1967)."""
TREMOR_LINES = 3
"""Sinusoids an axis; chosen as the fewest that beat irregularly."""
TREMOR_RISE_S = 0.5
"""The tremor fades in, so that the run starts at rest."""

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(3,) position in m and (4,) unit quaternion, in the world."""


@dataclass(frozen=True)
class _Piece:
    """One minimum-jerk motion, or a pause where nothing moves."""

    start_s: float
    duration_s: float
    doing: str
    position_m: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    """Pose at its start."""
    way_m: NDArray[np.float64]
    turn_rad: NDArray[np.float64]
    """Translation and rotation vector, both in the world, to its end."""
    elbow_way_m: float

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s


class Gestures:
    """Pieces one after another, from a pose on.

    Args:
        start: Pose at the beginning.
    """

    def __init__(self, start: Pose):
        self.here = start
        """Pose at the end of the last piece."""
        self._pieces: list[_Piece] = []
        self._starts: list[float] = []

    @property
    def end_s(self) -> float:
        """When the last piece ends."""
        return self._pieces[-1].end_s if self._pieces else 0.0

    def move(self, doing: str, to: Pose, *, speed_m_s: float, acceleration_m_s2: float) -> None:
        """Add a motion to a pose whose peaks of speed and acceleration, turning counted as length, stay below these."""
        position, wxyz = self.here
        way = np.hypot(
            np.linalg.norm(to[0] - position),
            TURN_LENGTH_M_PER_RAD * np.linalg.norm(rotation_between(wxyz, to[1])),
        )
        duration = float(
            max(PEAK_SPEED * way / speed_m_s, np.sqrt(PEAK_ACCELERATION * way / acceleration_m_s2))
        )
        if duration > 0.0:
            self.add(doing, duration, to)

    def add(
        self, doing: str, duration_s: float, to: Pose | None = None, *, elbow_way_m: float = 0.0
    ) -> None:
        """Add a piece of a duration that ends at a pose; without one the hand stays where it is."""
        position, wxyz = self.here
        end = self.here if to is None else to
        start_s = self.end_s
        way, turn = end[0] - position, rotation_between(wxyz, end[1])
        self._pieces.append(
            _Piece(start_s, duration_s, doing, position, wxyz, way, turn, elbow_way_m)
        )
        self._starts.append(start_s)
        self.here = end

    def at(self, time_s: float) -> tuple[Target, str, float]:
        """Pose and twist at a time before `end_s`, what is being done, and the speed of the elbow in m/s."""
        piece = self._pieces[max(0, bisect_right(self._starts, time_s) - 1)]
        progress, rate = minimum_jerk(time_s - piece.start_s, piece.duration_s)
        target = Target(
            piece.position_m + progress * piece.way_m,
            turned(piece.wxyz, progress * piece.turn_rad),
            rate * piece.way_m,
            rate * piece.turn_rad,
        )
        return target, piece.doing, rate * piece.elbow_way_m


class Tremor:
    """A few sinusoids an axis with random frequencies in the band and random phases."""

    def __init__(self, rms_m: float, random: np.random.Generator):
        omega = 2 * np.pi * random.uniform(*TREMOR_HZ, size=(3, TREMOR_LINES))
        phase = random.uniform(0.0, 2 * np.pi, size=(3, TREMOR_LINES))
        self._lines: list[list[list[float]]] = np.stack([omega, phase], axis=2).tolist()
        """For every axis, angular frequency and phase of each sinusoid."""
        # A sinusoid of amplitude A has A²/2 of power; the lines share the power of the rms value.
        self._amplitude = rms_m * math.sqrt(2.0 / TREMOR_LINES)

    def at(self, time_s: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(3,) offset in m and (3,) its velocity in m/s."""
        rise, rise_rate = minimum_jerk(time_s, TREMOR_RISE_S)
        offsets, drifts = [], []
        for lines in self._lines:
            offset = drift = 0.0
            for omega, phase in lines:
                angle = omega * time_s + phase
                offset += math.sin(angle)
                drift += omega * math.cos(angle)
            offsets.append(self._amplitude * rise * offset)
            drifts.append(self._amplitude * (rise * drift + rise_rate * offset))
        return np.array(offsets), np.array(drifts)


def minimum_jerk(time_s: float, duration_s: float) -> tuple[float, float]:
    """Part of the way done, and its rate in 1/s."""
    if time_s >= duration_s:
        return 1.0, 0.0
    x = max(time_s, 0.0) / duration_s
    return x**3 * (10 - 15 * x + 6 * x * x), 30 * (x * (1 - x)) ** 2 / duration_s

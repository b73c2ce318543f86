"""A simulated person at the priority arm: seeded, reproducible, and not considerate.

The person works at sites, one after another in random order. Reaches are minimum-jerk motions
(Flash and Hogan 1985: x = 10τ³ - 15τ⁴ + 6τ⁵), some of them interrupted and gone on with; at a site
there are pauses, now and then a sudden withdrawal or a swing of the elbow; and over everything lies
physiological tremor. The motion is a list of pieces drawn one after another from one random
generator, so that it does not depend on when it is asked for.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.motion.setpoint import Setpoint

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
SLOWEST_PART = 0.6
"""Reaches run at 60 to 100 % of `speed_m_s`; chosen so that no two are alike."""
STOP_PART = (0.25, 0.75)
"""An interrupted reach stops within the middle half of its way."""


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
    elbow_way_m: float = 0.0

    @property
    def end_s(self) -> float:
        return self.start_s + self.duration_s


class HumanOperator:
    """The person.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        random: Source of all chance; the same state gives the same motion.
    """

    def __init__(
        self,
        settings: scenario.Human,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        random: np.random.Generator,
    ):
        self._settings = settings
        self._random = random
        self._sites = [
            (
                np.array(site.position_m),
                np.array(wxyz if site.wxyz is None else site.wxyz, dtype=float),
            )
            for site in settings.sites
        ]
        self._site = -1
        self._tremor = _Tremor(settings.tremor_m, random)
        start = np.array(position_m, dtype=float), np.array(wxyz, dtype=float)
        self._here = start
        """Pose at the end of the last piece."""
        self._elbow_out = False
        self._pieces: list[_Piece] = []
        self._starts: list[float] = []
        self._add("pause", settings.start_s, start)

    def setpoint(self, time_s: float) -> Setpoint:
        while time_s >= self._pieces[-1].end_s:
            self._decide()
        piece = self._pieces[max(0, bisect_right(self._starts, time_s) - 1)]
        progress, rate = _minimum_jerk(time_s - piece.start_s, piece.duration_s)
        offset, drift = self._tremor.at(time_s)
        target = Target(
            piece.position_m + progress * piece.way_m + offset,
            turned(piece.wxyz, progress * piece.turn_rad),
            rate * piece.way_m + drift,
            rate * piece.turn_rad,
        )
        return Setpoint(target, piece.doing, elbow_speed_m_s=rate * piece.elbow_way_m)

    def _decide(self) -> None:
        """Draw what the person does next: one reach and the stay at its end."""
        settings, random = self._settings, self._random
        site = self._next_site()
        speed = settings.speed_m_s * random.uniform(SLOWEST_PART, 1.0)
        if random.random() < settings.stop_probability:
            part = random.uniform(*STOP_PART)
            self._move("reach", self._between(site, part), speed)
            self._pause()
        self._move("reach", site, speed)
        self._pause()
        if random.random() < settings.elbow_probability:
            self._swing_elbow()
            self._pause()
        if random.random() < settings.withdraw_probability:
            away = site[0] + np.array(settings.withdraw_m), site[1]
            self._move("withdraw", away, settings.withdraw_speed_m_s, abrupt=True)
            self._pause()

    def _next_site(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Another site than the present one, where there is another."""
        count = len(self._sites)
        if self._site < 0 or count == 1:
            self._site = int(self._random.integers(count))
        else:
            self._site = (self._site + 1 + int(self._random.integers(count - 1))) % count
        return self._sites[self._site]

    def _between(
        self, site: tuple[NDArray[np.float64], NDArray[np.float64]], part: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        position, wxyz = self._here
        turn = rotation_between(wxyz, site[1])
        return position + part * (site[0] - position), turned(wxyz, part * turn)

    def _move(
        self,
        doing: str,
        to: tuple[NDArray[np.float64], NDArray[np.float64]],
        speed_m_s: float,
        *,
        abrupt: bool = False,
    ) -> None:
        position, wxyz = self._here
        length = np.hypot(
            np.linalg.norm(to[0] - position),
            TURN_LENGTH_M_PER_RAD * np.linalg.norm(rotation_between(wxyz, to[1])),
        )
        settings = self._settings
        acceleration = settings.withdraw_acceleration_m_s2 if abrupt else settings.acceleration_m_s2
        duration = max(
            PEAK_SPEED * length / speed_m_s, np.sqrt(PEAK_ACCELERATION * length / acceleration)
        )
        if duration > 0.0:
            self._add(doing, float(duration), to)

    def _pause(self) -> None:
        low, high = self._settings.pause_s
        self._add("pause", float(self._random.uniform(low, high)), self._here)

    def _swing_elbow(self) -> None:
        """Out and, the next time, back in, so that the elbow does not wander off."""
        settings = self._settings
        way = -settings.elbow_shift_m if self._elbow_out else settings.elbow_shift_m
        self._elbow_out = not self._elbow_out
        duration = PEAK_SPEED * settings.elbow_shift_m / settings.speed_m_s
        self._add("elbow_shift", duration, self._here, elbow_way_m=way)

    def _add(
        self,
        doing: str,
        duration_s: float,
        to: tuple[NDArray[np.float64], NDArray[np.float64]],
        elbow_way_m: float = 0.0,
    ) -> None:
        position, wxyz = self._here
        start_s = self._pieces[-1].end_s if self._pieces else 0.0
        self._pieces.append(
            _Piece(
                start_s,
                duration_s,
                doing,
                position,
                wxyz,
                to[0] - position,
                rotation_between(wxyz, to[1]),
                elbow_way_m,
            )
        )
        self._starts.append(start_s)
        self._here = to


class _Tremor:
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
        rise, rise_rate = _minimum_jerk(time_s, TREMOR_RISE_S)
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


def _minimum_jerk(time_s: float, duration_s: float) -> tuple[float, float]:
    """Part of the way done, and its rate in 1/s."""
    if time_s >= duration_s:
        return 1.0, 0.0
    x = max(time_s, 0.0) / duration_s
    return x**3 * (10 - 15 * x + 6 * x * x), 30 * (x * (1 - x)) ** 2 / duration_s

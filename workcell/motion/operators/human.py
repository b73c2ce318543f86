"""A simulated person at the priority arm: seeded, reproducible, and not considerate.

The person works at sites, one after another in random order, with reaches of which some are
interrupted and gone on with; at a site there are pauses, now and then a sudden withdrawal or a
swing of the elbow. A hostile person also reaches out beyond the arm's reach, flicks and reverses
fast. Tremor lies over everything. The motion is drawn piece by piece from one random generator, so
that it does not depend on when it is asked for. What is switched off draws nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators.hand import PEAK_SPEED, Gestures, Pose, Tremor
from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint

SLOWEST_PART = 0.6
"""Reaches run at 60 to 100 % of `speed_m_s`; chosen so that no two are alike."""
STOP_PART = (0.25, 0.75)
"""An interrupted reach stops within the middle half of its way."""


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
        self._sites: list[Pose] = [
            (
                np.array(site.position_m),
                np.array(wxyz if site.wxyz is None else site.wxyz, dtype=float),
            )
            for site in settings.sites
        ]
        self._site = -1
        self._tremor = Tremor(settings.tremor_m, random)
        self._hand = Gestures((np.array(position_m, dtype=float), np.array(wxyz, dtype=float)))
        self._elbow_out = False
        self._hand.add("pause", settings.start_s)

    def setpoint(self, time_s: float) -> Setpoint:
        while time_s >= self._hand.end_s:
            self._decide()
        target, doing, elbow_speed_m_s = self._hand.at(time_s)
        offset, drift = self._tremor.at(time_s)
        target = Target(
            target.position_m + offset,
            target.wxyz,
            target.velocity_m_s + drift,
            target.angular_velocity_rad_s,
        )
        return Setpoint(target, doing, elbow_speed_m_s=elbow_speed_m_s)

    def _decide(self) -> None:
        """Draw what the person does next: one reach and the stay at its end."""
        settings, random = self._settings, self._random
        site = self._next_site()
        speed = settings.speed_m_s * random.uniform(SLOWEST_PART, 1.0)
        if random.random() < settings.stop_probability:
            part = random.uniform(*STOP_PART)
            self._reach(self._between(site, part), speed)
            self._pause()
        self._reach(site, speed)
        self._pause()
        if random.random() < settings.elbow_probability:
            self._swing_elbow()
            self._pause()
        if random.random() < settings.withdraw_probability:
            self._hand.move(
                "withdraw",
                (site[0] + np.array(settings.withdraw_m), site[1]),
                speed_m_s=settings.withdraw_speed_m_s,
                acceleration_m_s2=settings.withdraw_acceleration_m_s2,
            )
            self._pause()
        self._be_hostile()

    def _be_hostile(self) -> None:
        """Draw what only a hostile person does."""
        settings = self._settings
        if self._chance(settings.flick_probability):
            self._flick()
        if self._chance(settings.reversal_probability):
            self._reverse()
        if self._chance(settings.reach_out_probability):
            self._reach_out()
            self._pause()

    def _chance(self, probability: float) -> bool:
        return probability > 0.0 and self._random.random() < probability

    def _flick(self) -> None:
        """Out in any direction, turning, and back at once."""
        settings = self._settings
        position, wxyz = here = self._hand.here
        turn = settings.flick_rad * self._direction()
        away = position + settings.flick_m * self._direction(), turned(wxyz, turn)
        self._fast("flick", away)
        self._fast("flick", here)

    def _reverse(self) -> None:
        """To and fro across the place, along a line in any direction, without a rest."""
        settings = self._settings
        position, wxyz = here = self._hand.here
        way = settings.reversal_m * self._direction()
        for k in range(settings.reversal_count):
            self._fast("reversal", (position + (way if k % 2 == 0 else -way), wxyz))
        self._fast("reversal", here)

    def _reach_out(self) -> None:
        """Far off, level or upwards, where no arm may be able to follow."""
        settings = self._settings
        position, wxyz = self._hand.here
        direction = self._direction()
        direction[2] = abs(direction[2])
        self._hand.move(
            "reach_out",
            (position + settings.reach_out_m * direction, wxyz),
            speed_m_s=settings.reach_out_speed_m_s,
            acceleration_m_s2=settings.fast_acceleration_m_s2,
        )

    def _fast(self, doing: str, to: Pose) -> None:
        settings = self._settings
        self._hand.move(
            doing,
            to,
            speed_m_s=settings.fast_speed_m_s,
            acceleration_m_s2=settings.fast_acceleration_m_s2,
        )

    def _direction(self) -> NDArray[np.float64]:
        """(3,) a unit vector, all directions alike."""
        vector = self._random.normal(size=3)
        return vector / np.linalg.norm(vector)

    def _next_site(self) -> Pose:
        """Another site than the present one, where there is another."""
        count = len(self._sites)
        if self._site < 0 or count == 1:
            self._site = int(self._random.integers(count))
        else:
            self._site = (self._site + 1 + int(self._random.integers(count - 1))) % count
        return self._sites[self._site]

    def _between(self, site: Pose, part: float) -> Pose:
        position, wxyz = self._hand.here
        turn = rotation_between(wxyz, site[1])
        return position + part * (site[0] - position), turned(wxyz, part * turn)

    def _reach(self, to: Pose, speed_m_s: float) -> None:
        self._hand.move(
            "reach", to, speed_m_s=speed_m_s, acceleration_m_s2=self._settings.acceleration_m_s2
        )

    def _pause(self) -> None:
        low, high = self._settings.pause_s
        self._hand.add("pause", float(self._random.uniform(low, high)))

    def _swing_elbow(self) -> None:
        """Out and, the next time, back in, so that the elbow does not wander off."""
        settings = self._settings
        way = -settings.elbow_shift_m if self._elbow_out else settings.elbow_shift_m
        self._elbow_out = not self._elbow_out
        duration = PEAK_SPEED * settings.elbow_shift_m / settings.speed_m_s
        self._hand.add("elbow_shift", duration, elbow_way_m=way)

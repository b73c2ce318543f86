"""A simulated person behind a bad stream: what a tracker, a slow camera or a busy network makes of a hand.

The person's poses are sampled at a rate, delayed, lost, bunched and spoilt, all drawn from a seed,
and go through the same filter and governor as a live stream (`LiveOperator`). Faults of a sample:

    jitter     it arrives up to `jitter_s` late
    gap        samples are lost for a time
    burst      samples are held back for a time and arrive together
    spike      its position is off by `spike_m` in any direction
    identity   it is the pose at the world's origin, as trackers send when they have lost their marker
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators.human import HumanOperator
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.motion.setpoint import Setpoint

_NOWHERE = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


class StreamedHumanOperator:
    """Follows a simulated person through a stream with faults.

    Args:
        person: Whose hand is sampled.
        settings: Of the stream.
        position_m, wxyz: Tool pose at the start.
        period_s: Control period.
        random: Source of all faults; the person has its own.
    """

    def __init__(
        self,
        person: HumanOperator,
        settings: scenario.Stream,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        period_s: float,
        random: np.random.Generator,
    ):
        self._person = person
        self._faults = StreamFaults(settings, random)
        self._live = LiveOperator(settings, position_m, wxyz, period_s=period_s)

    def setpoint(self, time_s: float) -> Setpoint:
        for sample in self._faults.until(time_s, self._person):
            self._live.offer(sample)
        seen, doing = self._live.setpoint(time_s), self._person.setpoint(time_s)
        # How the elbow is held is posture, which no stream carries.
        return Setpoint(seen.target, doing.doing, seen.state, elbow_speed_m_s=doing.elbow_speed_m_s)


class StreamFaults:
    """Samples a person's hand, and spoils what it sends.

    Args:
        settings: Of the stream.
        random: Source of all faults.
    """

    def __init__(self, settings: scenario.Stream, random: np.random.Generator):
        self._settings = settings
        self._random = random
        self._count = 0
        """Samples taken."""
        self._lost_until_s = self._held_until_s = 0.0
        self._on_the_way: list[tuple[float, int, Sample]] = []
        """Heap of samples by the time at which they arrive."""

    def until(self, time_s: float, person: HumanOperator) -> list[Sample]:
        """What has arrived since the last call, in the order of arrival."""
        while self._count / self._settings.rate_hz <= time_s:
            self._take(self._count / self._settings.rate_hz, person)
            self._count += 1
        arrived = []
        while self._on_the_way and self._on_the_way[0][0] <= time_s:
            arrived.append(heapq.heappop(self._on_the_way)[2])
        return arrived

    def _take(self, stamp_s: float, person: HumanOperator) -> None:
        """Sample the hand, and draw what becomes of the sample."""
        settings, random = self._settings, self._random
        # Every sample draws as many numbers, so that one fault does not shift the others.
        gap, burst, spike, identity, late, long = random.random(6)
        direction = random.normal(size=3)
        low, high = settings.gap_s
        if stamp_s >= self._lost_until_s and gap < settings.gap_probability:
            self._lost_until_s = stamp_s + low + (high - low) * long
        if stamp_s >= self._held_until_s and burst < settings.burst_probability:
            self._held_until_s = stamp_s + settings.burst_s
        if stamp_s < self._lost_until_s:
            return
        target = person.setpoint(stamp_s).target
        position, wxyz = target.position_m, target.wxyz
        if identity < settings.identity_probability:
            position, wxyz = _NOWHERE
        elif spike < settings.spike_probability:
            position = position + settings.spike_m * direction / np.linalg.norm(direction)
        arrives_s = max(stamp_s + settings.jitter_s * late, self._held_until_s)
        heapq.heappush(self._on_the_way, (arrives_s, self._count, Sample(stamp_s, position, wxyz)))

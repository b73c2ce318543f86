"""A live operator: samples from a device, as they come -> a target that never leaps.

Samples are offered from outside between ticks (a mouse, keys, a gamepad, a tracker); the filter
names what is wrong with them, and the reference governor takes the arm from where it is to where the
stream is, at limited speed, whatever the stream did in between.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.operators.samples import JumpRule, Sample, SampleFilter, Tolerances
from workcell.motion.path import standing
from workcell.motion.reference_governor import Caps, ReferenceGovernor
from workcell.motion.setpoint import VALID, Setpoint


class LiveOperator:
    """Follows what is offered; keeps the start pose until something is."""

    def __init__(
        self,
        settings: scenario.Live | scenario.Stream,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        period_s: float,
    ):
        self._filter = SampleFilter(
            Tolerances(
                stale_s=settings.stale_s,
                late_s=settings.late_s,
                frozen_s=settings.frozen_s,
                unit=scenario.UNIT_QUATERNION_TOLERANCE,
            ),
            JumpRule(settings),
        )
        self._governor = ReferenceGovernor(Caps.of(settings), position_m, wxyz, period_s=period_s)
        self.start = standing(position_m, wxyz)
        """The pose kept until the first sample."""
        self._came: deque[Sample] = deque()

    def offer(self, sample: Sample) -> None:
        """Hand in a sample; it is judged at the next tick."""
        self._came.append(sample)

    def setpoint(self, time_s: float) -> Setpoint:
        worst = VALID
        while self._came:
            verdict = self._filter.judge(time_s, self._came.popleft())
            # Of several samples in one tick a bad one is named even where a good one follows.
            worst = verdict if verdict != VALID else worst
        sample, state = self._filter.state(time_s)
        state = worst if state == VALID else state
        if sample is None:
            wanted = self.start
        else:
            # A sample within the tolerance is normalised; one that is exact stays so.
            norm = float(np.linalg.norm(sample.wxyz))
            wanted = standing(sample.position_m, sample.wxyz / norm)
        target, state = self._governor.follow(wanted, state)
        return Setpoint(target, "live", state)

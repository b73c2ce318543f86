"""A stream of pose samples -> the last one that can be trusted, and the name of what is wrong.

Samples come with the time they were taken, whenever they come. Each is judged the tick it arrives
and dropped if it is late, out of order, repeated, not finite, not a rotation, or farther from the
last good one than a hand can move; a stream that stops or freezes is noticed after a stated time.
Whatever is wrong, the pose handed on is the last good one: this filter never extrapolates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell.motion.orientation import rotation_between
from workcell.motion.setpoint import (
    FROZEN,
    JUMP,
    LATE,
    NOT_FINITE,
    NOT_UNIT,
    OUT_OF_ORDER,
    REPEATED,
    STALE,
    VALID,
    WAITING,
)

HAND_SPEED_M_S = 2.0
HAND_TURN_RAD_S = 10.0
"""Faster than anybody steers a tool on purpose; chosen several times the fastest working motion."""


@dataclass(frozen=True)
class Sample:
    """One sample of a stream."""

    stamp_s: float
    """When it was taken, on the clock of the run."""
    position_m: NDArray[np.float64]
    """(3,)"""
    wxyz: NDArray[np.float64]
    """(4,)"""


@dataclass(frozen=True)
class Tolerances:
    """What a stream may do before it is at fault, and so how soon a fault is noticed."""

    stale_s: float
    """Time without a sound sample after which the stream counts as stopped."""
    late_s: float
    """Age at arrival beyond which a sample is dropped."""
    frozen_s: float
    """Time of exactly equal poses after which the stream counts as frozen; 0 never does."""
    jump_m: float
    jump_rad: float
    """Leap, beyond what a hand moves in the time between, from which a sample is dropped."""
    jump_confirm_s: float
    """Time after which a stream that stays where it leapt to is believed."""
    unit: float
    """How far the norm of a quaternion may be off 1."""


class SampleFilter:
    """Judges a stream, tick by tick.

    Args:
        tolerances: What it may do.
    """

    def __init__(self, tolerances: Tolerances):
        self._tolerances = tolerances
        self._good: Sample | None = None
        self._newest_s = -np.inf
        self._arrived_s = 0.0
        """When the last sound sample came."""
        self._moved_s = 0.0
        """When the pose was last different from the one before."""
        self._fault = ""
        self._leapt: Sample | None = None
        """Where the stream seems to have leapt to, while this is not believed."""
        self._leapt_s = 0.0

    def take(self, now_s: float, sample: Sample) -> str:
        """Judge one sample at the time it arrives; returns `valid` or the name of its fault."""
        fault = self._judge(now_s, sample)
        self._fault = "" if fault == VALID else fault
        if fault == VALID:
            good = self._good
            if good is None or not (
                np.array_equal(good.position_m, sample.position_m)
                and np.array_equal(good.wxyz, sample.wxyz)
            ):
                self._moved_s = now_s
            self._good, self._arrived_s, self._leapt = sample, now_s, None
        return fault

    def look(self, now_s: float) -> tuple[Sample | None, str]:
        """The last good sample, None before the first, and the state of the stream."""
        if self._good is None:
            return None, self._fault or WAITING
        limits = self._tolerances
        if now_s - self._arrived_s > limits.stale_s:
            # What the samples that still come are dropped for says more than that none is good.
            return self._good, self._fault or STALE
        if limits.frozen_s > 0.0 and now_s - self._moved_s > limits.frozen_s:
            return self._good, FROZEN
        return self._good, self._fault or VALID

    def _judge(self, now_s: float, sample: Sample) -> str:
        limits = self._tolerances
        if not (
            np.isfinite(sample.stamp_s)
            and np.isfinite(sample.position_m).all()
            and np.isfinite(sample.wxyz).all()
        ):
            return NOT_FINITE
        if abs(float(np.linalg.norm(sample.wxyz)) - 1.0) > limits.unit:
            return NOT_UNIT
        if sample.stamp_s == self._newest_s:
            return REPEATED
        if sample.stamp_s < self._newest_s:
            return OUT_OF_ORDER
        passed_s = sample.stamp_s - self._newest_s if self._good is not None else 0.0
        self._newest_s = sample.stamp_s
        if now_s - sample.stamp_s > limits.late_s:
            return LATE
        if self._good is not None and self._leaps(self._good, sample, passed_s):
            if self._leapt is None or self._leaps(self._leapt, sample, passed_s):
                self._leapt_s = now_s
            self._leapt = sample
            if now_s - self._leapt_s < limits.jump_confirm_s:
                return JUMP
        return VALID

    def _leaps(self, before: Sample, sample: Sample, passed_s: float) -> bool:
        """Whether a sample is farther off than a hand moves in the time since the last sample of any kind."""
        limits = self._tolerances
        return bool(
            np.linalg.norm(sample.position_m - before.position_m)
            > limits.jump_m + HAND_SPEED_M_S * passed_s
            or np.linalg.norm(rotation_between(before.wxyz, sample.wxyz))
            > limits.jump_rad + HAND_TURN_RAD_S * passed_s
        )

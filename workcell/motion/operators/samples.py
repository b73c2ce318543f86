"""A stream of pose samples -> the last one that can be trusted, and the name of what is wrong.

A sample carries the time at which it was taken. It is judged at the tick at which it arrives, and
dropped if it is late, out of order, repeated, not finite, not a rotation, or farther from the last
good one than a hand can move. A stream that stops or freezes is noticed after a stated time. In
every case the pose handed on is the last good one: this filter never extrapolates. The rule for
jumps serves recordings too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.orientation import rotation_between
from workcell.motion.path import length
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
LARGEST_M = 1000.0
"""A coordinate beyond this is no place in a cell: chosen far beyond any cell, and far below where arithmetic overflows."""


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
    unit: float
    """How far the norm of a quaternion may be off 1."""


class JumpRule:
    """Whether a sample is where a hand could be; one rule for live streams and recordings.

    A sample jumps if it is farther from the last good one than `jump_m` (`jump_rad`) plus what a hand
    moves in the time since the last sample of any kind. It is believed once the stream has stayed at
    the new place for `jump_confirm_s`.

    Args:
        settings: Of the operator.
    """

    def __init__(self, settings: scenario.Recording | scenario.Live | scenario.Stream):
        self._settings = settings
        self._jumped: Sample | None = None
        """The newest sample of the new place, while it is not believed."""
        self._since_s = 0.0
        """When the stream came to the new place."""

    def believes(self, good: Sample | None, sample: Sample, *, passed_s: float) -> bool:
        """Judge the next sample; asked once for each, in the order of their times.

        Args:
            good: The last sample that was believed, None before the first.
            sample: The next one.
            passed_s: Time since the sample before it, believed or not.
        """
        if good is None or not self._jumps(good, sample, passed_s):
            self._jumped = None
            return True
        if self._jumped is None or self._jumps(self._jumped, sample, passed_s):
            self._since_s = sample.stamp_s
        self._jumped = sample
        if sample.stamp_s - self._since_s < self._settings.jump_confirm_s:
            return False
        self._jumped = None
        return True

    def _jumps(self, before: Sample, sample: Sample, passed_s: float) -> bool:
        limits = self._settings
        return (
            length(sample.position_m - before.position_m)
            > limits.jump_m + HAND_SPEED_M_S * passed_s
            or length(rotation_between(before.wxyz, sample.wxyz))
            > limits.jump_rad + HAND_TURN_RAD_S * passed_s
        )


class SampleFilter:
    """Judges a stream, tick by tick.

    Args:
        tolerances: What it may do.
        jumps: What counts as a jump, and when it is believed.
    """

    def __init__(self, tolerances: Tolerances, jumps: JumpRule):
        self._tolerances = tolerances
        self._jumps = jumps
        self._good: Sample | None = None
        self._newest_s = -np.inf
        self._arrived_s = 0.0
        """When the last sound sample came."""
        self._moved_s = 0.0
        """When the pose was last different from the one before."""
        self._fault = ""

    def judge(self, now_s: float, sample: Sample) -> str:
        """Judge one sample at the time it arrives; returns `valid` or the name of its fault."""
        verdict = self._verdict(now_s, sample)
        self._fault = "" if verdict == VALID else verdict
        if verdict == VALID:
            good = self._good
            if good is None or not (
                np.array_equal(good.position_m, sample.position_m)
                and np.array_equal(good.wxyz, sample.wxyz)
            ):
                self._moved_s = now_s
            self._good, self._arrived_s = sample, now_s
        return verdict

    def state(self, now_s: float) -> tuple[Sample | None, str]:
        """The last good sample, None before the first, and the state of the stream."""
        if self._good is None:
            return None, self._fault or WAITING
        limits = self._tolerances
        if now_s - self._arrived_s > limits.stale_s:
            # Why the samples that still come are dropped says more than that none is good.
            return self._good, self._fault or STALE
        if limits.frozen_s > 0.0 and now_s - self._moved_s > limits.frozen_s:
            return self._good, FROZEN
        return self._good, self._fault or VALID

    def _verdict(self, now_s: float, sample: Sample) -> str:
        limits = self._tolerances
        values = [sample.stamp_s, *sample.position_m.tolist(), *sample.wxyz.tolist()]
        if not all(math.isfinite(value) for value in values):
            return NOT_FINITE
        if max(abs(x) for x in sample.position_m.tolist()) > LARGEST_M:
            return NOT_FINITE
        if abs(length(sample.wxyz) - 1.0) > limits.unit:
            return NOT_UNIT
        if sample.stamp_s == self._newest_s:
            return REPEATED
        if sample.stamp_s < self._newest_s:
            return OUT_OF_ORDER
        passed_s = sample.stamp_s - self._newest_s if self._good is not None else 0.0
        self._newest_s = sample.stamp_s
        if now_s - sample.stamp_s > limits.late_s:
            return LATE
        return VALID if self._jumps.believes(self._good, sample, passed_s=passed_s) else JUMP

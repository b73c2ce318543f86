"""From a person's input to the first motion of the arm, on the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

STILL_M_S = 5e-3
"""A tool slower than this stands; chosen above what self-motion and servo lag leave of a standing tool."""
MOVING_M_S = 8e-3
"""A tool faster than this has been set in motion; at the operator's usual acceleration, 4 ms after its start."""
GIVE_UP_S = 2.0
"""An input that has moved nothing by then has met a limit: it has no latency."""


@dataclass(frozen=True)
class InputLatency:
    """Of the inputs that set a standing arm in motion; None where there was none."""

    count: int
    median_s: float | None
    p99_s: float | None


class LatencyMeter:
    """Takes the time from inputs to motions. `begin` may be called from any thread.

    Args:
        clock: Replaced in tests.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter):
        self._clock = clock
        self._since_s: float | None = None
        self._still = True
        self._took_s: list[float] = []

    def begin(self) -> None:
        """An input has come; only the first one while the arms stand counts."""
        if self._still and self._since_s is None:
            self._since_s = self._clock()

    def observe(self, speed_m_s: float) -> None:
        """One look at the fastest driven tool."""
        since_s, now_s = self._since_s, self._clock()
        self._still = speed_m_s < STILL_M_S
        if since_s is None:
            return
        if speed_m_s > MOVING_M_S:
            self._took_s.append(now_s - since_s)
            self._since_s = None
        elif now_s - since_s > GIVE_UP_S:
            self._since_s = None

    def summary(self) -> InputLatency:
        """All so far."""
        if not self._took_s:
            return InputLatency(0, None, None)
        median, p99 = np.percentile(self._took_s, (50, 99))
        return InputLatency(len(self._took_s), float(median), float(p99))

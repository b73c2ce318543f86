"""How long the final check's answers took, for the summary of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Of one measured time. All NaN-free: None stands for a run without any answer."""

    median_s: float | None
    """Half of the values are below, s."""
    p99_s: float | None
    """99 % of the values are below, s."""
    worst_s: float | None
    """The largest value, s."""


@dataclass(frozen=True)
class Latency:
    """Times of all answered requests of a run; wall clock, but for the hand-over."""

    answers: int
    """How many requests were answered."""
    round_trip: Spread
    """From handing over a configuration to having its verdict."""
    compute: Spread
    """The checker's own part of that."""
    handover: Spread
    """The asking process's own part, writing the request and reading the answer: processor time
    of its thread, so that being preempted by the checker it wakes does not count as work."""


class LatencyLog:
    """Collects the times; `summary` may be asked at any moment."""

    def __init__(self) -> None:
        self._round_trip_s: list[float] = []
        self._compute_s: list[float] = []
        self._handover_s: list[float] = []
        self._posting_s = 0.0

    def posted(self, duration_s: float) -> None:
        """A request was handed over."""
        self._posting_s = duration_s

    def answered(self, round_trip_s: float, compute_s: float, reading_s: float) -> None:
        """The answer to the request last handed over was read."""
        self._round_trip_s.append(round_trip_s)
        self._compute_s.append(compute_s)
        self._handover_s.append(self._posting_s + reading_s)

    def summary(self) -> Latency:
        """Figures over everything collected so far."""
        return Latency(
            answers=len(self._round_trip_s),
            round_trip=_spread(self._round_trip_s),
            compute=_spread(self._compute_s),
            handover=_spread(self._handover_s),
        )


def _spread(values_s: list[float]) -> Spread:
    if not values_s:
        return Spread(None, None, None)
    median_s, p99_s, worst_s = np.percentile(values_s, [50.0, 99.0, 100.0])
    return Spread(float(median_s), float(p99_s), float(worst_s))

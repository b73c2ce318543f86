"""What follows when the final check says stop: brake along the path, hold, stay so until reset.

A verdict goes in, joint velocities that come to rest within the joints' acceleration limits come
out, and a report of how the stop went. Braking is one factor on the whole joint velocity,
q̇' = k q̇ with the smallest k that no joint's limit forbids, so the direction of motion is kept.
Theory, section 7: the halt should find an arm that is nearly standing; the report says whether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell.guard.verdict import CheckState, Verdict

# A joint velocity below this counts as standing, rad/s or m/s: a tenth of what moves the tip of
# a 1 m arm by one micrometre per millisecond.
STANDING_RAD_S = 1e-4


@dataclass(frozen=True)
class HaltReport:
    """How one stop went."""

    state: CheckState
    """Why it was called for."""
    reason: str
    """The verdict's sentence."""
    pair: tuple[str, str] | None
    """The pieces that were too near, if it was that."""
    distance_m: float | None
    """Their distance at the verdict, m."""
    tick: int
    """Control tick at which the latch fell."""
    age_ticks: int
    """How old the checked configuration was then: the latency of the halt."""
    speed_m_s: dict[str, float]
    """Of each stopped arm's tool when the latch fell, m/s."""
    stopping_distance_m: dict[str, float]
    """Path length of each tool from then until it stood, m; so far, if it moves still."""
    stopping_time_s: dict[str, float | None]
    """Time from then until every joint of the arm stood, s; None if it moves still."""


class HaltLatch:
    """Remembers the first verdict that called for a stop until it is reset. No clock, no process.

    Args:
        period_s: Length of one control tick, s.
    """

    def __init__(self, period_s: float):
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """Releases the latch and forgets the stop."""
        self._cause: Verdict | None = None
        self._tick = -1
        self._speed_m_s: dict[str, float] = {}
        self._way_m: dict[str, float] = {}
        self._time_s: dict[str, float | None] = {}

    @property
    def latched(self) -> bool:
        """True from the first verdict that calls for a stop until `reset`."""
        return self._cause is not None

    @property
    def cause(self) -> Verdict | None:
        """The verdict that called for the stop."""
        return self._cause

    def trip(self, verdict: Verdict, tick: int) -> bool:
        """Shows the latch a verdict; the first that calls for a stop counts. Returns `latched`."""
        if self._cause is None and verdict.must_stop:
            self._cause, self._tick = verdict, tick
        return self.latched

    def observe(
        self, tick: int, arm: str, tool_speed_m_s: float, qvel_rad_s: NDArray[np.float64]
    ) -> None:
        """Takes note of one arm's measured motion, on every tick while latched.

        Args:
            tick: Control tick.
            arm: Name of an arm that is being stopped.
            tool_speed_m_s: Speed of its tool, m/s.
            qvel_rad_s: (n,) velocities of its joints.
        """
        if self._cause is None:
            return
        if arm not in self._speed_m_s:
            self._speed_m_s[arm] = tool_speed_m_s
            self._way_m[arm] = 0.0
            self._time_s[arm] = None
        if self._time_s[arm] is None:
            if np.all(np.abs(qvel_rad_s) <= STANDING_RAD_S):
                self._time_s[arm] = (tick - self._tick) * self._period_s
            else:
                self._way_m[arm] += tool_speed_m_s * self._period_s

    def report(self) -> HaltReport | None:
        """The stop so far; None while nothing has called for one."""
        if self._cause is None:
            return None
        return HaltReport(
            state=self._cause.state,
            reason=self._cause.reason,
            pair=self._cause.pair,
            distance_m=self._cause.distance_m,
            tick=self._tick,
            age_ticks=self._tick - self._cause.tick if self._cause.tick >= 0 else 0,
            speed_m_s=dict(self._speed_m_s),
            stopping_distance_m=dict(self._way_m),
            stopping_time_s=dict(self._time_s),
        )


def brake(
    command_rad_s: NDArray[np.float64], acceleration_rad_s2: NDArray[np.float64], period_s: float
) -> NDArray[np.float64]:
    """The next joint velocity (n,) on the way to rest, in the direction of the last one.

    Args:
        command_rad_s: (n,) the velocity commanded last.
        acceleration_rad_s2: (n,) each joint's limit, above 0.
        period_s: Length of one control tick, s.

    Raises:
        ValueError: If a velocity is not finite or a limit is not above 0; names the joint's index.
    """
    bad = np.flatnonzero(~np.isfinite(command_rad_s))
    if len(bad):
        raise ValueError(f"command_rad_s{bad.tolist()} is not finite")
    bad = np.flatnonzero(~(acceleration_rad_s2 > 0.0))
    if len(bad):
        raise ValueError(f"acceleration_rad_s2{bad.tolist()} must be above 0")
    # One tick takes at most a_j dt from joint j, and from all of them the same share: the joint
    # that can give up the smallest share of its speed decides.
    speed = np.abs(command_rad_s)
    fastest = speed > STANDING_RAD_S
    if not fastest.any():
        return np.zeros_like(command_rad_s)
    share = np.min(acceleration_rad_s2[fastest] * period_s / speed[fastest])
    return command_rad_s * max(0.0, 1.0 - float(share))


def braking_time_s(
    command_rad_s: NDArray[np.float64], acceleration_rad_s2: NDArray[np.float64]
) -> float:
    """How long `brake` needs from a velocity (n,) to rest, s: max |q̇_j| / a_j."""
    return float(np.max(np.abs(command_rad_s) / acceleration_rad_s2, initial=0.0))

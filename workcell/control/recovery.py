"""The recovery state machine: when a support arm yields, and what it tries against an impasse.

    yield     another arm's own motion brings a pair below t_min even if this arm stands
              (entered at once, left YIELD_LINGER_S after the last such tick)
    impasse   the path's clock has stood for IMPASSE_S in all, yielding aside, since it was last ahead of
              where it had been: attempts in turn to get past (self-motion with the path stopped, free the
              tool's rotation, push the elbow to either side, back off, come in from another side), each
              for ATTEMPT_S or until the path goes on; before them, where the tool may leave its path, a
              detour for as long as the path goes on by it
    hold      every attempt is used up: stand and wait; motion resumes when the way is free

The machine looks at numbers only and keeps no geometry; the strategy turns its state into motion.
"""

from __future__ import annotations

from typing import NamedTuple

YIELD_LINGER_S = 0.2
"""How long a yielding arm keeps out of the way after the need has passed; chosen so that a hand that
trembles or stops for a moment does not make the arm start and stop with it."""
STANDSTILL_FACTOR = 0.02
"""Rate of the path's clock below which it stands: at 0.15 m/s, 3 mm/s. Whether a small factor, a tool that is
off its path or a target out of reach holds it makes no difference."""
IMPASSE_S = 2.0
"""How long a standstill lasts before it is called an impasse; chosen as what a person waits before asking."""
DETOUR_S = 0.5
"""The same where the tool may leave its path; chosen above the time in which a speed scale rises again."""
ATTEMPT_S = 3.0
"""How long each attempt may take; chosen as twice the time an elbow needs to swing by 0.3 m."""
PROGRESS_S = 0.3
"""Advance of the path's clock that ends an impasse."""
PAUSED_SHARE = 0.5
"""First part of an attempt in which the path stands still, so that self-motion alone is not slowed by it."""
DETOUR = "detour"
"""The attempt in which the tool leaves its path; first, because who allows it does not want to wait."""
ATTEMPTS = ("self_motion", "free_rotation", "elbow_left", "elbow_right", "back_off", "re_enter")


class RecoveryState(NamedTuple):
    """The machine's state in a tick."""

    yielding: bool
    """Whether the arm gives way now."""
    attempt: str
    """What is tried against an impasse now, `DETOUR` or one of `ATTEMPTS`; empty if nothing is."""
    paused: bool
    """Whether the path stands still while self-motion is tried."""
    impasse: bool
    """Whether an impasse has been reported and not resolved."""


class Recovery:
    """The machine of one support arm.

    Args:
        period_s: Control period.
        yields: Whether the arm yields at all.
        resolves: Whether impasses are resolved.
        detours: Whether the tool may leave its path for that.
    """

    def __init__(
        self,
        *,
        period_s: float,
        yields: bool = True,
        resolves: bool = True,
        detours: bool = False,
    ):
        self._attempts = (DETOUR, *ATTEMPTS) if detours else ATTEMPTS
        self._period_s = period_s
        self._yields = yields
        self._resolves = resolves
        self._linger_s = 0.0
        self.restart()

    def restart(self) -> None:
        """Another job: whatever stood in the way of the one before does not count."""
        self._stuck_s = 0.0
        self._attempt = -1
        self._attempt_s = 0.0
        self._before_s = 0.0
        self._clock_s = 0.0
        self._farthest_s = 0.0

    def replanned(self) -> None:
        """Another path of the same job, whose clock starts from 0: what was won so far stays won."""
        self._before_s += self._clock_s
        self._clock_s = 0.0

    def advance(
        self,
        *,
        must_yield: bool,
        clock_s: float,
        moving: bool,
        out_of_reach: bool = False,
        on_path: bool = True,
    ) -> RecoveryState:
        """One tick.

        Args:
            must_yield: Another arm's own motion brings a pair below t_min even if this arm stands.
            clock_s: The path's clock.
            moving: Whether the job wants motion at all (a waiting arm is never at an impasse).
            out_of_reach: The tool stays off its path though no pair holds it: self-motion is no way out.
            on_path: Whether the tool is back at its path; a detour ends there and nowhere else.
        """
        self._linger_s = YIELD_LINGER_S if must_yield else max(0.0, self._linger_s - self._period_s)
        yielding = self._yields and self._linger_s > 0.0
        stands = clock_s - self._clock_s < STANDSTILL_FACTOR * self._period_s
        self._clock_s = clock_s
        if not moving or not self._resolves:
            self._stuck_s = 0.0
            return RecoveryState(yielding, "", False, False)
        ahead_s = self._before_s + clock_s - self._farthest_s
        detouring = self._attempt == 0 and self._attempts[0] == DETOUR
        if self._attempt < 0:
            if not stands and ahead_s > 0.0:
                self._stuck_s, self._farthest_s = 0.0, self._before_s + clock_s
            elif stands and not yielding:
                self._stuck_s += self._period_s
            if self._stuck_s >= (DETOUR_S if self._attempts[0] == DETOUR else IMPASSE_S):
                self._attempt = self._attempts.index("back_off") if out_of_reach else 0
                self._attempt_s = 0.0
        elif ahead_s >= PROGRESS_S and (on_path or not detouring):
            self._stuck_s, self._attempt = 0.0, -1
            self._farthest_s = self._before_s + clock_s
        elif detouring and not stands:
            self._attempt_s = 0.0
        elif detouring or not yielding:
            self._attempt_s += self._period_s
            if self._attempt_s >= ATTEMPT_S:
                self._attempt, self._attempt_s = self._attempt + 1, 0.0
        trying = 0 <= self._attempt < len(self._attempts)
        attempt = self._attempts[self._attempt] if trying else ""
        paused = (
            trying
            and attempt not in (DETOUR, "back_off", "re_enter")
            and self._attempt_s < PAUSED_SHARE * ATTEMPT_S
        )
        return RecoveryState(yielding, attempt, paused, self._attempt >= 0)

"""What a support arm does when slowing down is not enough: the rungs, and when each is entered and left.

    run       nothing limits the arm
    scale     the pairwise rule slows it down             (factor below 1)
    yield     another arm's own motion brings a pair below t_min even if this arm stands:
              back up along the path, else move so that the near pairs open
              (entered at once, left YIELD_LINGER_S after the last such tick)
    impasse   scaled down to a standstill for IMPASSE_S without progress: attempts in turn to get
              past (self-motion with the path stopped, free the tool's rotation, push the elbow to either side, back off, come in from another side), each for
              ATTEMPT_S or until the path goes on
    hold      every attempt is used up: stand and wait; motion resumes when the way is free
    halt      d <= d_min, or the final check's verdict

The ladder looks at numbers only and keeps no geometry; the controller turns its answer into motion.
"""

from __future__ import annotations

from dataclasses import dataclass

YIELD_LINGER_S = 0.2
"""How long a yielding arm keeps out of the way after the need has passed; chosen so that a hand that
trembles or stops for a moment does not make the arm start and stop with it."""
STANDSTILL_FACTOR = 0.02
"""Factor below which an arm makes no progress worth the name: at 0.15 m/s, 3 mm/s."""
IMPASSE_S = 2.0
"""How long a standstill lasts before it is called an impasse; chosen as what a person waits before asking."""
ATTEMPT_S = 3.0
"""How long each attempt may take; chosen as twice the time an elbow needs to swing by 0.3 m."""
PROGRESS_S = 0.3
"""Advance of the path's clock that ends an impasse."""
PAUSED_SHARE = 0.5
"""First part of an attempt in which the path stands still, so that self-motion alone is not slowed by it."""
ATTEMPTS = ("self_motion", "free_rotation", "elbow_left", "elbow_right", "back_off", "re_enter")


@dataclass(frozen=True)
class Rung:
    """The ladder's answer for a tick."""

    yielding: bool
    """Whether the arm gives way now."""
    attempt: str
    """What is tried against an impasse now, one of `ATTEMPTS`; empty if nothing is."""
    paused: bool
    """Whether the path stands still while self-motion is tried."""
    impasse: bool
    """Whether an impasse has been reported and not resolved."""


class Ladder:
    """The state of one support arm.

    Args:
        period_s: Control period.
        yields: Whether the yield rung is used at all.
        resolves: Whether impasses are resolved.
    """

    def __init__(self, *, period_s: float, yields: bool = True, resolves: bool = True):
        self._period_s = period_s
        self._yields = yields
        self._resolves = resolves
        self._linger_s = 0.0
        self.restart()

    def restart(self) -> None:
        """A new path: whatever stood in the way of the old one does not count."""
        self._stuck_s = 0.0
        self._attempt = -1
        self._attempt_s = 0.0
        self._clock_s = 0.0

    def climb(self, *, pressed: bool, factor: float, clock_s: float, moving: bool) -> Rung:
        """Decide the rung.

        Args:
            pressed: Another arm's own motion brings a pair below t_min even if this arm stands.
            factor: The factor the pairwise rule allows now.
            clock_s: The path's clock.
            moving: Whether the job wants motion at all (a waiting arm is never at an impasse).
        """
        self._linger_s = YIELD_LINGER_S if pressed else max(0.0, self._linger_s - self._period_s)
        yielding = self._yields and self._linger_s > 0.0
        if not moving or not self._resolves:
            self._stuck_s = 0.0
            return Rung(yielding, "", False, False)
        if self._attempt < 0:
            stuck = factor < STANDSTILL_FACTOR and not yielding
            self._stuck_s = self._stuck_s + self._period_s if stuck else 0.0
            if self._stuck_s >= IMPASSE_S:
                self._attempt, self._attempt_s, self._clock_s = 0, 0.0, clock_s
        elif clock_s >= self._clock_s + PROGRESS_S:
            self.restart()
        else:
            self._attempt_s += self._period_s
            if self._attempt_s >= ATTEMPT_S:
                self._attempt, self._attempt_s = self._attempt + 1, 0.0
        trying = 0 <= self._attempt < len(ATTEMPTS)
        attempt = ATTEMPTS[self._attempt] if trying else ""
        paused = (
            trying
            and attempt not in ("back_off", "re_enter")
            and self._attempt_s < PAUSED_SHARE * ATTEMPT_S
        )
        return Rung(yielding, attempt, paused, self._attempt >= 0)

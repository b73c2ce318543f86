"""How much of a wanted joint velocity an arm may have (docs/theory.md section 5).

In: distances of the watched pairs and the two parts of their rates, a from the arm that is
scaled, b from everything else. Out: the largest factor s in [0, 1] that keeps every time to
collision at t_min or above, d + t_min (s a + b) >= 0; for b = 0 that is paper equation 16. A
governor then bounds how fast the factor rises and respects what the joints can accelerate.
The factor applies to the arm's whole joint velocity, null-space part included. The arithmetic is
`laws.speed_scale`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import alike, finite
from workcell.control.laws import speed_scale as laws
from workcell.errors import WorkcellError

Array = NDArray[np.float64]

Limiter = Literal["none", "ttc", "rise", "acceleration", "braking", "infeasible"]


class ScaleBound(NamedTuple):
    """What the times to collision allow."""

    factor: float
    """Largest allowed factor, in [0, 1]."""
    pair: int
    """Index of the pair that sets the factor; -1 when the full velocity is allowed."""
    required: float
    """The factor before clamping: negative asks to back up, infinite when no pair limits it.

    Minus infinite where a pair cannot be held by any speed along this direction.
    """
    shortfall_m_s: float
    """Opening rate still missing at `factor` in the worst pair, >= 0.

    Positive means that slowing is not enough and the arm must give way.
    """
    shortfall_pair: int
    """Index of that pair; -1 when nothing is missing."""


class AccelerationInterval(NamedTuple):
    """Factors that the joints can reach within one period."""

    lowest: float
    """Smallest reachable factor in [0, 1]: below it the joints cannot brake."""
    highest: float
    """Largest reachable factor in [0, 1]."""
    feasible: bool
    """False when no factor respects all limits; both bounds are then the least violating one."""


class FactorChoice(NamedTuple):
    """The factor that is granted, and why it is not larger."""

    factor: float
    """In [0, 1]."""
    limiter: Limiter
    """What set the factor.

    "none": the full velocity; "ttc": the times to collision; "rise": the bound on its rise;
    "acceleration": the joints cannot speed up faster; "braking": the times to collision ask for
    less, but the joints cannot brake faster; "infeasible": no factor respects the joints' limits.
    """


def pairwise_factor(
    distance_m: ArrayLike,
    rate_own_m_s: ArrayLike,
    rate_other_m_s: ArrayLike,
    t_min_s: float,
    *,
    standoff_m: float = 0.0,
) -> ScaleBound:
    """Largest factor s in [0, 1] with distance - standoff + t_min (s own + other) >= 0 everywhere.

    Pairs that the arm itself opens (own >= 0) never limit it. Where no s in [0, 1] holds a pair,
    s is 0 for the pairs it closes and the lack is reported as `shortfall_m_s`.

    Args:
        distance_m: Surface distances (P,), P may be 0.
        rate_own_m_s: a (P,): the rates that the wanted velocity of the scaled arm causes.
        rate_other_m_s: b (P,) or a number: the rates that all else causes.
        t_min_s: Smallest time to collision to keep, > 0.
        standoff_m: Distance to which the time is counted, >= 0.

    Raises:
        WorkcellError: An input is not finite, or t_min or standoff is out of range.
    """
    _require_positive("t_min_s", t_min_s)
    if not 0.0 <= standoff_m < np.inf:
        raise WorkcellError(f"standoff_m is {standoff_m}; must be a finite number >= 0")
    distance, own, other = alike(
        finite("distance_m", distance_m),
        finite("rate_own_m_s", rate_own_m_s),
        finite("rate_other_m_s", rate_other_m_s),
    )
    return ScaleBound(*laws.pairwise_factor(distance, own, other, t_min_s, standoff_m)[:5])


def slow_near(distance_m: ArrayLike, stop_m: float, slow_m: float) -> ScaleBound:
    """The plain rule to compare with: slow down with the smallest distance, whatever moves where.

    The factor falls linearly from 1 at `slow_m` to 0 at `stop_m`. It takes no velocity into
    account, so it brakes an arm that leaves as well as one that comes.

    Args:
        distance_m: Surface distances (P,), P may be 0.
        stop_m: Distance at which the arm stands.
        slow_m: Distance from which it slows down, above `stop_m`.

    Raises:
        WorkcellError: An input is not finite, or `slow_m` is not above `stop_m`.
    """
    if not stop_m < slow_m < np.inf:
        raise WorkcellError(f"slow_m is {slow_m}; must be a finite number above stop_m = {stop_m}")
    distance = np.asarray(finite("distance_m", distance_m), order="C")
    return ScaleBound(*laws.slow_near(distance, stop_m, slow_m)[:5])


def acceleration_interval(
    previous_rad_s: ArrayLike, wanted_rad_s: ArrayLike, limit_rad_s2: ArrayLike, period_s: float
) -> AccelerationInterval:
    """Factors s in [0, 1] with |s wanted - previous| <= limit period in every joint.

    Where there is none (the wanted direction turned faster than the joints can follow, or a
    reversal is due), the factor with the least relative violation, max |s wanted - previous| /
    limit over the joints, is returned and marked.

    Args:
        previous_rad_s: Joint velocities (n,) commanded in the last period.
        wanted_rad_s: Unscaled joint velocities (n,).
        limit_rad_s2: Joint acceleration limits (n,) or a number, > 0.
        period_s: Control period, > 0.

    Raises:
        WorkcellError: An input is not finite or not positive where it must be.
    """
    _require_positive("period_s", period_s)
    previous, wanted, limit = alike(
        finite("previous_rad_s", previous_rad_s),
        finite("wanted_rad_s", wanted_rad_s),
        finite("limit_rad_s2", limit_rad_s2),
    )
    lowest, highest, feasible, bad = laws.acceleration_interval(previous, wanted, limit, period_s)
    if bad >= 0:
        raise WorkcellError(f"limit_rad_s2 is {limit.tolist()}; every entry must be > 0")
    return AccelerationInterval(lowest, highest, feasible)


class FactorGovernor:
    """Turns the bound of each tick into a factor that does not chatter.

    Switching witness points make the bound jump (docs/theory.md section 8), so the factor may
    rise only at a bounded rate; it falls as far as the joints can brake. It starts from 0: full
    velocity is granted step by step.

    Args:
        rise_per_s: Largest rise of the factor per second, > 0.
        period_s: Control period, > 0.
    """

    def __init__(self, *, rise_per_s: float, period_s: float):
        _require_positive("rise_per_s", rise_per_s)
        _require_positive("period_s", period_s)
        self._rise = rise_per_s * period_s
        self._previous = 0.0

    @property
    def previous(self) -> float:
        """The factor granted last, in [0, 1]."""
        return self._previous

    def reset(self) -> None:
        """Start from 0 again, as after a halt."""
        self._previous = 0.0

    def resume(self, factor: float) -> None:
        """Go on from a factor that was granted without being asked for here."""
        self._previous = factor

    def choose(
        self,
        ttc_factor: float,
        interval: AccelerationInterval | None = None,
        *,
        leaving: bool = False,
    ) -> FactorChoice:
        """Grant this tick's factor and remember it.

        The order of precedence: what the joints can brake (a smaller factor could not be
        followed anyhow), then the times to collision, the rise, what the joints can speed up.
        Where no factor respects the joints' limits, the smallest of all wishes is taken: a joint
        that lags a falling command is caught by its drive, an arm too fast by nothing.

        Args:
            ttc_factor: `ScaleBound.factor`, in [0, 1].
            interval: What the joints can reach; None leaves them out.
            leaving: No near pair closes: the factor may rise at once, as leaving must not be
                slowed.

        Raises:
            WorkcellError: The factor is not in [0, 1].
        """
        if not 0.0 <= ttc_factor <= 1.0:
            raise WorkcellError(f"ttc_factor is {ttc_factor}; must be in [0, 1]")
        factor, limiter = ttc_factor, "ttc" if ttc_factor < 1.0 else "none"
        if not leaving and self._previous + self._rise < factor:
            factor, limiter = self._previous + self._rise, "rise"
        if interval is not None:
            if interval.highest < factor:
                factor, limiter = interval.highest, "acceleration"
            if not interval.feasible:
                limiter = "infeasible"
            elif factor < interval.lowest:
                # Only asking for less than the bound is braking; a slow rise must not be
                # reported as the joints failing to keep a time to collision.
                limiter = "braking" if ttc_factor < interval.lowest else "acceleration"
                factor = interval.lowest
        self._previous = factor
        return FactorChoice(factor=factor, limiter=limiter)


def smallest_t_min(
    reaction_s: float,
    closing_speed_m_s: float,
    deceleration_m_s2: float,
    *,
    other_keeps_coming: bool,
) -> float:
    """Smallest t_min (s) that leaves room to brake (docs/theory.md section 5).

    reaction + c/(2a) against what stands; reaction + c/a when the other keeps coming until this
    arm stands. What the other does after that is not covered.

    Args:
        reaction_s: Control period plus latencies, >= 0.
        closing_speed_m_s: c, largest closing speed of the arm that brakes, >= 0.
        deceleration_m_s2: a, its deceleration along the closing direction, > 0.
        other_keeps_coming: Whether the other arm moves on meanwhile.
    """
    for name, value in (("reaction_s", reaction_s), ("closing_speed_m_s", closing_speed_m_s)):
        if not 0.0 <= value < np.inf:
            raise WorkcellError(f"{name} is {value}; must be a finite number >= 0")
    _require_positive("deceleration_m_s2", deceleration_m_s2)
    braking_s = closing_speed_m_s / deceleration_m_s2
    return reaction_s + (braking_s if other_keeps_coming else braking_s / 2.0)


def _require_positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise WorkcellError(f"{name} is {value}; must be a finite number > 0")

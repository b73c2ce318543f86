"""What the gate is given and what it answers: arrays and numbers, no model and no controller.

n joints, P pairs, E points that span the arm's own geoms, C corners of its links (docs/theory.md section 9).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workcell.control.laws import gate_box
from workcell.control.laws import gate_points as points

Array = NDArray[np.float64]
How = Literal["passed", "nearest", "towards_braking", "braking"]

BOUNDS = {
    gate_box.POSITION: "position",
    gate_box.SPEED: "speed",
    gate_box.ACCELERATION: "acceleration",
    gate_box.JERK: "jerk",
}
REASONS = ("not_finite", *BOUNDS.values(), "time_to_collision", "stop", "point_speed")
"""Why a command is replaced, in the order in which the gate looks."""


@dataclass(frozen=True, slots=True)
class JointLimits:
    """What the joints can do, each (n,); rad or m."""

    lower: Array
    """End stops, infinite where there is none."""
    upper: Array
    speed: Array
    """> 0, 1/s."""
    acceleration: Array
    """> 0, 1/s²: with which a joint brakes, too."""
    jerk: Array
    """> 0, 1/s³, or infinite."""


@dataclass(frozen=True, slots=True)
class JointState:
    """Where the joints are and what they were told, each (n,)."""

    position: Array
    """As measured."""
    last: Array
    """The last command."""
    last_change: Array
    """Its change from the one before, over the period; zero at the start."""
    ahead_low: Array
    """Smallest and largest displacement from the measured position before the next command acts, `ahead`."""
    ahead_high: Array


@dataclass(frozen=True, slots=True)
class GateRows:
    """One arm's pairs at a configuration: P pairs, E points that span the arm's own geoms, n joints."""

    pair: NDArray[np.intp]
    """(P,) number of each pair in the caller's list; what answers name."""
    distance_m: Array
    """(P,) d."""
    own: Array
    """(P, n) rows of G: the rate each joint gives the pair."""
    first: NDArray[np.intp]
    """(P + 1,) where the points of each pair begin."""
    order: NDArray[np.intp]
    """(P, n) joints that move the own geom against the other, from its tip on; -1 after the last."""
    rows: Array
    """(E, n) A: the rate each joint gives each point towards the other geom's plane."""
    levers: Array
    """(E, n) R: how far each joint moves each point."""
    low_m: Array
    """(E,) m: distance of each point from that plane."""
    jump: Array
    """(K, n) rates at the ends of near-parallel capsules, to which nearest points may jump (`laws.gate_ends`); K may be 0."""
    jump_farther_m: Array
    """(K,) how much farther away than the nearest points each end is."""
    jump_pair: NDArray[np.intp]
    """(K,) whose it is, of the P."""


@dataclass(frozen=True)
class GateLinks:
    """The corners of the arm's own geoms, C of them, whose speed is capped; fields as in `points.point_speeds`."""

    cdof: Array
    centre: Array
    geom_position: Array
    geom_rotation: Array
    geom: NDArray[np.intp]
    moves: NDArray[np.bool_]
    radius: Array
    local: Array

    def speeds_m_s(self, command: Array) -> Array:
        """(C,) largest speed about each corner."""
        out = np.empty(len(self.radius))
        points.point_speeds(command, *self._arrays, out)
        return out

    def gradient(self, corner: int, command: Array) -> Array:
        """(n,) of one of these speeds."""
        out = np.empty(len(command))
        points.speed_gradient(corner, command, *self._arrays, out)
        return out

    @cached_property
    def _arrays(
        self,
    ) -> tuple[Array, Array, Array, Array, NDArray[np.intp], NDArray[np.bool_], Array, Array]:
        return (
            self.cdof,
            self.centre,
            self.geom_position,
            self.geom_rotation,
            self.geom,
            self.moves,
            self.radius,
            self.local,
        )


@dataclass(frozen=True, slots=True)
class GateRules:
    """What the gate holds, for all pairs or pair by pair (P,)."""

    period_s: float
    t_min_s: float
    d_min_m: float = 0.0
    """Pairs this near or nearer may only open, but for those that are to meet."""
    standoff_m: float = 0.0
    """Distance to which times count, but for pairs that are to meet."""
    latency_s: float = 0.0
    """How much longer than a period a command acts before braking can: late actuation that `ahead` does not tell of."""
    point_speed_m_s: float = np.inf
    """Cap on the speed of any point of the arm."""
    hold_m: float = 0.0
    """Distance that a verified stop leaves at least: 0 holds off contact."""

    @property
    def reaction_s(self) -> float:
        """T_r: a command acts for a period before braking can."""
        return self.period_s + self.latency_s


@dataclass(frozen=True, slots=True)
class Gated:
    """The gate's answer."""

    command: Array
    """(n,) what goes to the servos."""
    how: How
    """`passed` unchanged, or what it was replaced by."""
    reasons: tuple[str, ...] = ()
    """Of `REASONS`, what the given command failed."""
    pair: int | None = None
    """The pair of the first failed pair rule, by the caller's number."""
    verified: bool = True
    """Whether the stop test passed; False only where braking was all that was left."""
    missed_pair: int | None = None
    """The pair whose rate rule is missed most by the answer; None where all are kept."""
    missed_m_s: float = 0.0
    """By how much its rate falls short."""
    speed_m_s: float | None = None
    """The fastest point, where it exceeds the cap all the same."""

    @property
    def replaced(self) -> bool:
        """Whether the command is another than the one given."""
        return self.how != "passed"

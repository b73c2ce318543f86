"""The watched pairs as a tick sees them, and what they allow to the motion of one arm.

    Watched   all pairs: distances, G = dd/dq, rates and the smallest time to collision
    Share     one arm's part of them: what the others cause, the program of its inverse kinematics,
              the factor that keeps every time to collision, whether a command keeps it

What is written here is the law, in NumPy; `compiled.py` does the same in compiled code where there is any.
Equations: docs/theory.md sections 2, 5 and 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mink
import numpy as np
from numpy.typing import NDArray

from workcell.control import criteria, ttc
from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import ArmIk, IkSolution
from workcell.control.proximity import Proximity
from workcell.control.scaling import (
    AccelerationInterval,
    ScaleBound,
    acceleration_interval,
    pairwise_factor,
    slow_near,
)
from workcell.control.ttc import SmallestTtc
from workcell.scenario import Control
from workcell.scene.addresses import ArmAddresses

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

TASK_SLACK_M_S = 1e-5
"""The tool task's own velocity is known up to its regularisation; without this slack it could seem to break the very
rows it defines. Ten micrometres a second is 0.1 % of the slowest closing speed that matters, d_min / t_min."""
AT_REST_M_S = 1e-4
"""Rates below this at d_min count as standing: an arm that starts to leave is first moved by the last digits of its
tool error, which may point either way, and must not be held for that."""
PRESSED_M_S = 1e-3
"""Opening rate another arm's motion must leave missing before this arm gives way; above servo noise, below any intent."""
PRESSED_MEETING_M_S = 0.03
"""The same for what is meant to meet, where a hand is near that trembles: 0.1 mm at 10 Hz move at up to 20 mm/s."""

WAYS = 3
"""Velocities that an arm may count on another arm to have: what it was last commanded, what is asked of it, and what its
joint limits let through of that."""


@dataclass(slots=True)
class Rates:
    """What a joint velocity of the whole cell does to the pairs."""

    rate_m_s: Array
    """ḋ = G q̇ (P,)."""
    first: SmallestTtc
    """The smallest time to collision among the pairs that count."""
    nearest: int | None
    """The pair of those that is nearest now; None in a cell without pairs."""
    cause: int | None
    """Which arm, by its number, closes the first pair most; None where nothing closes."""


@dataclass(slots=True)
class Allowance:
    """What pairs and joints leave of the velocity an arm wants."""

    bound: ScaleBound
    """By the times to collision; its pairs are numbered among those the arm answers for."""
    pressed: bool
    """Whether standing is not enough for a pair that the arm can do something about."""
    reach: AccelerationInterval
    """By the joints' acceleration."""


class Watched:
    """What a tick knows of all watched pairs.

    Args:
        pairs: P, how many.
        dofs: Of each arm, indices into the cell's joint velocities.
        nv: Joint velocities of the cell.
    """

    def __init__(self, pairs: int, dofs: list[Indices], nv: int):
        self.distance_m = np.zeros(pairs)
        """d (P,)."""
        self.jacobian = np.zeros((pairs, nv))
        """G = dd/dq (P, nv), instruments moved by who holds them."""
        self.rate_m_s = np.zeros(pairs)
        """ḋ (P,) at the measured velocities."""
        self.accel_m_s2: Array | None = None
        """d̈ (P,) where second-order times are asked for."""
        self.silent = np.zeros(pairs, dtype=bool)
        """(P,) pairs that do not count now: an instrument against the hand that holds it."""
        self.ways_rad_s = np.zeros((WAYS, nv))
        """(WAYS, nv) what each arm may be counted on to do in this tick."""
        self._dofs = dofs

    def take(self, proximity: Proximity, jacobian: Array) -> None:
        """Take this tick's distances and G."""
        self.distance_m[...], self.jacobian[...] = proximity.distance_m, jacobian

    def share(
        self, ik: ArmIk, configuration: mink.Configuration, pairs: ArmPairs, *, support: bool
    ) -> Share:
        """One arm's part."""
        return Share(self, ik, configuration, pairs, support=support)

    def rates(self, velocity_rad_s: Array, accel_m_s2: Array | None = None) -> Rates:
        """What a velocity (nv,) of all joints does; with d̈ (P,) the times are of second order.

        Raises:
            WorkcellError: a number is not finite.
        """
        distance, rate = self.distance_m, self.jacobian @ velocity_rad_s
        kappa = (
            ttc.reciprocal_first_order(distance, rate)
            if accel_m_s2 is None
            else ttc.reciprocal_second_order(distance, rate, accel_m_s2)
        )
        if not len(rate):
            return Rates(rate, ttc.smallest(kappa), None, None)
        first = ttc.smallest(np.where(self.silent, 0.0, kappa))
        nearest = int(np.where(self.silent, np.inf, distance).argmin())
        cause = None
        if first.pair >= 0:
            row = self.jacobian[first.pair]
            cause = int(np.argmin([row[dofs] @ velocity_rad_s[dofs] for dofs in self._dofs]))
        return Rates(rate, first, nearest, cause)


@dataclass(frozen=True)
class ArmPairs:
    """Which pairs concern an arm; replaced when an instrument changes hands."""

    moved: Indices
    """Pairs that its motion changes."""
    averaged: Indices
    """The arm against its surroundings: the M N pairs of the criterion. Self pairs are watched but not averaged."""
    owned: Indices
    """Pairs that it answers for by slowing down."""
    standing: NDArray[np.bool_]
    """For each of these, whether it is with the arm's own base, which only another arm can come near."""


class Share:
    """One arm's part of the watched pairs; R is the number of those it answers for, n that of its joints.

    Args:
        watched: All pairs.
        ik: The arm's inverse kinematics.
        configuration: The controller's belief.
        pairs: Which concern this arm.
        support: Whether it is scaled.
    """

    def __init__(
        self,
        watched: Watched,
        ik: ArmIk,
        configuration: mink.Configuration,
        pairs: ArmPairs,
        *,
        support: bool,
    ):
        self.watched = watched
        self.pairs = pairs
        self.arm: ArmAddresses = ik.arm
        self.ik = ik
        self.support = support
        self._configuration = configuration
        self._foreign = np.ones(watched.jacobian.shape[1], dtype=bool)
        self._foreign[self.arm.dofs] = False
        self.meeting = np.zeros(len(pairs.owned), dtype=bool)
        """(R,) which of them the arm's present job brings together."""
        self._meeting_pairs: Indices | None = None
        self.other_m_s = np.zeros(len(watched.distance_m))
        """(P,) the rates that the others cause, as far as the arm counts on them; only of the pairs it moves."""
        self.kept_other_m_s: Array | None = None
        """(R,) the same when every time to collision was last kept."""

    @property
    def other_owned_m_s(self) -> Array:
        """(R,) of the pairs it answers for."""
        return self.other_m_s.take(self.pairs.owned)

    def meets(self, pairs: Indices) -> None:
        """Say which pairs the arm's present job brings together."""
        if pairs is not self._meeting_pairs:
            self._meeting_pairs = pairs
            self.meeting[...] = np.isin(self.pairs.owned, pairs)

    def rows(self, pairs: Indices) -> Array:
        """(R, n) rows of G of some pairs."""
        return self.watched.jacobian.take(pairs, axis=0).take(self.arm.dofs, axis=1)

    def surroundings(self, *, approaching: bool) -> tuple[float, float]:
        """ARTC in 1/s, signed or of what approaches, and ARMD in 1/m."""
        distance = self.watched.distance_m.take(self.pairs.averaged)
        rate = self.watched.rate_m_s.take(self.pairs.averaged)
        artc = criteria.artc_approaching if approaching else criteria.artc_signed
        return artc(distance, rate), criteria.armd(distance)

    def count_on_others(self, *, static: bool) -> None:
        """Take `other_m_s` from what the other arms may be counted on to do.

        A support arm counts on the least favourable of their ways, as they may be kept from doing at
        once what is asked of them; a priority arm on what they were commanded. Static: they stand.
        """
        ways = self.watched.ways_rad_s[: WAYS if self.support else 1] * self._foreign
        if static:
            self.other_m_s[...] = 0.0
        else:
            self.other_m_s[...] = (self.watched.jacobian @ ways.T).min(axis=1)

    def solve(
        self,
        previous_rad_s: Array,
        task_rad_s: Array,
        qvel: Array,
        settings: Control,
        push: NullspaceObjective | None = None,
    ) -> IkSolution:
        """The arm's inverse kinematics: its tool's task, its criterion, no self-motion that brings a pair below t_min.

        Args:
            previous_rad_s: (n,) velocity from which the acceleration counts.
            task_rad_s: (n,) the smallest motion that does what the tool is to do (`ArmIk.aim`).
            qvel: (nv,) measured velocities.
            settings: In force.
            push: What the null space is to do instead of the criterion.

        Raises:
            FloatingPointError: a number is not finite.
        """
        static = self.support and settings.variant == "static"
        self.count_on_others(static=static)
        objective = self._criterion(qvel, settings) if push is None else push
        rows, allowed = self.self_motion_rows(task_rad_s, settings)
        return self.ik.solve(self._configuration, previous_rad_s, objective, rows, allowed)

    def _criterion(self, qvel: Array, settings: Control) -> NullspaceObjective:
        pairs, arm = self.pairs.averaged, self.arm
        rows, gain = self.rows(pairs), self.ik.criterion.gain
        objective = criteria.objective(
            settings.criterion,
            self.watched.distance_m.take(pairs),
            rows @ qvel[arm.dofs] if self.support else self.watched.rate_m_s.take(pairs),
            rows,
            other_rate_m_s=self.other_m_s.take(pairs),
        )
        if settings.criterion == "none" or gain == 0.0:
            return objective
        q_rad = self._configuration.data.qpos[arm.qpos]
        return criteria.with_room_to_stops(objective, q_rad, arm.lower_rad, arm.upper_rad, gain)

    def self_motion_rows(self, task_rad_s: Array, settings: Control) -> tuple[Array, Array]:
        """(K, n) rows of G and (K,) the smallest rate allowed to each, of the pairs that could be brought below t_min.

        A row never asks for more than the tool's task alone gives: what the path or the operator
        wants is not the null space's to refuse.
        """
        moved = self.pairs.moved
        rows = self.rows(moved)
        gap = self.watched.distance_m.take(moved) - settings.standoff_m
        allowed = gap * (-1.0 / settings.t_min_s)
        allowed[gap <= settings.d_min_m] = 0.0
        allowed -= self.other_m_s.take(moved)
        allowed = np.minimum(allowed, rows @ task_rad_s - TASK_SLACK_M_S)
        # The rest cannot be violated at any allowed velocity.
        near = allowed > -np.abs(rows) @ self.arm.velocity_limit_rad_s
        return rows[near], allowed[near]

    def counted(self, settings: Control) -> tuple[Array, NDArray[np.bool_]]:
        """(R,) distances that the rule counts with, and whether each is at d_min.

        From there on no way is left, but for what is meant to meet.
        """
        counted = self.watched.distance_m.take(self.pairs.owned)
        reached = (counted <= settings.d_min_m) & ~self.meeting
        return np.where(reached, np.minimum(counted, 0.0), counted), reached

    def allow(
        self, wanted_rad_s: Array, command_rad_s: Array, period_s: float, settings: Control
    ) -> Allowance:
        """What the pairs and the joints leave of a wanted velocity.

        Args:
            wanted_rad_s: (n,).
            command_rad_s: (n,) what the joints were commanded last.
            period_s: Of control.
            settings: In force.
        """
        own = self.rows(self.pairs.owned) @ wanted_rad_s
        bound = self.bound(own, self.other_owned_m_s, settings)
        reach = acceleration_interval(
            command_rad_s, wanted_rad_s, self.arm.acceleration_limit_rad_s2, period_s
        )
        return Allowance(bound, self.pressed(bound, own, settings), reach)

    def bound(self, own_m_s: Array, other_m_s: Array, settings: Control) -> ScaleBound:
        """The pairwise rule (R,), (R,); pairs at d_min or nearer may only be opened. With order 2, equation (16) on the second-order time."""
        counted, reached = self.counted(settings)
        if reached.any():
            own_m_s, other_m_s = (
                np.where(reached & (np.abs(rate) < AT_REST_M_S), 0.0, rate)
                for rate in (own_m_s, other_m_s)
            )
        if settings.slow_down == "distance":
            return slow_near(counted, settings.d_min_m, settings.slow_distance_m)
        bound = pairwise_factor(
            counted, own_m_s, other_m_s, settings.t_min_s, standoff_m=settings.standoff_m
        )
        if self.watched.accel_m_s2 is None:
            return bound
        # Only pairs this arm closes itself can be held by slowing down; leaving is not slowed either way.
        second = np.where(
            own_m_s < 0.0,
            ttc.reciprocal_second_order(
                counted,
                own_m_s + other_m_s,
                self.watched.accel_m_s2[self.pairs.owned],
                standoff_m=settings.standoff_m,
            ),
            0.0,
        )
        first = ttc.smallest(second)
        factor = min(1.0, first.ttc_s / settings.t_min_s)
        if factor >= bound.factor:
            return bound
        return replace(bound, factor=factor, pair=first.pair, required=factor)

    def pressed(self, bound: ScaleBound, own_m_s: Array, settings: Control) -> bool:
        """Whether standing is not enough for a pair that this arm can do something about.

        Nothing it does opens a pair with its own base; to give way for that would only stop its work.
        """
        if bound.shortfall_m_s <= PRESSED_M_S:
            return False
        spared = self.other_owned_m_s + self.meeting * PRESSED_MEETING_M_S
        spared = np.where(self.pairs.standing, np.maximum(spared, 0.0), spared)
        return self.bound(own_m_s, spared, settings).shortfall_m_s > PRESSED_M_S

    def is_free(self, velocity_rad_s: Array, settings: Control) -> bool:
        """Whether no pair would limit the arm at this velocity (n,)."""
        own = self.rows(self.pairs.owned) @ velocity_rad_s
        return self.bound(own, self.other_owned_m_s, settings).factor == 1.0

    def keeps(self, command_rad_s: Array, settings: Control) -> bool:
        """Whether a command (n,) leaves every pair its time to collision, and none to be opened; remembered if so."""
        keep = self.kept(command_rad_s, settings)
        if keep.short.any() or keep.needs_more.any():
            return False
        self.remember()
        return True

    def remember(self) -> None:
        """Take what the others do now as what was last kept."""
        self.kept_other_m_s = self.other_owned_m_s

    def kept(self, command_rad_s: Array, settings: Control) -> Keeping:
        """How far a command (n,) keeps the times to collision, pair by pair."""
        rows = self.rows(self.pairs.owned)
        counted, reached = self.counted(settings)
        allowance = (counted - settings.standoff_m) / settings.t_min_s + self.other_owned_m_s
        slack = np.where(reached, AT_REST_M_S, TASK_SLACK_M_S)
        needed, opening = np.minimum(-allowance, 0.0), rows @ command_rad_s
        before = 0.0
        if self.kept_other_m_s is not None:
            before = self.kept_other_m_s - self.other_owned_m_s
        return Keeping(
            rows=rows,
            allowance_m_s=allowance,
            needed_m_s=needed,
            needs_more=opening < needed - slack,
            short=allowance + opening < -slack,
            others_alone=(allowance < 0.0) | (allowance + before + opening >= -slack),
        )


@dataclass(frozen=True)
class Keeping:
    """What a command does to the pairs an arm answers for."""

    rows: Array
    """(R, n) of G."""
    allowance_m_s: Array
    """(R,) how fast each may be closed, the others' part already taken off; negative where standing does not keep it."""
    needed_m_s: Array
    """(R,) rate that each needs of this arm; 0 for those that standing keeps, or does not keep."""
    needs_more: NDArray[np.bool_]
    """(R,) which do not get it."""
    short: NDArray[np.bool_]
    """(R,) which fall short of their time to collision."""
    others_alone: NDArray[np.bool_]
    """(R,) for which of them, if short, nothing but what the others do is the cause: they close too fast for
    an arm that stands, or faster than when every time was last kept."""

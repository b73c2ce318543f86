"""The gate: the last stage before the servos, through which every command of a support arm passes.

In: a command x (n,) of any origin, the joints' state and limits, and one arm's pairs as arrays. Out: the command
that goes to the servos, and whether, why and for which pair it was replaced (docs/theory.md section 9).

    box      position, speed, acceleration, jerk: the joints can follow it
    rates    no pair is closed by the arm's own motion beyond t >= t_min
    stop     braking from it, as hard as the joints can, closes no pair to contact
    speed    no point of the arm is faster than the cap

What does not pass is replaced by the nearest command that does, else by one nearer to braking, else by
braking. Braking is the tail of the last verified stop, so it is never looked at a second time.
The box and the stop are hard. The rates and the speed cap cannot always be followed by joints of limited
acceleration: they are soft in the program, and what they miss is reported.

Assumed: each joint is within `ahead` of its measured position when the command begins to act, and its stop
stays between there and |x| T_r + x² / (2 a) farther. Other arms are predicted as `other_m_s` says; a stop is
verified against where they are now. Jerk is a bound on commands that pass, not on braking.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from workcell.control.gate.data import (
    BOUNDS,
    Array,
    Gated,
    GateLinks,
    GateRows,
    GateRules,
    How,
    JointLimits,
    JointState,
)
from workcell.control.gate.ends import RATE_SLACK_M_S, needed_at_ends
from workcell.control.gate.program import Rows, nearest
from workcell.control.laws import gate as laws
from workcell.control.laws import gate_box
from workcell.control.laws.program import HARD, SOFT
from workcell.errors import WorkcellError

CLEARANCE_M = 0.5e-3
"""A stop is verified where it leaves this, or half of the distance there is; chosen well above rounding."""
CUT_M = 1e-5
"""What a cut of the program asks for beyond the clearance, so that its answer passes in spite of the bound's curvature."""
REST_SLACK_M_S = 1e-4
"""The same at d_min, where an arm that starts to leave is first moved by the last digits of its tool error."""
SPEED_SLACK = 1e-6
"""Relative, on the speed cap: rounding."""
ROUNDS = 4
"""Of the program, each with the cuts of all before it."""
TOWARDS_BRAKING = (0.5, 0.25, 0.1)
"""Shares of the way from braking to the program's answer that are tried where that does not pass."""

_NOTHING = np.empty(0)


@dataclass(slots=True)
class _Look:
    """How a command does."""

    passes: bool
    """Whether all below is kept; False where a number is not finite."""
    short_m_s: Array
    """(P,) by how much its own rates fall short of what is needed, beyond their slack; <= 0 where kept."""
    lack_m: Array
    """(E,) by how much its stop falls short of the clearance; <= 0 where kept."""
    over_m_s: Array
    """(C,) by how much points exceed the cap; <= 0 where kept."""

    @property
    def stop_fails(self) -> bool:
        return bool((self.lack_m > 0.0).any())


def ahead(
    commands_in_flight: Array,
    period_s: float,
    *,
    lag: Array | float = 0.0,
    uncertainty: Array | float = 0.0,
) -> tuple[Array, Array]:
    """(n,) smallest and largest displacement of each joint before the next command acts.

    Args:
        commands_in_flight: (L, n) commands since the measured state was taken, oldest first.
        period_s: How long each acts.
        lag: (n,) the servos' references less the measured positions, less what is in flight.
        uncertainty: (n,) bound on the error of a measured position, >= 0.
    """
    way = np.asarray(commands_in_flight, dtype=float).sum(axis=0) * period_s + lag
    return np.minimum(way, 0.0) - uncertainty, np.maximum(way, 0.0) + uncertainty


def braking(last: Array, limits: JointLimits, period_s: float) -> Array:
    """(n,) the next command of a stop as hard as the joints can."""
    return np.sign(last) * np.maximum(np.abs(last) - limits.acceleration * period_s, 0.0)


def gate(
    command: Array,
    state: JointState,
    limits: JointLimits,
    rows: GateRows,
    rules: GateRules,
    *,
    other_m_s: Array | float = 0.0,
    meeting: NDArray[np.bool_] | bool = False,
    links: GateLinks | None = None,
) -> Gated:
    """The command itself if it passes, else the nearest one that does, else braking.

    Args:
        command: x (n,). One that is not finite is replaced by braking.
        state: Of the joints.
        limits: Of the joints.
        rows: The arm's pairs.
        rules: What is held.
        other_m_s: (P,) predicted rates that all but this arm cause.
        meeting: (P,) pairs that are to meet: no standoff and no halt at d_min for them.
        links: Whose points' speed is capped; None where there is no cap.

    Raises:
        WorkcellError: the command has another shape than the joints, or a row, state or limit is not finite.
    """
    if command.shape != state.last.shape:
        raise WorkcellError(
            f"command has shape {command.shape}; must be that of the joints, {state.last.shape}"
        )
    pairs = len(rows.distance_m)
    other = np.full(pairs, other_m_s) if np.isscalar(other_m_s) else np.asarray(other_m_s)
    meets = np.full(pairs, meeting) if np.isscalar(meeting) else np.asarray(meeting)
    return _Gate(state, limits, rows, rules, other, meets, links).answer(command)


@dataclass(slots=True)
class _Gate:
    """One call of `gate`."""

    state: JointState
    limits: JointLimits
    rows: GateRows
    rules: GateRules
    other_m_s: Array
    meeting: NDArray[np.bool_]
    links: GateLinks | None
    box: Array = field(init=False)
    bounds: NDArray[np.int64] = field(init=False)
    at_ends: Array = field(init=False)
    """(K,) smallest rates at the ends of near-parallel capsules."""
    demands: tuple[Array, Array, Array] = field(init=False)
    """Needed rates (P,), their slack (P,), clearances of stops (E,): `laws.demands`."""

    def answer(self, command: Array) -> Gated:
        self._prepare()
        y = command.clip(*self.box)
        look = self._look(y)
        moved = np.abs(y - command).max(initial=0.0)
        if look.passes and moved <= laws.SAME_RAD_S:
            return Gated(command, "passed")
        _require_finite(self.state, self.rows, self.other_m_s)
        brake = braking(self.state.last, self.limits, self.rules.period_s)
        if not np.isfinite(command).all():
            return self._told(brake, "braking", ("not_finite",), None)
        reasons, pair = self._why(command, y, look)
        if look.passes:
            return Gated(y, "nearest", reasons, pair)
        best, found = self._nearest(command, y, look)
        if not found.stop_fails:
            return self._told(best, "nearest", reasons, pair, found)
        for share in TOWARDS_BRAKING:
            y = brake + share * (best - brake)
            look = self._look(y)
            if not look.stop_fails:
                return self._told(y, "towards_braking", reasons, pair, look)
        return self._told(brake, "braking", reasons, pair)

    def _prepare(self) -> None:
        state, limits, rules, rows = self.state, self.limits, self.rules, self.rows
        n = len(state.position)
        self.box, self.bounds = np.empty((2, n)), np.empty((2, n), dtype=np.int64)
        gate_box.next_commands(
            state.position + state.ahead_low,
            state.position + state.ahead_high,
            state.last,
            state.last_change,
            limits.lower,
            limits.upper,
            limits.speed,
            limits.acceleration,
            limits.jerk,
            rules.period_s,
            self.box,
            self.bounds,
        )
        self.at_ends = needed_at_ends(rows, limits, rules, self.meeting)
        self.demands = self._demanded(self.other_m_s)

    def _demanded(self, other_m_s: Array) -> tuple[Array, Array, Array]:
        """Needed rates (P,), their slack (P,) and clearances of stops (E,), were all others to cause these rates (P,)."""
        rows, rules, P = self.rows, self.rules, len(self.rows.distance_m)
        demands = np.empty(P), np.empty(P), np.empty(len(rows.low_m))
        laws.demands(
            rows.distance_m,
            self.meeting,
            other_m_s,
            rows.first,
            rows.low_m,
            rules.t_min_s,
            rules.d_min_m,
            rules.standoff_m,
            rules.hold_m,
            RATE_SLACK_M_S,
            REST_SLACK_M_S,
            CLEARANCE_M,
            *demands,
        )
        return demands

    def _look(self, y: Array) -> _Look:
        state, rows = self.state, self.rows
        short, lack = np.empty(len(rows.distance_m)), np.empty(len(rows.low_m))
        passes = laws.look(
            y,
            state.ahead_low,
            state.ahead_high,
            self.limits.acceleration,
            self.rules.reaction_s,
            rows.own,
            rows.first,
            rows.order,
            rows.rows,
            rows.levers,
            rows.low_m,
            *self.demands,
            short,
            lack,
        )
        if len(rows.jump):
            missed = rows.jump @ -y + self.at_ends - RATE_SLACK_M_S
            np.maximum.at(short, rows.jump_pair, missed)
            passes = passes and bool((missed <= 0.0).all())
        if self.links is None:
            return _Look(passes, short, lack, _NOTHING)
        over = self.links.speeds_m_s(y) - self.rules.point_speed_m_s * (1.0 + SPEED_SLACK)
        return _Look(passes and bool(over.max(initial=-1.0) <= 0.0), short, lack, over)

    def _nearest(self, command: Array, y: Array, look: _Look) -> tuple[Array, _Look]:
        """Nearest to the command of what passes, or as near to passing as a few programs come.

        Each is min |y - x|² in the box, under the rates and a cut for each row that failed before.
        """
        low, high = self.box
        # The other rates hold wherever in the box the answer is.
        most = np.abs(self.rows.own) @ np.maximum(np.abs(low), np.abs(high))
        asked = self.demands[0]
        alone = self._demanded(np.zeros_like(asked))[0]  # were all others to stand
        first, pressed = alone > -most, (asked > -most) & (self.other_m_s < 0.0)
        own = np.concatenate([self.rows.own[first], self.rows.jump])
        alone = np.concatenate([alone[first], self.at_ends])
        cuts = Rows(
            self.rows.own[pressed],
            asked[pressed],
            np.full(int(pressed.sum()), SOFT, dtype=np.intc),
        )
        for _ in range(ROUNDS):
            cuts = cuts.and_these(self._cuts(y, look))
            found = nearest(command, low, high, own, alone, cuts)
            if found is None:
                break
            y = found.clip(low, high)
            look = self._look(y)
            if look.passes:
                break
        return y, look

    def _cuts(self, y: Array, look: _Look) -> Rows:
        """What fails at y: stops hard, point speeds soft."""
        state, rows = self.state, self.rows
        cuts, needs, marks = [np.empty((0, len(y)))], [], []
        pair_of = np.repeat(np.arange(len(rows.pair)), np.diff(rows.first))
        for e in np.flatnonzero(look.lack_m > 0.0):
            gradient = np.empty(len(y))
            laws.stop_gradient(
                e,
                pair_of[e],
                y,
                state.ahead_low,
                state.ahead_high,
                self.limits.acceleration,
                self.rules.reaction_s,
                rows.order,
                rows.rows,
                rows.levers,
                gradient,
            )
            cuts.append(gradient[None])
            needs.append(look.lack_m[e] + CUT_M + gradient @ y)
            marks.append(HARD)
        if self.links is not None:
            for c in np.flatnonzero(look.over_m_s > 0.0):
                cuts.append(-self.links.gradient(int(c), y)[None])
                needs.append(-self.rules.point_speed_m_s)
                marks.append(SOFT)
        return Rows(np.concatenate(cuts), np.array(needs), np.array(marks, dtype=np.intc))

    def _why(self, command: Array, y: Array, look: _Look) -> tuple[tuple[str, ...], int | None]:
        reasons, pair, moved = [], None, np.abs(y - command)
        if moved.max(initial=0.0) > laws.SAME_RAD_S:
            joint = int(moved.argmax())
            reasons.append(
                BOUNDS[int(self.bounds[int(command[joint] > self.box[1, joint]), joint])]
            )
        if (look.short_m_s > 0.0).any():
            reasons.append("time_to_collision")
            pair = int(self.rows.pair[look.short_m_s.argmax()])
        if look.stop_fails:
            reasons.append("stop")
            if pair is None:
                row = np.searchsorted(self.rows.first, look.lack_m.argmax(), side="right") - 1
                pair = int(self.rows.pair[row])
        if (look.over_m_s > 0.0).any():
            reasons.append("point_speed")
        return tuple(reasons), pair

    def _told(
        self,
        y: Array,
        how: How,
        reasons: tuple[str, ...],
        pair: int | None,
        look: _Look | None = None,
    ) -> Gated:
        look = self._look(y) if look is None else look
        worst = int(look.short_m_s.argmax()) if len(look.short_m_s) else -1
        missed = worst >= 0 and look.short_m_s[worst] > 0.0
        over = look.over_m_s.max(initial=-np.inf)
        return Gated(
            y,
            how,
            reasons,
            pair,
            verified=not look.stop_fails,
            missed_pair=int(self.rows.pair[worst]) if missed else None,
            missed_m_s=float(look.short_m_s[worst]) if missed else 0.0,
            speed_m_s=self.rules.point_speed_m_s + float(over) if over > 0.0 else None,
        )


def _require_finite(state: JointState, rows: GateRows, other_m_s: Array) -> None:
    for name, values in (
        ("position", state.position),
        ("last", state.last),
        ("last_change", state.last_change),
        ("ahead_low", state.ahead_low),
        ("ahead_high", state.ahead_high),
        ("distance_m", rows.distance_m),
        ("own", rows.own),
        ("rows", rows.rows),
        ("low_m", rows.low_m),
        ("other_m_s", other_m_s),
    ):
        if not np.isfinite(values).all():
            raise WorkcellError(
                f"{name} is not finite: {values[~np.isfinite(values)][:3].tolist()}"
            )

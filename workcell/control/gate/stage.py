"""The gate of one arm, tick by tick: a command that passes is seen to in one call, on arrays that are kept.

In: the arm's state and what MuJoCo and the pairs' proximity say of this tick. Out: what `gate` answers. Nearly every
command passes as it is; `laws.gate.passes` says so in a tenth of the time that `gate` takes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.gate import answer
from workcell.control.gate.data import Array, Gated, GateRows, GateRules, JointLimits, JointState
from workcell.control.gate.ends import RATE_SLACK_M_S
from workcell.control.gate.rows import GateGeometry, no_ends
from workcell.control.laws import gate as laws
from workcell.control.laws import gate_ends
from workcell.control.proximity import Proximity


class ArmGate:
    """Looks at one arm's commands.

    Args:
        geometry: The arm's pairs.
        limits: Of its joints.
        counted: (P,) of which pairs the others' part of the rate counts.
    """

    def __init__(self, geometry: GateGeometry, limits: JointLimits, counted: NDArray[np.bool_]):
        self._geometry, self._limits = geometry, limits
        self._counted = np.ascontiguousarray(counted)
        n, P = len(limits.speed), len(geometry.pair)
        E, C = geometry.points, geometry.corners
        self._command, self._position, self._last = np.zeros((3, n))
        self._last_change, self._low, self._high = np.zeros((3, n))
        self.meeting = np.zeros(P, dtype=bool)
        """(P,) pairs that are to meet."""
        near, rest, needed, slack, short = np.zeros((5, P))
        low, clearance, lack = np.zeros((3, E))
        own, rows, levers = np.zeros((P, n)), np.zeros((E, n)), np.zeros((E, n))
        self._rows = GateRows(
            geometry.pair, near, own, geometry.first, geometry.order, rows, levers, low, *no_ends(n)
        )
        self._rest = rest
        self._out = (
            np.zeros((n, 6)), np.zeros((n, 3)), near, own, rows, levers, low, np.zeros((2, n)),
            np.zeros((2, n), dtype=np.int64), rest, needed, slack, clearance, short, lack, np.zeros(C),
        )  # fmt: skip
        self._jump = np.zeros((4 * P, n)), np.zeros(4 * P), np.zeros(4 * P, dtype=np.intp)
        self._jump_needed = np.zeros(4 * P)
        self._bound: tuple[Any, ...] = ()
        self._ends: tuple[Any, ...] = ()
        self._data: mujoco.MjData | None = None
        self._proximity: Proximity | None = None

    @property
    def pair(self) -> NDArray[np.intp]:
        """(P,) numbers of its pairs."""
        return self._rows.pair

    def answer(
        self,
        command: Array,
        state: JointState,
        rules: GateRules,
        other_m_s: Array,
        data: mujoco.MjData,
        proximity: Proximity,
    ) -> Gated:
        """What passes of a command.

        Args:
            command: (n,).
            state: Of the joints.
            rules: What is held.
            other_m_s: (W,) predicted rates that all but this arm cause, of all watched pairs.
            data: At the measured configuration, after `mj_comPos`.
            proximity: Of all watched pairs.
        """
        if data is not self._data or proximity is not self._proximity:
            self._bind(data, proximity)
        self._command[...], self._position[...] = command, state.position
        self._last[...], self._last_change[...] = state.last, state.last_change
        self._low[...], self._high[...] = state.ahead_low, state.ahead_high
        limits, geometry = self._limits, self._geometry
        kept = laws.passes(
            self._command, self._position, self._last, self._last_change, self._low, self._high,
            limits.lower, limits.upper, limits.speed, limits.acceleration, limits.jerk,
            rules.period_s, rules.reaction_s, rules.t_min_s, rules.d_min_m, rules.standoff_m,
            rules.hold_m, RATE_SLACK_M_S, answer.REST_SLACK_M_S, answer.CLEARANCE_M,
            rules.point_speed_m_s * (1.0 + answer.SPEED_SLACK), *self._bound, self.meeting,
            self._counted, other_m_s, *geometry.outline, *self._out,
        )  # fmt: skip
        jump = self._jump
        ends, ends_kept = gate_ends.ends_keep(
            self._command, *self._ends, rules.point_speed_m_s * rules.t_min_s, *jump, self.meeting,
            limits.acceleration, rules.t_min_s, rules.d_min_m, rules.standoff_m, RATE_SLACK_M_S,
            self._jump_needed,
        )  # fmt: skip
        if kept and ends_kept:
            return Gated(command, "passed")
        rows = self._rows
        if ends:
            rows = replace(
                rows, jump=jump[0][:ends], jump_farther_m=jump[1][:ends], jump_pair=jump[2][:ends]
            )
        return answer.gate(
            command,
            state,
            limits,
            rows,
            rules,
            other_m_s=self._rest,
            meeting=self.meeting,
            links=geometry.links(data),
        )

    def _bind(self, data: mujoco.MjData, proximity: Proximity) -> None:
        """MuJoCo's arrays and the proximity's never move: they are asked for once."""
        self._data, self._proximity = data, proximity
        geometry = self._geometry
        self._bound = (
            geometry.dofs, geometry.roots, data.cdof, data.subtree_com, data.geom_xpos,
            data.geom_xmat, proximity.distance_m, proximity.normal, proximity.witness_i_m,
            proximity.witness_j_m, *geometry.pairs,
        )  # fmt: skip
        screws, centre, near = self._out[:3]
        _, _, geom, _, _, _, order, sign = geometry.pairs
        self._ends = (
            screws, centre, data.geom_xpos, data.geom_xmat, near, geom, *geometry.capsules, order, sign,
        )  # fmt: skip

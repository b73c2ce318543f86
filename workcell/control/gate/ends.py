"""What the gate asks at the ends of near-parallel capsules, to which their nearest points may jump (docs/theory.md section 9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workcell.control.gate.data import Array, GateRows, GateRules, JointLimits
from workcell.control.laws import gate_ends

RATE_SLACK_M_S = 1e-5
"""Rates are known up to the solvers' tolerances: ten micrometres a second, 0.1 % of the slowest rate that matters, d_min / t_min."""


def needed_at_ends(
    rows: GateRows, limits: JointLimits, rules: GateRules, meeting: NDArray[np.bool_]
) -> Array:
    """(K,) smallest rates."""
    needed = np.empty(len(rows.jump))
    gate_ends.jump_needs(
        rows.jump,
        rows.jump_farther_m,
        rows.jump_pair,
        rows.distance_m,
        meeting,
        limits.acceleration,
        rules.t_min_s,
        rules.d_min_m,
        rules.standoff_m,
        needed,
    )
    return needed

"""The gate: the last stage before the servos, through which every command of a support arm passes.

answer   the gate itself: a command in, the command that passes out
data     what it is given and what it answers
rows     one arm's pairs at a configuration, from MuJoCo's data
stage    one arm's gate, tick by tick
"""

from workcell.control.gate.answer import CLEARANCE_M, ahead, braking, gate
from workcell.control.gate.data import (
    REASONS,
    Gated,
    GateLinks,
    GateRows,
    GateRules,
    JointLimits,
    JointState,
)
from workcell.control.gate.rows import GateGeometry
from workcell.control.gate.stage import ArmGate

__all__ = [
    "CLEARANCE_M",
    "REASONS",
    "ArmGate",
    "GateGeometry",
    "GateLinks",
    "GateRows",
    "GateRules",
    "Gated",
    "JointLimits",
    "JointState",
    "ahead",
    "braking",
    "gate",
]

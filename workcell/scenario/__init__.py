"""Scenario file -> frozen, validated `Scenario`.

A scenario is one TOML file: the cell (arms, obstacles), who drives each arm, the controller's
parameters, and the bounds that make the run a test (`[expect]`). Everything that can be judged
without MuJoCo is judged here, all faults at once; what needs the geometry is judged when the cell
is built. Units are in the key names; unknown keys, NaN and infinity are refused.

    schema, operators, jobs   the tables, with values (kinds of value) below them
    checks                    what must hold across tables
    load, overrides           file and `--set` -> `Scenario`
    messages                  a validation error in the words of the file
"""

from __future__ import annotations

from workcell.scenario.jobs import Exchange, Fetch, Job, Meet, Move, Present, Put, Retreat, Wait
from workcell.scenario.load import find, load, validate
from workcell.scenario.operators import (
    Hold,
    Human,
    Joints,
    Live,
    Operator,
    Plugin,
    Recording,
    Stream,
    Waypoint,
    Waypoints,
)
from workcell.scenario.schema import (
    KINDS,
    Arm,
    Bound,
    Change,
    Check,
    Control,
    Ignore,
    Instrument,
    Obstacle,
    Sabotage,
    Scenario,
    Simulation,
    Variation,
    View,
)
from workcell.scenario.values import UNIT_QUATERNION_TOLERANCE, Entry, ToolTask

__all__ = [
    "KINDS",
    "UNIT_QUATERNION_TOLERANCE",
    "Arm",
    "Bound",
    "Change",
    "Check",
    "Control",
    "Entry",
    "Exchange",
    "Fetch",
    "Hold",
    "Human",
    "Ignore",
    "Instrument",
    "Job",
    "Joints",
    "Live",
    "Meet",
    "Move",
    "Obstacle",
    "Operator",
    "Plugin",
    "Present",
    "Put",
    "Recording",
    "Retreat",
    "Sabotage",
    "Scenario",
    "Simulation",
    "Stream",
    "ToolTask",
    "Variation",
    "View",
    "Wait",
    "Waypoint",
    "Waypoints",
    "find",
    "load",
    "validate",
]

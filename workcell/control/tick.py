"""A tick as data: a chain of records, each made by one stage and changed by none.

    Sensed        the cell: state, distances, rates, smallest time to collision
    ArmSensed     an arm: where its tool is
    ArmSetpoint   an arm: the tool pose and twist asked of it, and the smallest joint motion that does it
    Steering      an arm: the strategy's answer (nominal velocity, velocity, clock rate, reason)
    Command       an arm: what has passed the gate
    TickRecord    the outcome, a row of the trace (`record.py`)

They are named tuples, which nothing can change and which are made in a quarter of the time that a
frozen dataclass takes. n is the number of the arm's joints, P that of the watched pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workcell.motion.path import Target
from workcell.scenario import Control

Array = NDArray[np.float64]


class Sensed(NamedTuple):
    """What the controller has measured of the cell."""

    tick: int
    time_s: float
    qpos: Array
    """(nq,) measured positions, carried on to this tick where they are late."""
    qvel: Array
    """(nv,) measured velocities, likewise."""
    told_qpos: Array
    """(nq,) positions as measured, which the trace keeps."""
    told_qvel: Array
    """(nv,) velocities as measured."""
    settings: Control
    """The parameters in force."""
    distance_m: Array
    """(P,)"""
    rate_m_s: Array
    """(P,) from measured velocities."""
    nearest_pair: int | None
    """Of the pairs that count."""
    ttc_s: float | None
    """Smallest time to collision from measured velocities; None where nothing closes."""
    ttc_pair: int | None
    """Its pair."""
    witness_i_m: Array | None
    """(3,) surface point of the first geom of `ttc_pair`, else of `nearest_pair`."""
    witness_j_m: Array | None
    """(3,) of the second geom."""


class ArmSensed(NamedTuple):
    """What the controller has measured of one arm."""

    tool_position_m: Array
    """(3,)"""
    tool_wxyz: Array
    """(4,)"""
    tool_speed_m_s: float
    elbow_position_m: Array | None
    """(3,); None for an arm without an elbow site."""
    artc_per_s: float
    armd_per_m: float


class ArmSetpoint(NamedTuple):
    """What is asked of one arm."""

    target: Target
    """Tool pose and twist."""
    task_rad_s: Array
    """(n,) the smallest joint velocity that gives the tool the twist asked for, limits aside."""
    doing: str
    """What drives the arm, logged as its job."""
    clock_s: float
    """Of the path, or the operator's time."""
    tool_error_m: float
    tool_error_rad: float
    operator_state: str = ""
    """See `workcell.motion.setpoint`; empty without an operator."""
    elbow_speed_m_s: float = 0.0
    """Speed to the left that the operator asks of the elbow."""
    joints_rad_s: Array | None = None
    """(n,) joint velocities to be commanded as they are; None where the target is to be followed."""
    out_of_reach_m: float | None = None
    """How far the tool will stay from a target beyond reach; None where the target can be reached."""
    waits: bool = False
    """Whether the path stands still until the tool has come back to it."""
    began: bool = False
    """Whether another job began in this tick."""
    replanned: bool = False
    """Whether the same job got another path in this tick."""


class Steering(NamedTuple):
    """A strategy's answer for one arm and one tick."""

    velocity_rad_s: Array
    """(n,) what the joints are to do."""
    nominal_rad_s: Array
    """(n,) nominal velocity, before scaling and avoidance; the next tick's acceleration counts from it."""
    clock_rate: float = 1.0
    """Rate of the path's clock until the next tick; negative runs it backwards."""
    scale: float = 1.0
    """Speed scale, as logged: the share of the nominal velocity that is left."""
    mode: str = "run"
    """One of `outcome.MODES`."""
    reason: str = ""
    """Why the velocity is not the nominal one; empty if it is."""
    limiting_pair: int | None = None
    """The pair that sets the scale."""
    ik_status: str = ""
    """What the inverse kinematics said."""
    attempt: str = ""
    """What is tried against an impasse."""
    path: str = "follow"
    """What the path is to do next: follow, pause (stand still) or reverse (go back)."""
    free_rotation: bool = False
    """Whether the rotation about the tool's axis is to be left free next."""
    another_approach: bool = False
    """Whether another approach side is asked for."""
    off_path_m: float | None = None
    """How far the tool may be off its path with the path's clock going on, its end apart; None for `setpoints.REJOIN_M`."""


class Command(NamedTuple):
    """What has passed the gate."""

    velocity_rad_s: Array
    """(n,) what the joints are told."""
    gate: str = ""
    """What the gate did and for what reasons (`gate.REASONS`); empty where the command passed as it was."""
    gate_pair: int | None = None
    """The watched pair of the first pair rule that the command failed."""


class ArmTick(NamedTuple):
    """The chain of one arm, complete."""

    sensed: ArmSensed
    setpoint: ArmSetpoint
    steering: Steering
    command: Command

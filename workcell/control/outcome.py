"""Outcome stage: the chain of a tick becomes a row of the trace, judged by the commanded velocities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from workcell.control.arm import ControlledArm
from workcell.control.finite import all_finite, require_finite
from workcell.control.record import ArmRecord, TickRecord
from workcell.control.tick import ArmTick, Sensed
from workcell.control.watched import Watched
from workcell.guard.verdict import Verdict

MODES = ("run", "self_motion", "scale", "yield", "hold", "halt", "stop")
"""What acts on an arm, in rising order of severity; the cell's mode is its most severe arm's."""


def outcome(
    sensed: Sensed,
    arms: Sequence[ControlledArm],
    ticks: Sequence[ArmTick],
    *,
    watched: Watched,
    holders: str,
    verdict: Verdict | None,
) -> TickRecord:
    """The row of a tick.

    Args:
        sensed: What was measured.
        arms: All arms, in the order of the scenario.
        ticks: The chain of each.
        watched: The pairs, which give the commanded time to collision.
        holders: Who holds which instrument.
        verdict: Of the final check; None without one.

    Raises:
        ControlFault: a command is not finite.
    """
    nominal, command = np.zeros(len(sensed.qvel)), np.zeros(len(sensed.qvel))
    for arm, tick in zip(arms, ticks, strict=True):
        nominal[arm.columns] = tick.steering.nominal_rad_s
        command[arm.columns] = tick.command.velocity_rad_s
    if not all_finite(command):
        for arm, tick in zip(arms, ticks, strict=True):
            require_finite(
                sensed.tick, tick.command.velocity_rad_s, f"the command of arm {arm.name}"
            )
    rates = watched.rates(command)
    first, settings = rates.first, sensed.settings
    return TickRecord(
        tick=sensed.tick,
        time_s=sensed.time_s,
        plant_qpos=None,  # the plant's to say
        plant_qvel=None,
        qpos=sensed.told_qpos,
        qvel=sensed.told_qvel,
        pair_distance_m=sensed.distance_m,
        pair_rate_m_s=sensed.rate_m_s,
        t_min_s=settings.t_min_s,
        criterion=settings.criterion,
        entry=settings.entry,
        closest_pair=sensed.nearest_pair,
        ttc_s=sensed.ttc_s,
        ttc_pair=sensed.ttc_pair,
        witness_i_m=sensed.witness_i_m,
        witness_j_m=sensed.witness_j_m,
        wanted_rad_s=nominal,
        command_rad_s=command,
        ttc_command_s=first.ttc_s if math.isfinite(first.ttc_s) else None,
        ttc_command_pair=None if first.pair < 0 else first.pair,
        check_distance_m=None if verdict is None else verdict.distance_m,
        check_state="off" if verdict is None else str(verdict.state),
        closing_cause="" if rates.cause is None else arms[rates.cause].name,
        holders=holders,
        mode=max((tick.steering.mode for tick in ticks), key=MODES.index),
        arms={arm.name: _arm_row(tick) for arm, tick in zip(arms, ticks, strict=True)},
    )


def _arm_row(tick: ArmTick) -> ArmRecord:
    sensed, setpoint, steering, command = tick
    target = setpoint.target
    return ArmRecord(
        target_position_m=target.position_m,
        target_wxyz=target.wxyz,
        target_velocity_m_s=target.velocity_m_s,
        target_turn_rad_s=target.angular_velocity_rad_s,
        job=setpoint.doing,
        operator_state=setpoint.operator_state,
        path_s=setpoint.clock_s,
        tool_position_m=sensed.tool_position_m,
        tool_wxyz=sensed.tool_wxyz,
        tool_speed_m_s=sensed.tool_speed_m_s,
        tool_error_m=setpoint.tool_error_m,
        tool_error_rad=setpoint.tool_error_rad,
        out_of_reach_m=setpoint.out_of_reach_m,
        elbow_position_m=sensed.elbow_position_m,
        artc_per_s=sensed.artc_per_s,
        armd_per_m=sensed.armd_per_m,
        ik_status=steering.ik_status,
        scale=steering.scale,
        limiting_pair=steering.limiting_pair,
        reason=steering.reason,
        attempt=steering.attempt,
        gate=command.gate,
        gate_pair=command.gate_pair,
        mode=steering.mode,
    )

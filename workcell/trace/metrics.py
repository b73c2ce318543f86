"""What a run amounts to: a few dozen numbers, each computed from the trace alone.

In comes a trace; out comes one flat mapping from metric name to a number, a text or None (the run
has no such thing: it never halted, no pair ever closed). A scenario's `[expect]` puts bounds on
these names. Parameters such as t_min come from the trace's metadata entry `settings`, the resolved
scenario, and pairs that are meant to meet from `meeting_pairs`, a list of [geom, geom].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.trace.readings import (
    SCALED_BELOW,
    Floats,
    control_setting,
    held_back,
    jobs_of,
    joint_columns,
    kept_apart,
    longest_scaling,
    period_s,
    smallest_distances_m,
)
from workcell.trace.table import Trace

Metric = float | int | str | bool | None

STANDING_M_S = 1e-4
"""A pair that opens more slowly stands: the last digits of tool errors are still being corrected."""

REVERSAL_FRACTION = 0.02
"""Part of its peak by which a speed must turn back to count as a reversal: chosen to pass over
the last digits of a solver and to catch chatter that an onlooker would see."""

OTHER_ARM_REASON = "other_arm"
"""What an arm's `reason` says where the other arm's own motion alone forces a pair below t_min."""

MEET_JOB, RETREAT_JOB, DONE_JOB = "meet", "retreat", "done"
"""Names of jobs in the arms' `job`: on the way to another tool, on the way back, at the end."""

FLAT_TOLERANCES = (0.02, 0.05)
"""How near t_min a scaled time to collision counts as held; the metric names carry the percent."""


def summarise(trace: Trace) -> dict[str, Metric]:
    """All metrics of a run.

    Raises:
        TraceError: The trace has no rows.
    """
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to summarise")
    summary: dict[str, Metric] = {
        "ticks": len(trace),
        "duration_s": float(trace["time_s"][-1] - trace["time_s"][0]) + period_s(trace),
        "final_mode": str(trace["mode"][-1]),
        "completed": _completed(trace),
        **_hand_overs(trace),
        **_distances(trace),
        **_times_to_collision(trace),
        **_modes(trace, ""),
        **_gated(trace),
    }
    for arm in trace.layout.arms:
        for name, value in {**_arm(trace, arm), **_modes(trace, f"{arm}.")}.items():
            summary[f"{arm}.{name}"] = value
    return summary


def reversals(speed: Floats) -> int:
    """How often a speed turns from rising to falling or back by more than `REVERSAL_FRACTION`."""
    threshold = REVERSAL_FRACTION * float(np.max(np.abs(speed), initial=0.0))
    if threshold == 0.0:
        return 0
    count, direction, extreme = 0, 0, float(speed[0])
    for value in speed.tolist():
        if direction * (value - extreme) > 0 or (
            direction == 0 and abs(value - extreme) > threshold
        ):
            direction = direction or (1 if value > extreme else -1)
            extreme = value
        elif direction * (extreme - value) > threshold:
            count, direction, extreme = count + 1, -direction, value
    return count


def decay_time_s(time_s: Floats, value: Floats) -> float | None:
    """Time constant T of the least-squares fit value = c exp(-time/T); None if it does not decay.

    A velocity scaled to keep its time to collision against a standing obstacle decays with
    T = t_min (docs/theory.md, velocity scaling).
    """
    positive = value > 0
    if positive.sum() < 3:
        return None
    slope = float(np.polyfit(time_s[positive] - time_s[0], np.log(value[positive]), 1)[0])
    return -1.0 / slope if slope < 0 else None


def _distances(trace: Trace) -> dict[str, Metric]:
    smallest, apart = smallest_distances_m(trace, [None, kept_apart(trace)])
    check = trace["check_distance_m"]
    known = check[np.isfinite(check)]
    result: dict[str, Metric] = {
        "smallest_distance_m": None,
        "smallest_distance_pair": None,
        "smallest_distance_time_s": None,
        "smallest_distance_apart_m": _finite(apart.min()),
        "contact": bool(smallest.min() <= 0.0 or (known.size > 0 and known.min() <= 0.0)),
        "smallest_check_distance_m": float(known.min()) if known.size else None,
    }
    if trace.layout.pairs:
        tick = int(np.argmin(smallest))
        pair = int(np.argmin(trace.part("pair_distance_m", np.array([tick]))[0]))
        result["smallest_distance_m"] = float(smallest[tick])
        result["smallest_distance_pair"] = " and ".join(trace.layout.pairs[pair])
        result["smallest_distance_time_s"] = float(trace["time_s"][tick])
    return result


def _times_to_collision(trace: Trace) -> dict[str, Metric]:
    """Smallest estimates, and how well t_min was held while an arm was scaled."""
    measured, commanded = trace["ttc_s"], trace["ttc_command_s"]
    result: dict[str, Metric] = {
        "smallest_ttc_s": None,
        "smallest_ttc_time_s": None,
        "smallest_ttc_command_s": None,
        "smallest_ttc_command_time_s": None,
        "smallest_ttc_command_reason": None,
        "smallest_ttc_command_own_s": None,
    }
    if not np.isnan(measured).all():
        tick = int(np.nanargmin(measured))
        result["smallest_ttc_s"] = float(measured[tick])
        result["smallest_ttc_time_s"] = float(trace["time_s"][tick])
    if not np.isnan(commanded).all():
        tick = int(np.nanargmin(commanded))
        reasons = {str(trace[f"{arm}.reason"][tick]) for arm in trace.layout.arms} - {""}
        result["smallest_ttc_command_s"] = float(commanded[tick])
        result["smallest_ttc_command_time_s"] = float(trace["time_s"][tick])
        result["smallest_ttc_command_reason"] = ", ".join(sorted(reasons))
    own = answered_for(trace)
    if own.any():
        result["smallest_ttc_command_own_s"] = float(commanded[own].min())
    result["scaling_ticks"] = int(np.sum(trace["mode"] == "scale"))
    scaling = np.zeros(len(trace), dtype=bool)
    for arm in trace.layout.arms:
        scaling |= held_back(trace, arm)
    return result | _held_at_t_min(trace, scaling, "")


def answered_for(trace: Trace) -> NDArray[np.bool_]:
    """Ticks whose commanded time to collision a support arm could have held, (T,).

    Where the other arm comes nearer by itself, no factor of this one could hold t_min; and a pair
    of an arm that a person drives, with itself or with what stands, is the person's.
    """
    own = ~np.isnan(trace["ttc_command_s"])
    own &= ~np.isin(trace["ttc_command_pair"], trace.metadata.get("person_pairs", []))
    for arm in trace.layout.arms:
        own &= trace[f"{arm}.reason"] != OTHER_ARM_REASON
    return own


def _held_at_t_min(trace: Trace, ticks: NDArray[np.bool_], prefix: str) -> dict[str, Metric]:
    """Fraction of the given ticks at which the measured time to collision is t_min."""
    t_min_s = control_setting(trace, "t_min_s")
    result: dict[str, Metric] = {}
    for tolerance in FLAT_TOLERANCES:
        held = None
        if t_min_s is not None and ticks.any():
            # A pair that does not close any more is not held at t_min: NaN compares as false.
            held = float(np.mean(np.abs(trace["ttc_s"][ticks] / t_min_s - 1.0) <= tolerance))
        result[f"{prefix}ttc_held_within_{round(100 * tolerance)}_percent"] = held
    return result


def _modes(trace: Trace, prefix: str) -> dict[str, Metric]:
    """How long each state acted and how often it changed."""
    mode = trace[f"{prefix}mode"]
    changes = int(np.sum(mode[1:] != mode[:-1]))
    duration_s = len(trace) * period_s(trace)
    result: dict[str, Metric] = {
        "mode_changes": changes,
        "mode_changes_per_s": changes / duration_s if duration_s > 0 else None,
    }
    for name, count in zip(*np.unique(mode.astype(str), return_counts=True), strict=True):
        result[f"mode_{name}_ticks"] = int(count)
    return result


def _arm(trace: Trace, arm: str) -> dict[str, Metric]:
    time_s, dt_s = trace["time_s"], period_s(trace)
    scale = trace[f"{arm}.scale"]
    speed = trace[f"{arm}.tool_speed_m_s"]
    command = trace.part("command_rad_s", entries=joint_columns(trace, arm))
    span = longest_scaling(trace, arm)
    halted = np.flatnonzero(trace["mode"] == "halt")
    distance_decay = speed_decay = closing_decay = None
    if span is not None:
        window = np.arange(span.start, span.stop)
        pair = [int(trace[f"{arm}.limiting_pair"][span.start])]
        distance, rate = (
            trace.part(name, window, pair)[:, 0] for name in ("pair_distance_m", "pair_rate_m_s")
        )
        distance_decay = decay_time_s(time_s[window], distance)
        speed_decay = decay_time_s(time_s[window], speed[window])
        closing_decay = decay_time_s(time_s[window], -rate)
    return {
        "path_done_s": _path_done_s(trace, arm),
        "peak_tool_speed_m_s": float(speed.max()),
        "tool_speed_at_halt_m_s": float(speed[halted[0]]) if halted.size else None,
        "max_tool_error_m": float(trace[f"{arm}.tool_error_m"].max()),
        "max_tool_error_rad": float(trace[f"{arm}.tool_error_rad"].max()),
        "elbow_travel_m": _elbow_travel_m(trace, arm),
        "impasse_attempts": _attempts(trace, arm),
        "peak_joint_acceleration_rad_s2": _peak_derivative(command, trace["tick"], dt_s, 1),
        "peak_joint_jerk_rad_s3": _peak_derivative(command, trace["tick"], dt_s, 2),
        "speed_reversals": reversals(np.linalg.norm(command, axis=1)),
        "smallest_scale": float(scale.min()),
        "scaled_ticks": int(np.sum(scale < SCALED_BELOW)),
        "longest_scaling_s": 0.0 if span is None else len(span) * dt_s,
        "distance_decay_s": distance_decay,
        "speed_decay_s": speed_decay,
        "closing_decay_s": closing_decay,
        **_meeting(trace, arm),
        **_retreating(trace, arm),
        **_reasons(trace, arm),
    }


def _path_done_s(trace: Trace, arm: str) -> float | None:
    """When the arm's job came to its end: neither job nor progress changes any more after it."""
    job, path_s = trace[f"{arm}.job"], trace[f"{arm}.path_s"]
    moving = np.flatnonzero((job[1:] != job[:-1]) | (path_s[1:] != path_s[:-1]))
    if not moving.size:
        return float(trace["time_s"][0])
    last = int(moving[-1]) + 1
    return None if last == len(trace) - 1 else float(trace["time_s"][last])


def _hand_overs(trace: Trace) -> dict[str, Metric]:
    """How often instruments changed hands, and how many a minute reached an arm that a person drives."""
    holders = trace["holders"]
    changed = np.flatnonzero(holders[1:] != holders[:-1]) + 1
    if not changed.size and not (holders != "").any():
        return {}
    driven = {arm["name"] for arm in trace.metadata["settings"]["arm"] if arm.get("operator")}
    delivered = sum(
        now != before and now.partition("=")[2] in driven
        for tick in changed
        for before, now in zip(holders[tick - 1].split(), holders[tick].split(), strict=True)
    )
    minutes = len(trace) * period_s(trace) / 60
    return {
        "hand_overs": int(changed.size),
        "deliveries": int(delivered),
        "deliveries_per_minute": delivered / minutes if minutes > 0 else None,
    }


def _completed(trace: Trace) -> bool | None:
    """Whether every arm that has jobs ended with all of them done; None where no arm has any."""
    working = [arm for arm in trace.layout.arms if jobs_of(trace, arm)]
    if not working:
        return None
    return all(str(trace[f"{arm}.job"][-1]) == DONE_JOB for arm in working)


def _meeting(trace: Trace, arm: str) -> dict[str, Metric]:
    """How flat the time to collision was on the way to another arm's tool; for arms that meet one."""
    if not any(job["kind"] == MEET_JOB for job in jobs_of(trace, arm)):
        return {}
    ticks = held_back(trace, arm) & (trace[f"{arm}.job"] == MEET_JOB)
    return _held_at_t_min(trace, ticks, "meet_")


def _gated(trace: Trace) -> dict[str, Metric]:
    """In how many ticks the gate has replaced a command; nothing for traces from before there was one."""
    counts: dict[str, Metric] = {}
    whole = np.zeros(len(trace), dtype=bool)
    for arm in trace.layout.arms:
        if f"{arm}.gate" not in trace.column_names:
            return {}
        gated = trace[f"{arm}.gate"].astype(str) != ""
        counts[f"{arm}.gated_ticks"] = int(gated.sum())
        whole |= gated
    return {"gated_ticks": int(whole.sum())} | counts


def _retreating(trace: Trace, arm: str) -> dict[str, Metric]:
    """The smallest factor while leaving, which must not be slowed; for arms that retreat.

    Counted are the retreat's ticks at which every close pair opens. Close is what the time to
    collision could limit at all: nearer than the retreat's speed times t_min.
    """
    retreats = [job for job in jobs_of(trace, arm) if job["kind"] == RETREAT_JOB]
    t_min_s = control_setting(trace, "t_min_s")
    if not retreats or t_min_s is None:
        return {}
    reach_m = t_min_s * max(job["speed_m_s"] for job in retreats)
    mine = [any(g.startswith(f"{arm}/") for g in pair) for pair in trace.layout.pairs]
    retreating = np.flatnonzero(trace[f"{arm}.job"] == RETREAT_JOB)
    leaving = np.zeros(len(trace), dtype=bool)
    for (start, distance), (_, rate) in zip(
        trace.blocks("pair_distance_m", retreating),
        trace.blocks("pair_rate_m_s", retreating),
        strict=True,
    ):
        opens = (rate[:, mine] > STANDING_M_S) | (distance[:, mine] > reach_m)
        leaving[start : start + len(opens)] = opens.all(axis=1)
    scale = trace[f"{arm}.scale"][retreating[leaving[retreating]]]
    return {"retreat_smallest_scale": float(scale.min()) if scale.size else None}


def _attempts(trace: Trace, arm: str) -> int:
    """How often something was tried against an impasse."""
    attempt = trace[f"{arm}.attempt"].astype(str)
    begins = np.concatenate([attempt[:1] != "", attempt[1:] != attempt[:-1]])
    return int(np.sum(begins & (attempt != "")))


def _elbow_travel_m(trace: Trace, arm: str) -> float | None:
    """Largest distance of the elbow from where it started."""
    position = trace[f"{arm}.elbow_position_m"]
    if np.isnan(position).all():
        return None
    return _finite(np.nanmax(np.linalg.norm(position - position[0], axis=1)))


def _peak_derivative(
    command: Floats, tick: NDArray[np.int64], dt_s: float, order: int
) -> float | None:
    """Largest difference quotient of the commanded joint velocities, over ticks without a gap."""
    if len(command) <= order or not command.shape[1]:
        return None
    in_a_row = tick[order:] - tick[:-order] == order
    quotient = np.abs(np.diff(command, order, axis=0))[in_a_row]
    return float(quotient.max() / dt_s**order) if quotient.size else None


def _reasons(trace: Trace, arm: str) -> dict[str, Metric]:
    """How many ticks each reason kept the command from what was wanted."""
    reason = trace[f"{arm}.reason"].astype(str)
    names, counts = np.unique(reason[reason != ""], return_counts=True)
    return {f"reason_{n}_ticks": int(c) for n, c in zip(names, counts, strict=True)}


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None

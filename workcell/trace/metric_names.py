"""The list of metrics: every name that `summary.json` can hold and `[expect]` can ask for, declared once.

The names in `[expect]` are held against it before a run, docs/metrics.md is compared with it, and a test holds
the summaries of the shipped scenarios to it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class MetricName:
    """One metric."""

    name: str
    """As in the summary, of an arm's metric without the arm. `*` stands for one of several names."""
    unit: str
    """"1" for a pure number or a count, "" for a text or a verdict."""
    meaning: str
    """One line for people."""
    verdict: bool = False
    """Whether it is true or false."""

    def is_that_of(self, name: str) -> bool:
        """Whether a name in a summary is this metric."""
        return bool(re.fullmatch(re.escape(self.name).replace(r"\*", "[a-z0-9_]+"), name))


CELL_METRICS = (
    MetricName("ticks", "1", "control ticks that were done"),
    MetricName("duration_s", "s", "simulated time that they took"),
    MetricName("fault", "", "what ended the run before its time; none where nothing did"),
    MetricName("interrupted", "", "whether a person stopped the run", True),
    MetricName("stopped_by_check", "", "none, off, or the state in which the final check stopped the arms"),
    MetricName("completed", "", "whether every arm that has jobs ended with all of them done; none where no arm has any", True),
    MetricName("final_mode", "", "the mode of the last tick"),
    MetricName("mode_changes", "1", "changes of the cell's mode"),
    MetricName("mode_changes_per_s", "1/s", "the same a second of the run"),
    MetricName("mode_*_ticks", "1", "ticks in a mode, for every mode that occurred"),
    MetricName("contact", "", "whether any watched pair, or any piece of the final check, touched", True),
    MetricName("contact_cause", "", "whose motion closed the first contact: support, priority, both or none; none without a contact"),
    MetricName("contacts_by_support", "1", "contacts in whose closing a support arm had a part"),
    MetricName("smallest_distance_m", "m", "smallest distance of a watched pair"),
    MetricName("smallest_distance_pair", "", "that pair"),
    MetricName("smallest_distance_time_s", "s", "when that was"),
    MetricName("smallest_distance_apart_m", "m", "smallest distance of a pair that is not meant to meet"),
    MetricName("smallest_check_distance_m", "m", "smallest distance that the final check measured; none where it is off"),
    MetricName("smallest_ttc_s", "s", "smallest time to collision of measured velocities; none where nothing closed"),
    MetricName("smallest_ttc_time_s", "s", "when that was"),
    MetricName("smallest_ttc_command_s", "s", "smallest time to collision of commanded velocities"),
    MetricName("smallest_ttc_command_time_s", "s", "when that was"),
    MetricName("smallest_ttc_command_reason", "", "what limited the arms then"),
    MetricName("smallest_ttc_command_own_s", "s", "the same over the ticks for which a support arm answers"),
    MetricName("own_short_ticks", "1", "ticks in which a pair fell short of t_min by a support arm's own closing"),
    MetricName("gated_ticks", "1", "ticks in which the gate replaced a command of a support arm"),
    MetricName("scaling_ticks", "1", "ticks in mode scale"),
    MetricName("ttc_held_within_*_percent", "1", "fraction of the scaled ticks at which the time to collision was within 2 or 5 % of t_min"),
    MetricName("hand_overs", "1", "how often an instrument changed hands; in cells with instruments"),
    MetricName("deliveries", "1", "how often one came to an arm that a person drives"),
    MetricName("deliveries_per_minute", "1/min", "the same a minute of the run"),
)  # fmt: skip
"""Metrics of the cell."""

ARM_METRICS = (
    MetricName("path_done_s", "s", "when its jobs came to an end; none where they did not"),
    MetricName("peak_tool_speed_m_s", "m/s", "largest speed of its tool"),
    MetricName("tool_speed_at_halt_m_s", "m/s", "speed of its tool when a halt began; none without one"),
    MetricName("max_tool_error_m", "m", "largest distance of its tool from the target"),
    MetricName("max_tool_error_rad", "rad", "largest angle of its tool to the target"),
    MetricName("elbow_travel_m", "m", "largest distance of its elbow from where it started; none without an elbow site"),
    MetricName("impasse_attempts", "1", "how often something was tried against an impasse"),
    MetricName("peak_joint_acceleration_rad_s2", "rad/s²", "largest difference quotient of its commanded velocities"),
    MetricName("peak_joint_jerk_rad_s3", "rad/s³", "the same of second order"),
    MetricName("speed_reversals", "1", "how often its joints' speed turned from rising to falling or back"),
    MetricName("smallest_scale", "1", "smallest speed scale"),
    MetricName("scaled_ticks", "1", "ticks with a speed scale below 1"),
    MetricName("longest_scaling_s", "s", "longest time of scaling by one and the same pair"),
    MetricName("distance_decay_s", "s", "time constant of the distance in that time; none where it does not decay"),
    MetricName("speed_decay_s", "s", "the same of its tool's speed"),
    MetricName("closing_decay_s", "s", "the same of the closing rate"),
    MetricName("meet_ttc_held_within_*_percent", "1", "as ttc_held_within, on the way to another arm's tool; of arms that meet one"),
    MetricName("retreat_smallest_scale", "1", "smallest speed scale while it left and everything near opened; of arms that retreat"),
    MetricName("mode_changes", "1", "changes of its mode"),
    MetricName("mode_changes_per_s", "1/s", "the same a second of the run"),
    MetricName("mode_*_ticks", "1", "its ticks in a mode, for every mode that occurred"),
    MetricName("gated_ticks", "1", "ticks in which the gate replaced its command"),
    MetricName("reason_*_ticks", "1", "ticks in which a reason kept its command from what was wanted"),
)  # fmt: skip
"""Metrics of each arm, `<arm>.<name>` in the summary."""


def metric(name: str, arms: Sequence[str]) -> MetricName | None:
    """The metric of this name, if a summary of a cell with these arms can hold one."""
    arm, dot, rest = name.partition(".")
    if dot and arm not in arms:
        return None
    wanted, among = (rest, ARM_METRICS) if dot else (name, CELL_METRICS)
    return next((metric for metric in among if metric.is_that_of(wanted)), None)


def is_metric(name: str, arms: Sequence[str]) -> bool:
    """Whether a summary of a cell with these arms can hold a metric of this name."""
    return metric(name, arms) is not None


def names(arms: Sequence[str]) -> Iterator[str]:
    """All names of a cell with these arms, families with their `*`."""
    yield from (metric.name for metric in CELL_METRICS)
    yield from (f"{arm}.{metric.name}" for arm in arms for metric in ARM_METRICS)

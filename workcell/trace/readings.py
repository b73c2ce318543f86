"""What figures, recordings and metrics all ask of a trace: settings, spans of ticks, smallest distances.

In comes a trace; out come arrays over its ticks, (T,) unless said otherwise, and the few settings
that give them a meaning. Parameters such as t_min come from the trace's metadata entry `settings`,
the resolved scenario, and pairs that are meant to meet from `meeting_pairs`, a list of [geom, geom].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.trace.table import Trace

Floats = NDArray[np.float64]

SCALED_BELOW = 1.0 - 1e-6
"""A factor below it counts as scaling: rounding of a free factor stays far above."""

TTC_REASON = "ttc"
"""What an arm's `reason` says where the time to collision bounds its speed."""
STOPPED_MODES = ("halt", "stop")
"""Modes in which nothing moves by decision, not by scaling."""


@dataclass(frozen=True)
class Span:
    """Ticks `start` to `stop` - 1, in a row."""

    start: int
    """First tick."""
    stop: int
    """Tick after the last."""

    def __len__(self) -> int:
        return self.stop - self.start


def spans(mask: NDArray[np.bool_]) -> list[Span]:
    """The runs of consecutive true entries of a (T,) mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [Span(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def period_s(trace: Trace) -> float:
    """Length of a control tick; 0 for a trace of a single row. Rows may be missing (`workcell salvage`)."""
    time_s, tick = trace["time_s"], trace["tick"]
    return float((time_s[-1] - time_s[0]) / int(tick[-1] - tick[0])) if len(tick) > 1 else 0.0


def control_setting(trace: Trace, key: str) -> float | None:
    """A number of the scenario's `[control]` table, None if the trace does not carry it."""
    value = trace.metadata.get("settings", {}).get("control", {}).get(key)
    return None if value is None else float(value)


def jobs_of(trace: Trace, arm: str) -> list[dict[str, Any]]:
    """The jobs the scenario gives an arm; empty for one that an operator drives."""
    arms = trace.metadata.get("settings", {}).get("arm", [])
    return next((entry.get("job", []) for entry in arms if entry["name"] == arm), [])


def support_arm(trace: Trace) -> str:
    """The arm of lowest priority, whose speed is scaled: by the settings, else the last one."""
    arms = trace.layout.arms
    if not arms:
        raise TraceError(f"{trace.source}: has no arms")
    settings = {
        arm["name"]: arm["priority"] for arm in trace.metadata.get("settings", {}).get("arm", [])
    }
    return max(arms, key=lambda arm: (settings.get(arm, -1), arms.index(arm)))


def smallest_distance_m(trace: Trace, *, apart_only: bool = False) -> Floats:
    """Smallest pair distance of every tick, (T,); infinite where there are no pairs.

    While an arm holds an instrument, the pairs of it with that arm's own hand do not count.

    Args:
        apart_only: Leave out the pairs that are meant to meet.
    """
    return smallest_distances_m(trace, [kept_apart(trace) if apart_only else None])[0]


def kept_apart(trace: Trace) -> NDArray[np.bool_]:
    """(P,) the pairs that are not meant to meet."""
    meeting = {frozenset(pair) for pair in trace.metadata.get("meeting_pairs", [])}
    return np.array([frozenset(pair) not in meeting for pair in trace.layout.pairs], dtype=bool)


def smallest_distances_m(
    trace: Trace, choices: Sequence[NDArray[np.bool_] | None]
) -> tuple[Floats, ...]:
    """`smallest_distance_m` for several choices of pairs (None: all) in one go through the trace, each (T,)."""
    smallest = tuple(np.full(len(trace), np.inf) for _ in choices)
    hands = trace.metadata.get("hands", {})
    holders = trace["holders"] if hands else None
    for start, distance in trace.blocks("pair_distance_m"):
        ticks = slice(start, start + len(distance))
        if holders is not None:
            held_now = np.char.add(np.char.add(" ", holders[ticks].astype(str)), " ")
            for held, pairs in hands.items():
                held_ticks = np.flatnonzero(np.char.find(held_now, f" {held} ") >= 0)
                if held_ticks.size:
                    distance = distance.copy()
                    distance[np.ix_(held_ticks, pairs)] = np.inf
        for values, keep in zip(smallest, choices, strict=True):
            chosen = distance if keep is None else distance[:, keep]
            values[ticks] = chosen.min(axis=1, initial=np.inf)
    return smallest


def joint_columns(trace: Trace, arm: str) -> list[int]:
    """Places of an arm's joints in velocity vectors, by the joints' prefix `<arm>/`."""
    dofs = trace.metadata.get("dofs", {}).get(arm)
    if dofs is not None:
        return [int(k) for k in dofs]
    layout = trace.layout
    if layout.nv != len(layout.joints):
        raise TraceError(
            f"{trace.source}: {len(layout.joints)} joints have {layout.nv} degrees of freedom; "
            "metrics of joints need one each"
        )
    return [k for k, joint in enumerate(layout.joints) if joint.startswith(f"{arm}/")]


def scaled_down(trace: Trace, arm: str) -> NDArray[np.bool_]:
    """Ticks at which the arm is slowed down while nothing has stopped it, (T,)."""
    stopped = np.isin(trace[f"{arm}.mode"].astype(str), STOPPED_MODES)
    return (trace[f"{arm}.scale"] < SCALED_BELOW) & ~stopped


def held_back(trace: Trace, arm: str) -> NDArray[np.bool_]:
    """Ticks at which the time to collision bounds the arm's speed, (T,).

    Where the factor still rises back, the estimate is rightly longer: those are left out.
    """
    return scaled_down(trace, arm) & (trace[f"{arm}.reason"] == TTC_REASON)


def longest_scaling(trace: Trace, arm: str) -> Span | None:
    """The longest run of ticks in which the time to collision of one pair bounds the speed."""
    bound = held_back(trace, arm)
    # An arm brought to a stand has no closing left that could decay.
    bound &= trace[f"{arm}.scale"] > 0
    pair = trace[f"{arm}.limiting_pair"]
    found = [
        span
        for index in np.unique(pair[bound & (pair >= 0)])
        for span in spans(bound & (pair == index))
    ]
    return max(found, key=len, default=None)

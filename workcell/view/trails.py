"""Where tools were, where they should be and where they go next, as lines and points of a recording.

In comes a trace; for each arm out come `target` (a point), `trail` (the tool's last seconds) and
`path_ahead` (what its target does in the next seconds, faded). A live arm's path ahead is known here
because the run is over.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from workcell.trace.readings import period_s
from workcell.trace.table import Trace
from workcell.view.columns import send
from workcell.view.palette import arm_colour

TRAIL_S = 2.0
"""Chosen so that the shape of a motion is seen and older ones do not cover it."""
AHEAD_S = 3.0
"""Chosen a little longer than the times to collision that act."""
LINE_PERIOD_S = 0.1
"""Time between two lines; ten a second look fluent."""
POINT_PERIOD_S = 0.05
"""Time between two points of a line."""
_TARGET_RADIUS_M = 0.012
_TRAIL_RADIUS_M = 0.004
_AHEAD_RADIUS_M = 0.003
_AHEAD_ALPHA = 120


def log_trails(recording: rr.RecordingStream, trace: Trace, rows: NDArray[np.int64]) -> None:
    """Log target, trail and path ahead of every arm; targets at the given rows of the trace."""
    dt_s = period_s(trace) or POINT_PERIOD_S
    every = max(1, round(POINT_PERIOD_S / dt_s))
    lines = np.arange(0, len(trace), max(1, round(LINE_PERIOD_S / dt_s)))
    back = np.arange(-round(TRAIL_S / POINT_PERIOD_S), 1) * every
    ahead = np.arange(0, round(AHEAD_S / POINT_PERIOD_S) + 1) * every
    for index, arm in enumerate(trace.layout.arms):
        colour = arm_colour(index)
        tool_m = trace[f"{arm}.tool_position_m"].astype(np.float32)
        target_m = trace[f"{arm}.target_position_m"].astype(np.float32)
        entity = f"world/{arm}/target"
        recording.log(
            entity,
            rr.Points3D.from_fields(colors=[list(colour)], radii=[_TARGET_RADIUS_M]),
            static=True,
        )
        send(
            recording, trace, entity, rows,
            lambda s, at=target_m[rows]: rr.Points3D.columns(positions=at[s]),
        )  # fmt: skip
        for name, position_m, shifts, rgba, radius_m in (
            ("trail", tool_m, back, [*colour, 255], _TRAIL_RADIUS_M),
            ("path_ahead", target_m, ahead, [*colour, _AHEAD_ALPHA], _AHEAD_RADIUS_M),
        ):
            entity = f"world/{arm}/{name}"
            recording.log(
                entity, rr.LineStrips3D.from_fields(colors=[rgba], radii=[radius_m]), static=True
            )
            # Before the first row and after the last one the line is shorter: its end is repeated.
            points = np.clip(lines[:, None] + shifts, 0, len(trace) - 1)
            send(
                recording, trace, entity, lines,
                lambda s, at=position_m[points]: rr.LineStrips3D.columns(strips=at[s]),
            )  # fmt: skip

"""The layout of views with which a recording opens."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from workcell.trace.readings import control_setting
from workcell.trace.table import Trace
from workcell.view.frames import Frames
from workcell.view.limits import FALLBACK_T_MIN_S, TTC_CAP_IN_T_MIN

VIEW_NAMES = (
    "Cell", "Events", "Time to collision [s]", "Smallest distance [m]", "ARTC [1/s]",
    "Tool speed [m/s]", "Scale", "Mode", "Verdict",
)  # fmt: skip

_LANE_SHARE = 0.75
"""Height of a lane of modes, in the measure of the curves; one lane more is for title and axis."""


def layout(trace: Trace, frames: Frames) -> rrb.Blueprint:
    t_min_s = control_setting(trace, "t_min_s") or FALLBACK_T_MIN_S

    def plot(origin: str, name: str, top: float | None = None) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
            axis_y=None if top is None else rrb.ScalarAxis(range=(0.0, top)),
            plot_legend=rrb.PlotLegend(corner="RightTop"),
        )

    eye = frames.centre_m + frames.extent_m * np.array([0.35, -1.35, 0.75])
    cell = rrb.Spatial3DView(
        origin="/world",
        name="Cell",
        background=[28, 28, 34],
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=tuple(eye), look_target=tuple(frames.centre_m), eye_up=(0, 0, 1)
        ),
    )
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.TextLogColumns(
            timeline_columns=["sim_time"], text_log_columns=["loglevel", "body"]
        ),
    )
    verdict = rrb.TextDocumentView(origin="/verdict", name="Verdict")
    curves = rrb.Vertical(
        plot("/ttc", "Time to collision [s]", TTC_CAP_IN_T_MIN * t_min_s),
        plot("/distance", "Smallest distance [m]"),
        plot("/artc", "ARTC [1/s]"),
        plot("/tool_speed", "Tool speed [m/s]"),
        plot("/scale", "Scale", 1.05),
        rrb.StateTimelineView(origin="/mode", name="Mode"),
        row_shares=[3, 2, 2, 2, 1.5, _LANE_SHARE * (2 + len(trace.layout.arms))],
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(cell, rrb.Horizontal(events, verdict), row_shares=[3, 1]),
            curves,
            column_shares=[1.1, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )

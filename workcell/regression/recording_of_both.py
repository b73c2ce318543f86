"""A run and its reference in one recording: curves of both in every view, and the verdict in words.

Comes in: two excerpts and their comparison. Goes out: a recording with a view for each quantity that
differs, in the order in which they moved, on one common time axis. It shows curves only; for the cell
in motion open the runs' own recordings.
"""

from __future__ import annotations

import os
import uuid
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from workcell.regression.compare import Comparison
from workcell.regression.excerpt import Excerpt
from workcell.regression.overlay import series
from workcell.view.palette import COMMANDED

VIEWS = 8
"""Quantities with a view of their own; beyond it they would be too low to read."""
REFERENCE_RGB = (170, 170, 170)


def record(run: Excerpt, reference: Excerpt, result: Comparison, out_rrd: Path) -> Path:
    """Write the recording; two runs that agree are shown in the usual quantities.

    Returns:
        The path written; the file appears whole or not at all.
    """
    drawn = [d for d in result.differences if d.largest is not None][:VIEWS]
    curves = {d.column: d.entry for d in drawn} or {"ttc_s": None, "qpos": 0}
    period_s = float(reference.identity.settings.get("simulation", {}).get("period_s", 1.0))
    temporary = out_rrd.with_name(out_rrd.name + ".part")
    rr.set_strict_mode(True)
    recording = rr.RecordingStream(
        "workcell_compare", recording_id=str(uuid.uuid4()), send_properties=False
    )
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    recording.save(temporary)
    try:
        recording.send_blueprint(_layout(list(curves)))
        recording.send_recording_name(f"{run.source} against {reference.source}")
        recording.log("verdict", rr.TextDocument(_words(result)), static=True)
        for name, entry in curves.items():
            mine, theirs = series(run, reference, name, entry)
            # The reference comes first, so that the run is drawn over it.
            for who, part, values, colour, width in (
                ("reference", reference, theirs, REFERENCE_RGB, 4.0),
                ("run", run, mine, COMMANDED, 1.5),
            ):
                entity = f"{_entity(name)}/{who}"
                recording.log(
                    entity,
                    rr.SeriesLines(names=[who], colors=[list(colour)], widths=[width]),
                    static=True,
                )
                nanoseconds = np.round(part.ticks * period_s * 1e9).astype("timedelta64[ns]")
                recording.send_columns(
                    entity,
                    [
                        rr.TimeColumn("sim_time", duration=nanoseconds),
                        rr.TimeColumn("tick", sequence=part.ticks),
                    ],
                    # Infinity draws a gap, as null should.
                    rr.Scalars.columns(scalars=np.where(np.isnan(values), np.inf, values)),
                )
        recording.flush()
    finally:
        recording.disconnect()
    os.replace(temporary, out_rrd)
    return out_rrd


def _layout(names: list[str]) -> rrb.Blueprint:
    plots = [
        rrb.TimeSeriesView(
            origin=_entity(name),
            name=name,
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
            plot_legend=rrb.PlotLegend(corner="RightTop"),
        )
        for name in names
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*plots),
            rrb.TextDocumentView(origin="verdict", name="Verdict"),
            column_shares=[3, 1],
        ),
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _entity(name: str) -> str:
    """An entity path: dots and bars of a column's name have meanings of their own there."""
    return "/curve/" + name.replace(".", "_").replace("|", "_")


def _words(result: Comparison) -> str:
    lines = [result.headline(), ""]
    lines += [
        f"{d.first_time_s:.3f} s  {d.stage}  {d.column}: {d.run} instead of {d.reference}"
        for d in result.differences
    ]
    return "\n".join(lines)

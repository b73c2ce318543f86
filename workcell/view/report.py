"""The report of a run: one HTML file that opens anywhere, also without a network.

In come a trace, its scene and its summary; out comes the page: verdict and why, curves that can be
zoomed, four instants of the cell, events, versions, and how to make the run again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.trace.readings import control_setting, period_s, smallest_distance_m, spans
from workcell.trace.table import Trace
from workcell.view.events import events_of, lanes
from workcell.view.instants import time_stamps
from workcell.view.limits import FALLBACK_T_MIN_S, TTC_CAP_IN_T_MIN
from workcell.view.page import Page, css, plotly, thinned
from workcell.view.palette import (
    COMMANDED,
    LIMIT,
    MEASURED,
    MODE_COLOURS,
    OTHER_MODE,
    Rgb,
    arm_colour,
)
from workcell.view.stills import NoPictures, render
from workcell.view.verdict import headline

EVENTS = 400
"""Events that are listed; more are counted, and all are in the recording."""
_PICTURE_PX = (640, 480)
_PANELS = (
    "time to collision [s]", "smallest distance [m]", "tool speed [m/s]", "ARTC [1/s]", "scale", "mode",
)  # fmt: skip


def report(
    trace: Trace,
    scene_xml: Path | str,
    summary: Mapping[str, Any] | None,
    out_html: Path,
    *,
    again: str,
) -> Path:
    """Write the report of a run.

    Args:
        trace: The run.
        scene_xml: Its scene, for the pictures.
        summary: Its summary; None for a run that was killed before it had one.
        out_html: File to write; it appears whole or not at all.
        again: The command that makes the run again.

    Raises:
        TraceError: The trace has no rows.
        InputError: plotly is not installed.
    """
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to report on")
    plotly()
    settings = trace.metadata.get("settings", {})
    page = Page(f"{settings.get('name', trace.source.parent.name)}: a run of workcell")
    _verdict(page, summary)
    page.heading("Curves")
    page.text(
        "Drag to zoom, double click to go back; a click in the legend hides a curve.", "faint"
    )
    page.figure(_curves(trace), 980)
    _instants(page, trace, scene_xml)
    _events(page, trace)
    _origin(page, trace, again)
    temporary = out_html.with_name(out_html.name + ".part")
    temporary.write_text(page.write(), encoding="utf-8")
    os.replace(temporary, out_html)
    return out_html


def _verdict(page: Page, summary: Mapping[str, Any] | None) -> None:
    if summary is None:
        page.text("This run has no summary: it did not come to its end.", "bad")
        return
    page.text(headline(summary), "good" if summary["held"] else "bad")
    why = summary.get("why") or ()
    for line in [why] if isinstance(why, str) else why:
        page.text(str(line))
    if summary["expectations"]:
        page.table(
            ["expectation", "wanted", "measured", "held"],
            [
                [name, v["wanted"], v["measured"], "yes" if v["held"] else "NO"]
                for name, v in summary["expectations"].items()
            ],
        )
    page.heading("Metrics")
    known = {k: v for k, v in summary["metrics"].items() if v is not None}
    page.table(["metric", "value"], [[k, _text(v)] for k, v in known.items()], scroll=True)


def _curves(trace: Trace) -> Any:
    from plotly.subplots import make_subplots

    objects = plotly()
    figure = make_subplots(
        rows=len(_PANELS), cols=1, shared_xaxes=True, vertical_spacing=0.025,
        row_heights=[3, 2, 2, 2, 1.4, 0.5 + 0.45 * len(lanes(trace))],
    )  # fmt: skip
    time_s = trace["time_s"]
    told: set[str] = set()

    def line(
        row: int,
        name: str,
        values: NDArray[np.float64],
        colour: Rgb,
        *,
        least: bool,
        dash: str = "",
    ) -> None:
        places, shown = thinned(values, least)
        figure.add_trace(
            objects.Scatter(
                x=time_s[places].astype(np.float32),
                y=shown,
                name=name,
                legendgroup=name,
                showlegend=name not in told,
                mode="lines",
                line={"color": css(colour), "width": 1.6, "dash": dash or None},
            ),
            row=row,
            col=1,
        )
        told.add(name)

    def level(row: int, name: str, value: float | None) -> None:
        if value is not None:
            figure.add_hline(
                y=value, line={"color": css(LIMIT), "width": 1}, row=row, col=1,  # pyright: ignore[reportArgumentType] (annotated as str, taken as int)
                annotation_text=name, annotation_position="bottom right",
            )  # fmt: skip

    t_min_s = control_setting(trace, "t_min_s")
    cap_s = TTC_CAP_IN_T_MIN * (t_min_s or FALLBACK_T_MIN_S)
    line(
        1, "commanded", np.minimum(trace["ttc_command_s"], cap_s), COMMANDED, least=True, dash="dot"
    )
    line(1, "measured", np.minimum(trace["ttc_s"], cap_s), MEASURED, least=True)
    level(1, "t_min", t_min_s)
    distance_m = smallest_distance_m(trace)
    line(2, "measured", np.where(np.isinf(distance_m), np.nan, distance_m), MEASURED, least=True)
    if np.isfinite(trace["check_distance_m"]).any():
        line(2, "final check", trace["check_distance_m"], COMMANDED, least=True, dash="dash")
    level(2, "d_min", control_setting(trace, "d_min_m"))
    for index, arm in enumerate(trace.layout.arms):
        for row, column, least in (
            (3, "tool_speed_m_s", False),
            (4, "artc_per_s", False),
            (5, "scale", True),
        ):
            line(row, arm, trace[f"{arm}.{column}"], arm_colour(index), least=least)
    _mode_bars(figure, trace, row=len(_PANELS))
    for row, title in enumerate(_PANELS, 1):
        figure.update_yaxes(title_text=title, row=row, col=1, title_font_size=11)
    figure.update_xaxes(title_text="time [s]", row=len(_PANELS), col=1)
    figure.update_layout(hovermode="x unified", barmode="overlay")
    return figure


def _mode_bars(figure: Any, trace: Trace, *, row: int) -> None:
    """A lane for the cell and every arm, a colour for every mode."""
    objects, dt_s, time_s = plotly(), period_s(trace), trace["time_s"]
    found: dict[str, tuple[list[str], list[float], list[float]]] = {}
    for lane, mode in lanes(trace).items():
        for name in sorted(set(mode)):
            names, lengths, starts = found.setdefault(name, ([], [], []))
            for span in spans(mode == name):
                names.append(lane)
                lengths.append(round(len(span) * dt_s, 4))
                starts.append(round(float(time_s[span.start]), 4))
    for name, (names, lengths, starts) in found.items():
        figure.add_trace(
            objects.Bar(
                y=names, x=lengths, base=starts, orientation="h", name=f"mode {name}",
                marker={"color": css(MODE_COLOURS.get(name, OTHER_MODE)), "line": {"width": 0}},
                hovertemplate=f"{name}<extra></extra>",
            ),
            row=row, col=1,
        )  # fmt: skip
    figure.update_yaxes(autorange="reversed", row=row, col=1)


def _instants(page: Page, trace: Trace, scene_xml: Path | str) -> None:
    page.heading("Four instants")
    stamps = time_stamps(trace)
    width, height = _PICTURE_PX
    try:
        pictures = render(
            scene_xml, trace.part("qpos", np.array(stamps)), width=width, height=height,
            arms=trace.layout.arms,
        )  # fmt: skip
    except NoPictures as error:
        page.text(str(error), "faint")
        return
    distance_m, time_s = smallest_distance_m(trace), trace["time_s"]
    captions = [
        f"{k}: {time_s[tick]:.2f} s"
        + (f", {1000 * distance_m[tick]:.0f} mm" if np.isfinite(distance_m[tick]) else "")
        for k, tick in enumerate(stamps, 1)
    ]
    page.pictures(list(zip(captions, pictures, strict=True)))


def _events(page: Page, trace: Trace) -> None:
    page.heading("Events")
    events, time_s = events_of(trace), trace["time_s"]
    page.table(
        ["time", "event"],
        [[f"{time_s[event.row]:.3f} s", event.text] for event in events[:EVENTS]],
        scroll=True,
    )
    if len(events) > EVENTS:
        page.text(f"and {len(events) - EVENTS} more, which the recording has", "faint")


def _origin(page: Page, trace: Trace, again: str) -> None:
    page.heading("Make it again")
    page.code(again)
    rows: list[Sequence[str]] = [
        ["scenario", str(trace.metadata.get("scenario", ""))],
        ["trace", trace.digest()],
        ["platform", str(trace.metadata.get("platform", ""))],
        *[[name, str(value)] for name, value in trace.metadata.get("versions", {}).items()],
    ]
    page.table(["of", "hash or version"], rows)


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)

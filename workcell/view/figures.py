"""The figures of the source paper, drawn from a trace.

In come a trace and its scene; out come PNG files: `figure3.png` (time to collision over the speed
of the support arm), `figure4.png` (ARTC of every arm), `figure5.png` (the cell at four instants)
and `overview.png` (all of a run on one page), each also as PDF and SVG. The same trace gives the same bytes.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from workcell.errors import InputError, TraceError
from workcell.trace.readings import (
    control_setting,
    period_s,
    scaled_down,
    smallest_distance_m,
    spans,
    support_arm,
)
from workcell.trace.table import Trace
from workcell.view.instants import time_stamps
from workcell.view.limits import TTC_CAP_IN_T_MIN
from workcell.view.palette import (
    COMMANDED,
    LIMIT,
    MEASURED,
    MODE_COLOURS,
    OTHER_MODE,
    arm_colour,
    unit_rgb,
)
from workcell.view.stills import NoPictures, render

_log = logging.getLogger(__name__)
_STYLE: dict[Any, Any] = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "svg.hashsalt": "workcell",
}
_DPI = 150
_UNDATED: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    "svg": {"Date": None, "Creator": None},
}
_SCALING_SHADE = (0.98, 0.93, 0.75)


FORMATS = ("png", "pdf", "svg")


def paper_figures(
    trace: Trace, scene_xml: Path | str, out_dir: Path | str, *, formats: Sequence[str] = ("png",)
) -> list[Path]:
    """Draws the figures.

    Args:
        trace: The run.
        scene_xml: Its scene, for the pictures of the cell.
        out_dir: Folder for the files, made if it is missing.
        formats: Some of `FORMATS`; every figure is written in each.

    Returns:
        The files written. `figure5` is left out, with a warning that says why, where nothing
        can draw the scene.

    Raises:
        TraceError: The trace has no rows or no arms.
        InputError: A format that is none of `FORMATS`.
    """
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to draw")
    unknown = sorted(set(formats) - set(FORMATS))
    if unknown:
        raise InputError(f"format {', '.join(unknown)}: allowed is {', '.join(FORMATS)}")
    folder = Path(out_dir)
    folder.mkdir(parents=True, exist_ok=True)
    stamps = time_stamps(trace)
    figures: dict[str, Callable[[], Figure]] = {
        "figure3": lambda: _time_to_collision_and_speed(trace, stamps),
        "figure4": lambda: _artc(trace, stamps),
        "figure5": lambda: _cell(trace, scene_xml, stamps),
        "overview": lambda: _overview(trace, stamps),
    }
    written = []
    for name, draw in figures.items():
        try:
            with matplotlib.rc_context(_STYLE):
                figure = draw()
                written += [_save(figure, folder / f"{name}.{kind}") for kind in formats]
        except NoPictures as error:
            _log.warning("%s is left out: %s", name, error)
    return written


def _save(figure: Figure, path: Path) -> Path:
    """Writes the figure whole or not at all, without the version and date that would change its bytes."""
    temporary = path.with_name(path.name + ".part")
    figure.align_ylabels()
    FigureCanvasAgg(figure)
    kind = path.suffix.removeprefix(".")
    figure.savefig(temporary, format=kind, dpi=_DPI, metadata=_UNDATED[kind])
    os.replace(temporary, path)
    return path


def _time_to_collision_and_speed(trace: Trace, stamps: tuple[int, ...]) -> Figure:
    """Figure 3 of the paper."""
    figure = Figure(figsize=(9, 5.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    _draw_ttc(above, trace)
    _draw_speed(below, trace, (support_arm(trace),))
    below.set_xlabel("time [s]")
    _mark(trace, stamps, above, below)
    return figure


def _artc(trace: Trace, stamps: tuple[int, ...]) -> Figure:
    """Figure 4 of the paper."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    axes = figure.subplots()
    _draw_artc(axes, trace)
    axes.set_xlabel("time [s]")
    _mark(trace, stamps, axes)
    return figure


def _cell(trace: Trace, scene_xml: Path | str, stamps: tuple[int, ...]) -> Figure:
    """Figure 5 of the paper."""
    pictures = render(
        scene_xml, trace["qpos"][list(stamps)], width=800, height=600, arms=trace.layout.arms
    )
    figure = Figure(figsize=(9, 7.2), layout="constrained")
    distance_m = smallest_distance_m(trace)
    panels = figure.subplots(2, 2).ravel()
    for k, (axes, tick, picture) in enumerate(zip(panels, stamps, pictures, strict=True), 1):
        axes.imshow(picture)
        axes.set_axis_off()
        gap = f", {1000 * distance_m[tick]:.0f} mm" if np.isfinite(distance_m[tick]) else ""
        axes.set_title(f"{k}   {trace['time_s'][tick]:.2f} s{gap}", loc="left")
    return figure


def _overview(trace: Trace, stamps: tuple[int, ...]) -> Figure:
    figure = Figure(figsize=(10, 11), layout="constrained")
    panels = figure.subplots(6, 1, sharex=True, height_ratios=[3, 2, 2, 2, 1.5, 1.2])
    ttc, distance, speed, artc, scale, mode = panels
    _draw_ttc(ttc, trace)
    _draw_distance(distance, trace)
    _draw_speed(speed, trace, trace.layout.arms)
    _draw_artc(artc, trace)
    _draw_per_arm(scale, trace, "scale", "factor", trace.layout.arms)
    scale.set_ylim(0, 1.08)
    _mark(trace, stamps, ttc, distance, speed, artc, scale)
    _draw_modes(mode, trace)
    mode.set_xlabel("time [s]")
    return figure


def _draw_ttc(axes: Axes, trace: Trace) -> None:
    time_s = trace["time_s"]
    t_min_s = control_setting(trace, "t_min_s")
    measured, commanded = trace["ttc_s"], trace["ttc_command_s"]
    cap_s = None if t_min_s is None else TTC_CAP_IN_T_MIN * t_min_s

    def capped(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return values if cap_s is None else np.minimum(values, cap_s)

    axes.plot(time_s, capped(measured), color=unit_rgb(MEASURED), lw=2.2, label="measured")
    dashed = {"color": unit_rgb(COMMANDED), "lw": 1.2, "ls": (0, (4, 3))}
    axes.plot(time_s, capped(commanded), label="commanded", **dashed)
    if t_min_s is not None:
        axes.axhline(
            t_min_s, color=unit_rgb(LIMIT), lw=1.0, zorder=1, label=f"$t_{{min}}$ = {t_min_s:g} s"
        )
        axes.set_ylim(0, cap_s)
    axes.set_ylabel("time to collision [s]")
    _legend(axes)


def _draw_distance(axes: Axes, trace: Trace) -> None:
    time_s = trace["time_s"]
    axes.plot(time_s, smallest_distance_m(trace), color=unit_rgb(MEASURED), label="capsules")
    check = trace["check_distance_m"]
    if np.isfinite(check).any():
        axes.plot(time_s, check, color=unit_rgb(COMMANDED), ls="--", label="final check")
    d_min_m = control_setting(trace, "d_min_m")
    if d_min_m is not None:
        label = f"$d_{{min}}$ = {1000 * d_min_m:g} mm"
        axes.axhline(d_min_m, color=unit_rgb(LIMIT), lw=1.2, label=label)
    axes.set_ylabel("distance [m]")
    _legend(axes)


def _draw_speed(axes: Axes, trace: Trace, arms: tuple[str, ...]) -> None:
    _draw_per_arm(axes, trace, "tool_speed_m_s", "tool speed [m/s]", arms)
    axes.set_ylim(bottom=0)


def _draw_artc(axes: Axes, trace: Trace) -> None:
    _draw_per_arm(axes, trace, "artc_per_s", "ARTC [1/s]", trace.layout.arms)


def _draw_per_arm(axes: Axes, trace: Trace, column: str, label: str, arms: tuple[str, ...]) -> None:
    for arm in arms:
        colour = unit_rgb(arm_colour(trace.layout.arms.index(arm)))
        axes.plot(trace["time_s"], trace[f"{arm}.{column}"], color=colour, label=arm)
    axes.set_ylabel(label)
    _legend(axes)


def _draw_modes(axes: Axes, trace: Trace) -> None:
    """A lane of coloured bars for the cell and for every arm."""
    time_s, dt_s = trace["time_s"], period_s(trace)
    lanes = {"cell": trace["mode"]} | {arm: trace[f"{arm}.mode"] for arm in trace.layout.arms}
    shown = {}
    for height, mode in enumerate(lanes.values()):
        for name in sorted(set(mode)):
            bars = [(float(time_s[span.start]), len(span) * dt_s) for span in spans(mode == name)]
            colour = unit_rgb(MODE_COLOURS.get(name, OTHER_MODE))
            shown[name] = axes.broken_barh(bars, (height - 0.4, 0.8), color=colour)
    axes.set_yticks(range(len(lanes)), list(lanes))
    axes.invert_yaxis()
    axes.grid(False)
    _legend(axes, shown)


def _legend(axes: Axes, entries: dict[str, Any] | None = None) -> None:
    """Beside the axes, where it hides no curve."""
    handles = [] if entries is None else [list(entries.values()), list(entries)]
    axes.legend(*handles, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _mark(trace: Trace, stamps: tuple[int, ...], *panels: Axes) -> None:
    """Shades where the support arm is scaled and draws the four instants, numbered on top."""
    time_s, dt_s = trace["time_s"], period_s(trace)
    scaled = spans(scaled_down(trace, support_arm(trace)))
    for axes in panels:
        for span in scaled:
            start_s = float(time_s[span.start])
            stop_s = start_s + len(span) * dt_s
            axes.axvspan(start_s, stop_s, color=_SCALING_SHADE, zorder=0, lw=0)
        for tick in stamps:
            axes.axvline(float(time_s[tick]), color="0.45", lw=0.9, ls=":")
        axes.set_xlim(float(time_s[0]), float(time_s[-1]) + dt_s)
    for k, tick in enumerate(stamps, 1):
        panels[0].annotate(
            str(k), (float(time_s[tick]), 1.0), xycoords=("data", "axes fraction"),
            xytext=(0, 4), textcoords="offset points", ha="center", va="bottom", fontweight="bold",
        )  # fmt: skip

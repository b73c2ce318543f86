"""Two pictures of a sweep: how often things happened, and how its numbers are spread.

Comes in: the rows of a sweep. Goes out: `rates.png`, each event's rate with its exact interval a
setting, and `spreads.png`, the empirical distribution of each quantity a setting.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from workcell.study.report import EVENTS, QUANTITIES, Row, by_setting, made, values
from workcell.study.statistics import rate
from workcell.view.palette import arm_colour, unit_rgb

_STROKES = ("-", "--", ":", "-.")
"""Of settings: two that behave alike lie on each other."""


def draw(rows: list[Row], folder: Path) -> list[Path]:
    """Draw both pictures into a folder, made if missing; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    return [_rates(rows, folder / "rates.png"), _spreads(rows, folder / "spreads.png")]


def _rates(rows: list[Row], path: Path) -> Path:
    settings = by_setting(rows)
    figure = Figure(figsize=(8, 1.5 + 0.45 * len(EVENTS)), layout="constrained")
    axes = figure.add_subplot()
    for k, (name, of_setting) in enumerate(settings.items()):
        runs = made(of_setting)
        found = [rate(sum(map(event.happened, runs)), len(runs)) for event in EVENTS]
        share = np.array([100.0 * r.count / max(1, r.runs) for r in found])
        ends = 100.0 * np.array([[r.low, r.high] for r in found]).T
        axes.errorbar(
            share,
            np.arange(len(EVENTS)) + 0.15 * (k - (len(settings) - 1) / 2),
            xerr=np.abs(ends - share),
            fmt="o",
            capsize=3,
            color=unit_rgb(arm_colour(k)),
            label=f"{name or 'as in the file'} ({len(runs)} runs)",
        )
    axes.set_yticks(range(len(EVENTS)), [event.name for event in EVENTS])
    axes.invert_yaxis()
    axes.set_xlabel("share of the runs, %, with 95 % interval")
    axes.set_xlim(-2, 102)
    axes.grid(alpha=0.25)
    axes.legend(fontsize="small")
    return _save(figure, path)


def _spreads(rows: list[Row], path: Path) -> Path:
    settings = by_setting(rows)
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    lines: dict[
        str, Line2D
    ] = {}  # a setting that has never done its jobs has no line in the first axes
    for axes, quantity in zip(
        figure.subplots(2, len(QUANTITIES) // 2 + 1).flat, QUANTITIES, strict=False
    ):
        for k, (name, of_setting) in enumerate(settings.items()):
            shown = values(made(of_setting), quantity)
            shown = np.sort(shown[np.isfinite(shown)])
            if len(shown):
                share = np.arange(1, len(shown) + 1) / len(shown)
                lines[name] = axes.step(
                    shown,
                    share,
                    where="post",
                    color=unit_rgb(arm_colour(k)),
                    linestyle=_STROKES[k % len(_STROKES)],
                )[0]
        axes.set_xlabel(quantity.name, fontsize="small")
        axes.set_ylim(0, 1.02)
        axes.grid(alpha=0.25)
    for axes in figure.axes[len(QUANTITIES) :]:
        axes.set_axis_off()
    named = {name: lines[name] for name in settings if name and name in lines}
    if named:
        figure.axes[len(QUANTITIES)].legend(
            named.values(), named.keys(), loc="center", fontsize="small", handlelength=3.5
        )
    figure.supylabel("share of the runs at or below")
    return _save(figure, path)


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=110)
    return path

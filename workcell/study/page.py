"""The report of a sweep: one HTML file with rates, distributions and the worst runs.

Comes in: the folder of a sweep. Goes out: the page; and for each of its worst runs a run folder (from
`failures/`, or made again into `worst/`), its picture at the nearest instant and the command that makes
it again.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import numpy as np

from workcell import run as runner
from workcell.errors import InputError, TraceError
from workcell.study import sweep as study
from workcell.study.folder import FAILURES_FOLDER, folder_name, read_asked
from workcell.study.report import (
    EVENTS,
    QUANTITIES,
    Row,
    by_setting,
    command_line,
    made,
    read,
    values,
)
from workcell.study.statistics import rate
from workcell.trace.readings import smallest_distance_m
from workcell.trace.table import Trace, load
from workcell.view.page import Page, css, plotly
from workcell.view.palette import arm_colour
from workcell.view.stills import NoPictures, render

WORST = 4
"""Runs that are shown; each may have to be made again, which takes as long as a run."""
WORST_FOLDER = "worst"
_PICTURE_PX = (640, 480)


def report(out: Path, out_html: Path) -> Path:
    """Write the report of a sweep's folder.

    Raises:
        InputError: plotly is not installed, or the folder holds no sweep.
    """
    plotly()
    asked, rows = read_asked(out), read(out)
    page = Page(f"{asked['scenario']}: {len(rows)} runs of a sweep")
    counts = {name: len(made(r)) for name, r in by_setting(rows).items()}
    runs = 1 + max((row["run"] for row in rows), default=0)
    options = {key: asked[key] for key in ("seed", "compare", "set")}
    page.code(command_line("sweep", asked["scenario"], {"runs": runs} | options))
    page.text("; ".join(f"{name or 'as in the file'}: {n} runs" for name, n in counts.items()))
    _rates(page, rows)
    _distributions(page, rows)
    _worst(page, rows, asked, out)
    page.heading("Versions")
    page.table(["of", "version"], [[k, str(v)] for k, v in asked["versions"].items()])
    temporary = out_html.with_name(out_html.name + ".part")
    temporary.write_text(page.write(), encoding="utf-8")
    temporary.replace(out_html)
    return out_html


def _rates(page: Page, rows: list[Row]) -> None:
    page.heading("Rates, with exact 95 % intervals")
    settings = by_setting(rows)
    page.table(
        ["event", *(name or "as in the file" for name in settings)],
        [
            [
                event.name,
                *(
                    str(rate(sum(map(event.happened, made(r))), len(made(r))))
                    for r in settings.values()
                ),
            ]
            for event in EVENTS
        ],
    )


def _distributions(page: Page, rows: list[Row]) -> None:
    from plotly.subplots import make_subplots

    page.heading("Distributions: share of the runs at or below")
    objects, columns = plotly(), 2
    lines = -(-len(QUANTITIES) // columns)
    figure = make_subplots(
        rows=lines, cols=columns, vertical_spacing=0.09, subplot_titles=[q.name for q in QUANTITIES]
    )
    for place, quantity in enumerate(QUANTITIES):
        for k, (name, of_setting) in enumerate(by_setting(rows).items()):
            shown = values(made(of_setting), quantity)
            order = np.argsort(shown)
            order = order[np.isfinite(shown[order])]
            label = name or "as in the file"
            figure.add_trace(
                objects.Scatter(
                    x=shown[order], y=np.arange(1, len(order) + 1) / max(1, len(order)),
                    text=[f"run {made(of_setting)[i]['run']}" for i in order],
                    name=label, legendgroup=label, showlegend=place == 0,
                    line={"shape": "hv", "color": css(arm_colour(k))}, mode="lines+markers",
                    marker={"size": 4},
                ),
                row=place // columns + 1, col=place % columns + 1,
            )  # fmt: skip
    figure.update_annotations(font_size=12)
    page.figure(figure, 260 * lines)


def _worst(page: Page, rows: list[Row], asked: dict[str, Any], out: Path) -> None:
    page.heading("Worst runs")
    runs = made(rows)
    # A run that failed is worse than any that came through; among equals the nearer one is.
    runs.sort(key=lambda row: (row["success"], _distance(row)))
    pictures, lines = [], []
    for row in runs[:WORST]:
        told = f"run {row['run']}{', ' + row['setting'] if row['setting'] else ''}"
        try:
            folder = _folder(row, asked, out)
            trace = load(folder)
            pictures.append((told, _picture(trace, folder)))
        except (InputError, TraceError, NoPictures) as error:
            lines.append([told, _fate(row), _nearest(row), str(error)])
            continue
        scenario = folder / runner.SCENARIO_FILE
        command = shlex.join(["workcell", "run", str(scenario), "--out", f"{folder.name}_again"])
        lines.append([told, _fate(row), _nearest(row), command])
    page.table(["run", "ended", "nearest", "make it again"], lines)
    if pictures:
        page.pictures(pictures)


def _folder(row: Row, asked: dict[str, Any], out: Path) -> Path:
    """The run folder of a run: kept since it failed, kept by an earlier report, or made again."""
    name = folder_name(row["run"], row["setting"])
    for folder in (out / FAILURES_FOLDER / name, out / WORST_FOLDER / name):
        if (folder / runner.SUMMARY_FILE).is_file():
            return folder
    plan = study.plan(
        asked["scenario"], runs=row["run"] + 1, seed=asked["seed"],
        compare=tuple(asked["compare"]), overrides=tuple(asked["set"]),
    )  # fmt: skip
    if plan.asked["content_sha256"] != asked["content_sha256"]:
        raise InputError("the scenario has changed since the sweep", file=asked["scenario"])
    variations = plan.variations[row["setting"]]
    scenario = variations.scenario(variations.draw(asked["seed"], row["run"]))
    runner.run(scenario, out / WORST_FOLDER / name)
    return out / WORST_FOLDER / name


def _picture(trace: Trace, folder: Path) -> Any:
    width, height = _PICTURE_PX
    tick = np.array([int(np.argmin(smallest_distance_m(trace, apart_only=True)))])
    scene_xml = folder / runner.SCENE_FOLDER / runner.SCENE_FILE
    return render(
        scene_xml, trace.part("qpos", tick), width=width, height=height, arms=trace.layout.arms
    )[0]


def _distance(row: Row) -> float:
    return np.inf if row["smallest_m"] is None else row["smallest_m"]


def _nearest(row: Row) -> str:
    if row["smallest_m"] is None:
        return "none"
    return f"{1000 * row['smallest_m']:.1f} mm, {row['smallest_pair']}"


def _fate(row: Row) -> str:
    if row["success"]:
        return "success"
    if row["contact_pair"]:
        return f"contact of {row['contact_pair']}"
    for name in ("halted", "impasse"):
        if row[name]:
            return name
    return row["reason"] or ("done" if row["done"] else "not done")

"""The commands that show a run: replay, plot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell.cli.extras import needs
from workcell.cli.options import RunFolder
from workcell.cli.terminal import FAILED, OK, stdout
from workcell.errors import InputError


def replay(
    run: RunFolder,
    /,
    web: Annotated[bool, tyro.conf.arg(help="in a browser instead of the native viewer")] = False,
) -> int:
    """Open a run in the rerun viewer; its recording is rebuilt from the trace where it is missing or outdated."""
    from workcell.run import rebuild_recording
    from workcell.view.viewer import open_viewer

    viewer = open_viewer(rebuild_recording(run), web=web)
    stdout.print(f"{describe(run)}, in the rerun viewer", markup=False)
    if web:
        stdout.print(f"open {viewer.address}", markup=False)
        stdout.print(f"from another machine first: {viewer.ssh_command}", markup=False)
        stdout.print("Ctrl-C ends it", markup=False)
    try:
        ended = viewer.process.wait()
    except KeyboardInterrupt:
        # The viewer gets the same signal, and ends as well.
        viewer.process.wait()
        return OK
    if ended and not web:
        raise InputError(
            f"the viewer's window ended with status {ended}; --web shows the recording in a browser"
        )
    return OK if ended == 0 else FAILED


def describe(run: Path) -> str:
    """A run folder in a line: scenario, length, verdict."""
    from workcell.run import read_summary
    from workcell.trace.table import load
    from workcell.view.verdict import headline

    summary, trace = read_summary(run), load(run)
    name = trace.metadata.get("settings", {}).get("name", run.name)
    verdict = "no summary: the run did not end" if summary is None else headline(summary)
    return f"{run}: {name}, {trace['time_s'][-1]:.1f} s, {verdict}"


def plot(
    run: RunFolder,
    /,
    format: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(metavar="KIND", help="png, pdf or svg; may be given several times"),
    ] = (),
) -> int:
    """Draw the paper's figures 3, 4 and 5 from a run into its folder `figures`."""
    needs("matplotlib", "figures")
    from workcell.run import FIGURES_FOLDER, SCENE_FOLDER
    from workcell.trace.table import load
    from workcell.view import figures

    scene_xml = run / SCENE_FOLDER / "scene.xml"
    for path in figures.paper_figures(
        load(run), scene_xml, run / FIGURES_FOLDER, formats=format or ("png",)
    ):
        stdout.print(str(path))
    return OK

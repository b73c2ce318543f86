"""The commands that show a run: replay, plot."""

from __future__ import annotations

from typing import Annotated

import tyro

from workcell.cli.options import RunFolder
from workcell.cli.terminal import FAILED, OK, stdout


def replay(
    run: RunFolder,
    /,
    web: Annotated[bool, tyro.conf.arg(help="in a browser instead of the native viewer")] = False,
) -> int:
    """Open a run in the rerun viewer; its recording is rebuilt from the trace where it is missing or outdated."""
    from workcell.run import rebuild_recording
    from workcell.view.viewer import open_viewer

    recording = rebuild_recording(run)
    return OK if open_viewer(recording, web=web).wait() == 0 else FAILED


def plot(run: RunFolder, /) -> int:
    """Draw the paper's figures 3, 4 and 5 from a run into its folder `figures`."""
    from workcell.run import SCENE_FOLDER
    from workcell.trace.table import load
    from workcell.view import figures

    for path in figures.paper_figures(load(run), run / SCENE_FOLDER / "scene.xml", run / "figures"):
        stdout.print(str(path))
    return OK

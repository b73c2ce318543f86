"""The command that makes a film of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell.cli.extras import needs
from workcell.cli.terminal import OK, progress_bar, stdout
from workcell.errors import InputError

Runs = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(metavar="RUN", help="run folders, one or several side by side"),
]


def film(
    runs: Runs,
    /,
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE", help="mp4, gif or webp; default film.mp4 in the first RUN"),
    ] = None,
    speed: Annotated[float, tyro.conf.arg(help="seconds of the run in a second of film")] = 1.0,
    fps: Annotated[int, tyro.conf.arg(metavar="N", help="pictures a second")] = 20,
    height: Annotated[int, tyro.conf.arg(metavar="N", help="pixels of a run's picture")] = 480,
    start: Annotated[float, tyro.conf.arg(help="where in the run it begins, s")] = 0.0,
    end: Annotated[float | None, tyro.conf.arg(help="where it ends, s; default the end")] = None,
) -> int:
    """Make a film of a run, or of several side by side: the cell, a gauge of the time to collision, and curves."""
    needs("matplotlib", "film")
    if not runs:
        raise InputError("film: RUN is missing; allowed is 1 to 4 run folders")
    from workcell.run import SCENE_FILE, SCENE_FOLDER
    from workcell.trace.table import load
    from workcell.view.film import Clip
    from workcell.view.film import film as make

    clips = []
    for run in runs:
        trace = load(run)
        settings = trace.metadata.get("settings", {})
        title = settings.get("name", run.name) if len(runs) == 1 else run.name
        clips.append(Clip(trace, run / SCENE_FOLDER / SCENE_FILE, title))
    target = out or runs[0] / "film.mp4"
    with progress_bar("drawing") as bar:
        made = make(
            clips,
            target,
            speed=speed,
            fps=fps,
            height=height,
            start_s=start,
            end_s=end,
            progress=bar,
        )
    stdout.print(f"{made} ({made.stat().st_size / 1e6:.2f} MB)", markup=False)
    return OK

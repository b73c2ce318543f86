"""The command that writes a report: of a run, or of a sweep."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import tyro

from workcell.cli.terminal import OK, stdout
from workcell.errors import InputError

Folder = Annotated[
    Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="a run folder, or one of a sweep")
]


def report(
    folder: Folder,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help="default report.html in the folder")
    ] = None,
) -> int:
    """Write one HTML file about a run or a sweep that opens without a network: verdicts, curves to zoom, pictures, events, versions."""
    from workcell import run as runner
    from workcell.study.folder import TABLE_FILE
    from workcell.trace.table import load

    target = out or folder / runner.REPORT_FILE
    if not folder.is_dir():
        raise InputError("no such folder; allowed is a run folder or one of a sweep", file=folder)
    if (folder / TABLE_FILE).is_file():
        from workcell.study.page import report as of_sweep

        written = of_sweep(folder, target)
    else:
        from workcell.view.report import report as of_run

        written = of_run(
            load(folder),
            folder / runner.SCENE_FOLDER / runner.SCENE_FILE,
            runner.read_summary(folder),
            target,
            again=shlex.join(["workcell", "run", str(folder / runner.SCENARIO_FILE)]),
        )
    stdout.print(f"{written} ({written.stat().st_size / 1e6:.1f} MB)", markup=False)
    return OK

"""The command that makes a run folder of a scenario: run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell import scenario as scenario_file
from workcell.cli.options import Overrides, ScenarioName
from workcell.cli.terminal import FAILED, OK, progress_bar, report


def run(
    scenario: ScenarioName,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="run folder; default runs/<scenario>")
    ] = None,
    set: Overrides = (),
) -> int:
    """Run a scenario headlessly into a run folder and judge it by its expectations."""
    from workcell import run as runner

    loaded = scenario_file.load(scenario, set)
    folder = out or Path("runs") / loaded.name
    with progress_bar(loaded.name) as bar:
        summary = runner.run(loaded, folder, progress=bar, phase=bar and bar.phase)
    report(summary, folder)
    return OK if summary["held"] else FAILED
